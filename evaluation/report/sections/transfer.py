"""What every controller does on every system."""

from __future__ import annotations

from evaluation.report.absences import of_transfer
from evaluation.report.contents import Report
from evaluation.report.overview import command_sheet
from evaluation.report.pictures import claims_picture, fitness_picture
from evaluation.report.sections.section import Section, present
from evaluation.report.tables import (
    controller_sheet,
    finalist_sheet,
    measure_sheet,
    paper_sheet,
    standing_sheet,
    transfer_sheet,
)
from evaluation.report.transferring import unknown

WORDS = "Claimed: fitness on the models a controller was evolved against. Achieved: fitness elsewhere."


def section(report: Report) -> Section:
    """Return the transfer matrix and what it says of each controller; without controllers, why."""
    matrix, summary = report.matrix, report.transfer
    if matrix is None or summary is None:
        return Section("Transfer", absent=of_transfer(report))
    return Section(
        "Transfer",
        present(
            transfer_sheet(matrix),
            paper_sheet(matrix) if report.settings.get("preset") == "paper" else None,
            claims_picture(matrix, summary),
            standing_sheet(matrix, summary),
            controller_sheet(matrix, summary),
            measure_sheet(matrix),
            finalist_sheet(matrix),
            command_sheet(report),
            fitness_picture(matrix),
        ),
        [WORDS, *unknown(summary)],
        absent=of_transfer(report),
    )
