"""How each controller goes about its task, in words and numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from evaluation.behaviour import DrivingSummary, driving_sentences, unit_of
from evaluation.formatting import folded, lines, number, percent
from evaluation.report.elements import Section, TableElement, present
from evaluation.results import ComparisonResults
from evaluation.transfer.matrix import TransferMatrix


def section(report: ComparisonResults) -> Section | None:
    """Return what controllers do, in sentences and numbers; None if no trial of one was recorded."""
    if not report.driving_summaries or report.matrix is None:
        return None
    robot = report.matrix.robot
    return Section(
        "Behaviour",
        present(
            driving_table(report.driving_summaries, robot), measured_behaviour_table(report.driving_summaries, robot)
        ),
    )


SHOWN = ("speed", "backwards", "missed at first", "orbiting", "within tolerance", "settling time")
"""The measures that a table holds, in order, with the switching of every control; the rest stands in the JSON."""


def driving_table(manners: Sequence[DrivingSummary], robot: str | None) -> TableElement | None:
    """A row for each controller: what it does, in sentences; None if no trial was recorded."""
    found = driving_sentences(manners, robot)
    if not found:
        return None
    return TableElement("What controllers do", ("controller", "in words"), tuple(found.items()), prose=True)


def measured_behaviour_table(manners: Sequence[DrivingSummary], robot: str | None) -> TableElement | None:
    """The numbers behind it, on the robot and where each controller was evolved; None if no trial was recorded."""
    names = dict.fromkeys(name for manner in manners for name in manner.measures)
    shown = [name for name in SHOWN if name in names] + [name for name in names if name.endswith("switches per second")]
    if not shown:
        return None
    rows = [
        (
            manner.controller,
            lines(folded(manner.column), "(robot)" if manner.column == robot else ""),
            *(_cell(manner, name) for name in shown),
        )
        for manner in manners
    ]
    trials = sorted({manner.trials for manner in manners})
    count = f"{trials[0]}" if len(trials) == 1 else f"{trials[0]} to {trials[-1]}"
    return TableElement(
        title="Behaviour, measured",
        columns=("controller", "on", *(_head(name) for name in shown)),
        rows=tuple(rows),
        note=(
            f"Means over {count} recorded trials. missed: waypoints that were passed close by and left again before "
            "they were reached; orbiting: share of the time in full turns around a waypoint. report.json has "
            "intervals, and what follows a miss."
            if "orbiting" in names
            else f"Means over {count} recorded trials. report.json has intervals and the sides of every channel."
        ),
        details=True,
    )


def _head(name: str) -> str:
    control = name.removesuffix(" switches per second")
    if control != name:
        return lines(folded(control), "switches", "1/s")
    unit = unit_of(name)
    return lines(folded(name.removesuffix(" at first"), 9), unit)


def _cell(manner: DrivingSummary, name: str) -> str:
    return number(manner.value(name), 2 if name == "speed" else 1) if unit_of(name) else percent(manner.value(name))


def behaviour_to_json(found: Sequence[DrivingSummary], matrix: TransferMatrix) -> list[dict[str, Any]]:
    """Return the numbers of every controller on every system where it was recorded, and the sentences on it."""
    sentences = driving_sentences(found, matrix.robot)
    rows = []
    for manner in found:
        measures = {name: {**asdict(one), "unit": unit_of(name)} for name, one in manner.measures.items()}
        rows.append({**asdict(manner), "measures": measures, "sentence": sentences.get(manner.controller, "")})
    return rows
