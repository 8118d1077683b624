"""What the verdict says on controllers: which transfer, which to use, and what is not known of them."""

from __future__ import annotations

import numpy as np

from evaluation.labels import few, percent
from evaluation.report.sheets import number
from evaluation.transfer import ControllerSummary, Estimate, TransferMatrix, TransferSummary

KEPT = 0.9
"""A claim is kept from this share of it on."""
LOST = 0.5
"""A claim is lost below this share of it."""
ONE_SEED = "One evolution seed: how far a claim varies from seed to seed is unknown."
POLISHED = (
    "{} was polished once, from the best of all searches and seeds together: how far another polish would end from it "
    "is unknown."
)


def transferring(matrix: TransferMatrix, summary: TransferSummary | None) -> tuple[str, ...]:
    """Answer which controllers transfer."""
    if summary is None:
        return ("No controller was evolved.",)
    if all(cell.failed for cell in matrix.cells.values()):
        return ("No controller could be run anywhere.",)
    unit = f" {matrix.unit}" if matrix.unit else ""
    return _on_models(summary, unit) if matrix.robot is None else _on_robot(summary, unit)


def recommended(matrix: TransferMatrix, summary: TransferSummary, why: str | None) -> tuple[str, ...]:
    """Answer what to use; ``why`` says by what the controller to drive was chosen."""
    answers = [why or "No controller can be judged by models of other families; add a family to choose by."]
    if matrix.robot is not None:
        tested = [c for c in summary.controllers if c.achieved is not None and c.against and not c.on_robot]
        best = max(tested, key=lambda c: c.achieved.value if c.achieved else -np.inf, default=None)
        if best is not None and best.achieved is not None and best.name != summary.pick:
            answers.append(f"Chosen with the robot: {best.name}, {best.achieved.value:.1f} on it.")
        answers += [
            f"Rank correlation of {correlation.figure} with achieved: {correlation.value:+.2f} "
            f"({correlation.controllers} controllers)."
            for correlation in summary.correlations
            if correlation.value is not None
        ]
    return tuple(answers)


def unknown(summary: TransferSummary) -> tuple[str, ...]:
    """Say what the claims leave open."""
    claiming = [c for c in summary.controllers if c.claimed is not None]
    answers = [said] if (said := seeds_unknown(summary)) else []
    single = [c.name for c in claiming if c.achieved is not None and not np.isfinite(c.achieved.standard_error)]
    if single:
        answers.append(f"A single trial on the robot has no error and judges no claim: {', '.join(single)}.")
    return tuple(answers)


def _on_robot(summary: TransferSummary, unit: str) -> tuple[str, ...]:
    tested = sorted(
        (c for c in summary.controllers if c.achieved is not None),
        key=lambda c: -(c.achieved.value if c.achieved else 0.0),
    )
    if not tested:
        return ("No controller could be run on the robot.",)
    moved = [c for c in tested if not c.on_robot]
    answers = [f"Most on the robot: {_achieved(moved[0], unit)}."] if moved else []
    yardstick = next((c for c in tested if c.on_robot), None)
    if yardstick is not None:
        answers.append(f"Evolved on the robot itself: {_achieved(yardstick, unit)}.")
        pick = next((c for c in tested if c.name == summary.pick), None)
        assert yardstick.achieved is not None
        share = None if pick is None else pick.share_of(yardstick.achieved.value)
        if pick is not None and share is not None:
            answers.append(f"{pick.name} achieves {percent(share)} of that.")
    shares = [(c.name, c.kept) for c in tested if not c.on_robot and c.kept is not None]
    if shares:
        holding = [name for name, kept in shares if kept >= KEPT]
        answers.append(
            f"At least nine tenths of their claim is kept on the robot by {few(holding, 8)}."
            if holding
            else "No controller keeps nine tenths of its claim on the robot."
        )
        failing = [f"{name} ({percent(kept)})" for name, kept in shares if kept < LOST]
        if failing:
            answers.append(f"Less than half of it: {', '.join(failing)}.")
    floor = tested[0].floor
    if floor is not None:
        answers.append(f"Shares are measured from controls at rest: {floor:.1f}{unit}.")
    return tuple(answers)


def seeds_unknown(summary: TransferSummary) -> str:
    """Say of which controllers it is not known how far evolution seeds differ, and why; empty if it is of all."""
    single = [c for c in summary.controllers if c.claimed is not None and len(c.seed_fitness) < 2]
    if any(not c.polished for c in single):
        return ONE_SEED
    return POLISHED.format(", ".join(c.name for c in single)) if single else ""


def _on_models(summary: TransferSummary, unit: str) -> tuple[str, ...]:
    pairs = [(c.name, c.claimed.value, c.others.value) for c in summary.controllers if c.claimed and c.others]
    if not pairs:
        return ("There is no robot and no other model to transfer to.",)
    holding = [name for name, claimed, others in pairs if others >= KEPT * claimed]
    falling = [f"{name} ({claimed:.1f} to {others:.1f})" for name, claimed, others in pairs if others < LOST * claimed]
    keeping = f"{', '.join(holding)} keep" if holding else "no controller keeps"
    answers = [
        "Nothing was run on the robot. On the other models (mean fitness), "
        f"{keeping} at least nine tenths of the claim."
    ]
    if falling:
        answers.append(f"Less than half of it, in mean fitness{unit and f' ({unit.strip()})'}: {', '.join(falling)}.")
    return tuple(answers)


def _achieved(controller: ControllerSummary, unit: str) -> str:
    assert controller.achieved is not None
    return f"{controller.name}, {sized(controller.shown['achieved'])}{unit}"


def sized(estimate: Estimate) -> str:
    """Return a value with its 90 % interval, alone where it has none."""
    if not estimate.low < estimate.high:
        return number(estimate.value)
    return f"{number(estimate.value)} ({number(estimate.low)} to {number(estimate.high)})"
