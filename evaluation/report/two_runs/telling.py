"""Two runs side by side as a page, for a terminal, and as strict JSON."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from rich.console import Group, RenderableType
from rich.text import Text

from evaluation.labels import few
from evaluation.prediction import PERSISTENCE
from evaluation.report.document import plain
from evaluation.report.headlines import Headline, Tone
from evaluation.report.page import page_of
from evaluation.report.story import Story
from evaluation.report.terminal import findings_lines, to_rich
from evaluation.report.two_runs.differences import Change, Differences
from evaluation.report.two_runs.parts import FIGURES, changed, predicting, transferring
from evaluation.report.verdict import Finding
from sysid_evo.files import write_atomically


def two_stories(found: Differences) -> Story:
    """Tell what differs between two runs."""
    sections = [changed(found), predicting(found), transferring(found)]
    return Story(f"{found.names[0]} and {found.names[1]}", _headlines(found), _findings(found), None, sections)


def save_comparison(found: Differences, folder: str | Path) -> Path:
    """Write the page of two runs into ``folder`` and return its path, named after the first of them."""
    page = page_of(two_stories(found))
    return write_atomically(Path(folder) / f"{stem(found)}.html", lambda file: file.write_text(page, encoding="utf-8"))


def stem(found: Differences) -> str:
    """Return what the files of two runs are called, without suffix."""
    return "against-" + re.sub(r"[^\w.-]+", "-", found.names[0])


def terminal(found: Differences) -> list[RenderableType]:
    """Return the answers and the tables that are not folded away on the page, at most 80 columns wide."""
    story = two_stories(found)
    parts: list[RenderableType] = [
        Text(story.title, style="bold"),
        *findings_lines([Finding(one.question, (f"{one.answer}. {one.sentence}",)) for one in story.headlines]),
        *findings_lines(story.findings),
    ]
    for section in story.sections:
        for sheet in section.sheets:
            parts += [] if sheet.details else to_rich(sheet)
        if section.absent:
            parts.append(Group(*(Text(sentence) for sentence in section.absent)))
    return parts


def to_json(found: Differences) -> dict[str, Any]:
    """Return what differs as strict JSON."""
    document: dict[str, Any] = plain(
        {
            "runs": found.names,
            "same": {"training": found.same_training, "test": found.same_test, "trials": found.same_trials},
            "settings": found.settings,
            "models": {
                "only_first": found.models_only_in(0),
                "only_second": found.models_only_in(1),
                "parameters": found.parameters,
            },
            "errors": [
                {"steps": horizon, "model": name, "n": _figures(change)}
                for horizon, changes in found.errors.items()
                for name, change in changes.items()
            ],
            "controllers": [
                {"name": c.name, **{figure: _figures(getattr(c, figure)) for figure, _ in FIGURES}}
                for c in found.controllers
            ],
            "picks": found.picks,
        }
    )
    return document


def _figures(change: Change | None) -> dict[str, Any] | None:
    if change is None:
        return None
    return {**asdict(change), "difference": change.difference, "significant": change.significant}


def _headlines(found: Differences) -> tuple[Headline, ...]:
    changes = found.errors.get(found.main_horizon, {})
    errors = {name: change for name, change in changes.items() if name != PERSISTENCE}
    achieved = {c.name: change for c in found.controllers if (change := c.achieved or c.others) is not None}
    place = "on the robot" if any(c.achieved is not None for c in found.controllers) else "on the other models"
    return (
        Headline("What changed?", _what_changed(found), _data_words(found), "open"),
        _counted("Which models predict better?", errors, found, lower_is_better=True),
        _counted(f"Which controllers do better {place}?", achieved, found, lower_is_better=False),
    )


def _counted(
    question: str,
    changes: Mapping[str, Change],
    found: Differences,
    *,
    lower_is_better: bool,
) -> Headline:
    if not changes:
        return Headline(question, "Not known", found.incomparable or "The runs have none in common.", "open")
    sure = {name: change for name, change in changes.items() if change.significant}
    sign = -1.0 if lower_is_better else 1.0
    up = [name for name, change in sure.items() if sign * change.difference > 0]
    down = [name for name in sure if name not in up]
    second = found.names[1]
    if all(change.same for change in changes.values()):
        return Headline(question, "The same", f"Nothing differs in any of {len(changes)}.", "open")
    if not sure:
        return Headline(question, "None", f"No significant difference in any of {len(changes)}.", "open")
    told = [f"better in {second}: {', '.join(up)}"] if up else []
    told += [f"worse in {second}: {', '.join(down)}"] if down else []
    rest = len(changes) - len(sure)
    told += [f"no significant difference: {rest} of {len(changes)}"] if rest else []
    tone: Tone = "good" if up and not down else "bad" if down and not up else "open"
    sentence = f"{'; '.join(told)}."
    return Headline(question, f"{len(up)} better, {len(down)} worse", sentence[0].upper() + sentence[1:], tone)


def _findings(found: Differences) -> list[Finding]:
    first, second = found.picks
    if not (first or second):
        return []
    taken = f"{first} in both." if first == second else f"{first or 'None'}, then {second or 'none'}."
    return [Finding("Which controller would be taken?", (taken,))]


def _what_changed(found: Differences) -> str:
    names = [name for name in found.settings if name != "data_digest"]
    if not names and not found.parameters:
        return "No setting"
    return few(names, 4) if names else "Parameters of models"


def _data_words(found: Differences) -> str:
    if (why := found.incomparable) is not None:
        return why
    training = "The same training data" if found.same_training else "Other training data"
    test = "the same test" if found.same_test else "another test, so that errors are not paired"
    trials = "the same trials" if found.same_trials else "other trials, so that fitness is not paired"
    return f"{training}, {test}, {trials}."
