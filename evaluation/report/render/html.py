"""The report as one HTML page that needs nothing else: styles and pictures are inside."""

from __future__ import annotations

import re

from evaluation.plot_style import style_sheet
from evaluation.report.elements import Cards, FigureElement, Page, ReplayElement
from evaluation.report.render.svg import drawn

TEMPLATE = "page.html.j2"
JOINT = re.compile(r"(?<=\w)([_+/@])(?=\w)")
"""Where a long name may break."""


def page_of(story: Page) -> str:
    """Return the page that tells a story; it holds no link and no source outside itself."""
    from jinja2 import Environment, PackageLoader, StrictUndefined
    from markupsafe import Markup, escape

    environment = Environment(
        loader=PackageLoader("evaluation.report", "page"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["drawn"] = drawn
    environment.filters["joints"] = lambda text: Markup(JOINT.sub(r"\1<wbr>", str(escape(text))))
    environment.filters["raw"] = Markup
    environment.tests["picture"] = lambda item: isinstance(item, FigureElement)
    environment.tests["cards"] = lambda item: isinstance(item, Cards)
    environment.tests["replay"] = lambda item: isinstance(item, ReplayElement)
    page: str = environment.get_template(TEMPLATE).render(
        story=story,
        colours=Markup(style_sheet()),
    )
    return page
