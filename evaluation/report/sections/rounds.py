"""Rounds of recording: how much was recorded, what was claimed and achieved, and how well the models predicted."""

from __future__ import annotations

from evaluation.formatting import few, three_digits
from evaluation.report.document import Number, Numbers, Part
from evaluation.report.elements import Section, TableElement
from evaluation.results import ComparisonResults
from evaluation.rounds import ERROR_STEPS, SHORT_EPISODE, RecordingRound

COLUMNS = ("round", "steps\nin all", "steps an\nepisode", "claimed", "achieved", f"error after\n{ERROR_STEPS} steps")


class RoundPart(Part):
    """One round: ``claimed`` in the models, ``achieved`` and ``steps`` of each episode, ``errors`` of each model.

    ``parameters`` are those of ``controller``. ``again`` is the fitness in further episodes after the last round.
    """

    number: int
    controller: str
    parameters: Numbers
    claimed: Numbers
    achieved: Numbers
    steps: Numbers
    errors: dict[str, Number]
    again: Numbers | None


class RoundsPart(Part):
    """Rounds of recording after the ``first`` one, in steps, whose episodes have a median of ``first_episode`` steps.

    ``ended`` is the reason why no further round was made. ``rest`` is the fitness of controls at rest.
    """

    first: int
    first_episode: int
    rounds: tuple[RoundPart, ...]
    ended: str
    rest: Numbers | None


def section(report: ComparisonResults) -> Section | None:
    """Return the table of all rounds; None for a comparison without."""
    table = rounds_table(report)
    return None if table is None else Section("Rounds", [table])


def rounds_table(report: ComparisonResults) -> TableElement | None:
    """Return a row for each round, in their order; None without rounds."""
    summary, unit = report.rounds, "" if report.matrix is None else report.matrix.unit
    if summary is None:
        return None
    rows = [("first", str(summary.first), "–", "–", "–", "–")]
    total = summary.first
    chosen = report.chosen_round
    for one in summary.rounds:
        total += int(one.steps.sum())
        rows.append(
            (
                f"{one.number} (chosen)" if one is chosen else str(one.number),
                f"{total}",
                f"{one.steps.mean():.0f}",
                three_digits(float(one.claimed.mean())),
                _achieved(one),
                "\n".join(f"{name} {three_digits(error)}" for name, error in one.errors.items()),
            )
        )
    if summary.rest is not None:
        rows.append(("rest", "–", "–", "–", three_digits(float(summary.rest.mean())), "–"))
    return TableElement(
        title=f"Rounds of recording{f' ({unit})' if unit else ''}",
        columns=COLUMNS,
        rows=tuple(rows),
        note=f"{rounds_sentence(report)} {NOTE}",
    )


NOTE = (
    "Claimed, achieved: mean fitness in the models and in the recorded episodes, in both with noise on the commands if "
    "every episode has it, else without. "
    "Again: in further episodes after the last round, without noise, of those that may be the best; rest: controls at "
    "rest. Error: of the models of the round on its new episodes, in standard deviations."
)


def rounds_sentence(report: ComparisonResults) -> str:
    """Return how the rounds went, and why they ended; empty without rounds."""
    summary = report.rounds
    if summary is None:
        return ""
    short = (
        f"Half of the episodes of the first recording end within {summary.first_episode} steps, so the robot was then "
        "recorded under evolved controllers that stabilise it. "
        if summary.first_episode < SHORT_EPISODE
        else ""
    )
    count, held = len(summary.rounds), [str(one.number) for one in summary.rounds if one.holds]
    claims = f"claims that held: round {few(held)}" if held else "no claim held"
    ended = f"; no further round: {summary.ended}" if summary.ended else ""
    made = "1 round was" if count == 1 else f"{count} rounds were"
    return f"{short}{made[:1].upper()}{made[1:]} recorded, {summary.steps} steps in all; {claims}{ended}."


def _achieved(one: RecordingRound) -> str:
    found = three_digits(float(one.achieved.mean()))
    return found if one.again is None else f"{found}\nagain {three_digits(float(one.again.mean()))}"
