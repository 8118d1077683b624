"""One trial of a controller on every system, to watch."""

from __future__ import annotations

from evaluation.report.contents import Report
from evaluation.report.pictures import traces_picture
from evaluation.report.replay import Replay, replay
from evaluation.report.sections.section import Section, present
from evaluation.transfer import TransferMatrix

NOT_KEPT = "Nothing can be replayed: no trial of any controller was kept (traces in experiment.toml)."


def section(report: Report) -> Section | None:
    """Return the replay and the traces; None without controllers."""
    matrix, summary = report.matrix, report.transfer
    if matrix is None or summary is None:
        return None
    shown = replay(matrix, first=summary.pick)
    if shown is None:
        return Section("Replay", absent=[NOT_KEPT])
    return Section("Replay", present(shown, traces_picture(matrix)), absent=_absent(matrix, shown))


def _absent(matrix: TransferMatrix, shown: Replay) -> list[str]:
    """Say what the replay cannot show."""
    found = []
    if matrix.robot is None:
        found.append("Nothing was run on a robot, so there is none beside the models, and no moment where they part.")
    if not shown.paths:
        found.append("There are no paths to watch: the task has no places on a plane. States are shown over time.")
    return found
