"""The report as one HTML page that needs nothing else: styles and figures are inside."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Iterator, Mapping
from functools import cache, partial
from importlib.resources import files
from itertools import count

from jinja2 import Environment, PackageLoader, StrictUndefined, Template
from markupsafe import Markup, escape

from evaluation.plot_style import style_sheet
from evaluation.report.elements import Cards, FigureElement, Fold, Page, ReplayElement
from evaluation.report.render.svg import drawn

TEMPLATE = "page.html.j2"
JOINT = re.compile(r"(?<=\w)([_+/@])(?=\w)")
"""Where a long name may break."""


def page_of(story: Page) -> str:
    """Return a page as HTML, with no link or source outside itself."""
    page: str = _template().render(
        story=story,
        colours=Markup(style_sheet()),
        new_words=partial(Words, count()),
    )
    return page


@cache
def _template() -> Template:
    """Return the template; compiling it takes a tenth of a second."""
    environment = Environment(
        loader=PackageLoader("evaluation.report", "page"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["drawn"] = lambda panel: drawn(panel)
    environment.filters["joints"] = _joints
    environment.filters["links"] = lambda drawing: Markup(json.dumps(drawing.links).replace("<", "\\u003c"))
    environment.filters["raw"] = Markup
    environment.tests["picture"] = lambda item: isinstance(item, FigureElement)
    environment.tests["cards"] = lambda item: isinstance(item, Cards)
    environment.tests["replay"] = lambda item: isinstance(item, ReplayElement)
    environment.tests["fold"] = lambda item: isinstance(item, Fold)
    return environment.get_template(TEMPLATE)


def _joints(text: str) -> Markup:
    """Return escaped text with places where a long name may break."""
    return Markup(JOINT.sub(r"\1<wbr>", str(escape(text))))


@cache
def explained_words() -> Mapping[str, tuple[str, str]]:
    """Return the pattern of the forms of every explained word, and its sentence in the glossary."""
    page = files("evaluation.report").joinpath("page")
    glossary, forms = (
        tomllib.loads(page.joinpath(name).read_text("utf-8")) for name in ("glossary.toml", "explained.toml")
    )
    meanings = {word: sentence for group in glossary.values() for word, sentence in group.items()}
    return {word: (form, meanings[word]) for word, form in forms.items()}


class Words:
    """The explained words of one section; ``numbers`` gives each explanation of the page its own id."""

    def __init__(self, numbers: Iterator[int]) -> None:
        self._numbers, self._seen = numbers, set[str]()

    def explained(self, text: str) -> Markup:
        """Return escaped text with a button and a popover after the first use of each word."""
        found = []
        for word, (form, _) in explained_words().items():
            use = None if word in self._seen else re.search(rf"(?<![\w-])(?:{form})(?![\w-])", text, re.IGNORECASE)
            if use is not None:
                found.append((use.end(), use.start(), word))
        parts, done = [], 0
        for end, start, word in sorted(found):
            if start >= done:
                self._seen.add(word)
                parts += [_joints(text[done:start]), self._button(text[start:end], word)]
                done = end
        return Markup("").join([*parts, _joints(text[done:])])

    def _button(self, use: str, word: str) -> Markup:
        return Markup(
            '<span class="word">{3}<button type="button" class="help" popovertarget="word-{0}" '
            'aria-label="What is: {1}">?</button></span><span popover id="word-{0}"><strong>{1}</strong>: {2}</span>'
        ).format(next(self._numbers), word, explained_words()[word][1], use)
