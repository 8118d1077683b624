"""The table of what to expect of each controller, with intervals."""

from __future__ import annotations

import numpy as np

from evaluation.labels import folded
from evaluation.report.sheets import Sheet, lines, within
from evaluation.report.transferring import seeds_unknown
from evaluation.transfer import Estimate, Standing, TransferMatrix, TransferSummary


def standing_sheet(matrix: TransferMatrix, summary: TransferSummary) -> Sheet:
    """Claimed, achieved, worst case and regret of each controller and of its evolution seeds, with intervals."""
    rows = []
    for one in summary.controllers:
        rows.append(_standing_row(lines(one.name, "(chosen)" if one.name == summary.pick else ""), one.standing))
        if one.over_seeds is not None:
            rows.append(_standing_row(f"{one.name}, any of {one.over_seeds.seeds} seeds", one.over_seeds))
    robot = matrix.robot is not None
    several = any(one.over_seeds is not None for one in summary.controllers)
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
        rows=tuple(rows),
        note=(
            f"kept: share of the claim that is achieved{'' if robot else ' on the other models'}, ± standard error. "
            "worst case: the system where it is lowest, of those that it was not evolved against. "
            "regret: what the best other controller "
            + ("achieves more on the robot. " if robot else "has more, on the other model where that is most. ")
            + "Intervals are over fresh trials"
            + (
                "; of any seed over evolution seeds as well: what to expect of another evolution."
                if several
                else " of this one controller, not over evolution seeds."
            )
            + (f" {seeds_unknown(summary)}" if several and seeds_unknown(summary) else "")
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
