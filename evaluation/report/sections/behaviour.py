"""Behaviour of each controller, in words and numbers."""

from __future__ import annotations

from collections.abc import Sequence

from evaluation.behaviour import DrivingSummary, driving_sentences, unit_of
from evaluation.formatting import folded, lines, number, percent
from evaluation.report.document import Number, Part
from evaluation.report.elements import Section, TableElement, present
from evaluation.results import ComparisonResults
from evaluation.transfer.matrix import TransferMatrix


def section(report: ComparisonResults) -> Section | None:
    """Return the behaviour of controllers; None if no trial was recorded."""
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
"""Measures in the table, in order, with the switching of every control; report.json has all."""

MEANINGS = {
    "missed at first": "Missed: waypoints that were approached and left again before they were reached.",
    "orbiting": "Orbiting: share of the time in full turns around a waypoint.",
}
"""Sentences that explain a column, by its measure."""


def driving_table(summaries: Sequence[DrivingSummary], robot: str | None) -> TableElement | None:
    """Return a row of sentences for each controller; None if no trial was recorded."""
    found = driving_sentences(summaries, robot)
    if not found:
        return None
    return TableElement("Behaviour in words", ("controller", "behaviour"), tuple(found.items()), prose=True)


def measured_behaviour_table(summaries: Sequence[DrivingSummary], robot: str | None) -> TableElement | None:
    """Return measures on the robot and in the model of the evolution; None if no trial was recorded."""
    names = dict.fromkeys(name for one in summaries for name in one.measures)
    shown = [name for name in SHOWN if name in names] + [name for name in names if name.endswith("switches per second")]
    if not shown:
        return None
    rows = [
        (
            one.controller,
            lines(folded(one.column), "(robot)" if one.column == robot else ""),
            *(_cell(one, name) for name in shown),
        )
        for one in summaries
    ]
    trials = sorted({one.trials for one in summaries})
    count = f"{trials[0]}" if len(trials) == 1 else f"{trials[0]} to {trials[-1]}"
    explained = [sentence for name, sentence in MEANINGS.items() if name in shown]
    return TableElement(
        title="Behaviour, measured",
        columns=("controller", "on", *(_head(name) for name in shown)),
        rows=tuple(rows),
        note=" ".join(
            [f"Means over {count} recorded trials.", *explained, "report.json has intervals and more measures."]
        ),
        details=True,
    )


def _head(name: str) -> str:
    control = name.removesuffix(" switches per second")
    if control != name:
        return lines(folded(control), "switches", "1/s")
    unit = unit_of(name)
    return lines(folded(name.removesuffix(" at first"), 9), unit)


def _cell(one: DrivingSummary, name: str) -> str:
    return number(one.value(name), 2 if name == "speed" else 1) if unit_of(name) else percent(one.value(name))


class MeasurePart(Part):
    """The mean over the trials that have the number, and its 95 % interval."""

    value: Number
    low: Number
    high: Number
    trials: int
    unit: str


class BehaviourPart(Part):
    """What a controller does on one system where it was recorded, by measure, and the sentence on it."""

    controller: str
    column: str
    trials: int
    measures: dict[str, MeasurePart]
    sentence: str


def behaviour_parts(found: Sequence[DrivingSummary], matrix: TransferMatrix) -> list[BehaviourPart]:
    """Return the numbers of every controller on every system where it was recorded, and the sentences on it."""
    sentences = driving_sentences(found, matrix.robot)
    return [
        BehaviourPart.made_of(
            one,
            measures={name: MeasurePart.made_of(value, unit=unit_of(name)) for name, value in one.measures.items()},
            sentence=sentences.get(one.controller, ""),
        )
        for one in found
    ]
