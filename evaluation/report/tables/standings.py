"""The table of what to expect of each controller, with intervals."""

from __future__ import annotations

import numpy as np

from evaluation.labels import folded
from evaluation.report.sheets import Sheet, lines, within
from evaluation.transfer import Estimate, Standing, TransferMatrix, TransferSummary


def standing_sheet(matrix: TransferMatrix, summary: TransferSummary) -> Sheet:
    """Claimed, achieved, worst case and regret of each controller, with intervals."""
    robot = matrix.robot is not None
    return Sheet(
        title=f"Claimed, achieved, worst case, regret ({matrix.unit or 'fitness'}, 90 % intervals)",
        columns=(
            "controller",
            "claimed",
            "achieved" if robot else "on other\nmodels",
            "kept\n%",
            "worst\ncase",
            "regret",
        ),
        rows=tuple(
            _standing_row(lines(one.name, "(chosen)" if one.name == summary.pick else ""), one.standing)
            for one in summary.controllers
        ),
        note=(
            f"kept: share of the claim that is achieved{'' if robot else ' on the other models'}, ± standard error. "
            "worst case: the system where it is lowest, of those that it was not evolved against. "
            "regret: what the best other controller "
            + ("achieves more on the robot. " if robot else "has more, on the other model where that is most. ")
            + "Intervals are over fresh trials of this one controller, not over evolution seeds."
        ),
    )


def _standing_row(name: str, standing: Standing) -> tuple[str, ...]:
    return (
        name,
        within(standing.claimed),
        within(standing.achieved),
        _share(standing.kept),
        lines(within(standing.worst), folded(standing.worst_on, 12)),
        within(standing.regret),
    )


def _share(kept: Estimate | None) -> str:
    """Return ``75 ±3``, a share in per cent and its standard error; the first alone without the second."""
    if kept is None:
        return "–"
    error = f" ±{100 * kept.standard_error:.0f}" if np.isfinite(kept.standard_error) else ""
    return f"{100 * kept.value:.0f}{error}"
