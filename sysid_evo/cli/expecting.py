"""What an evolved controller is expected to do on the robot, as a sentence."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from evaluation.comparison import Column, RunCell
    from evaluation.forecast import Forecast
    from sysid_evo.evolution import Champion
    from sysid_evo.plan import Store


def by_label(columns: Sequence[Column]) -> tuple[Column, ...]:
    """Return the models among ``columns``, of those with one label the first."""
    return tuple({column.label: column for column in reversed(columns) if column.robot is None}.values())[::-1]


def forecast_from(store: Store, champion: Champion, runs: Sequence[RunCell]) -> Forecast | None:
    """Return the forecast of ``champion`` by what ``store`` has of its ``runs`` in models, None for fewer than two."""
    from evaluation.forecast import error_of, forecasts
    from evaluation.transfer import TransferMatrix

    found = {run.column.label: (run.column, cell) for run in runs if (cell := store.outcome(run).value) is not None}
    predicted = {
        label: None if column.prediction is None else store.outcome(column.prediction).value
        for label, (column, _) in found.items()
    }
    matrix = TransferMatrix.of(
        [champion],
        tuple(found),
        [cell for _, cell in found.values()],
        families={label: column.registered for label, (column, _) in found.items()},
    )
    errors = {label: error_of(prediction) for label, prediction in predicted.items()}
    return forecasts(matrix, errors).get(champion.name)


def forecast_sentence(found: Forecast, unit: str, *, chosen: int) -> str:
    """Say what is expected on the robot, by how many models, and how many finalists were chosen from by that."""
    size = f"{found.value:.1f} ({found.low:.1f} to {found.high:.1f}) {unit}".rstrip()
    among = f"; it was chosen among {chosen} finalists by their forecasts" if chosen > 1 else ""
    return f"Forecast for the robot, by {len(found.weights)} models: {size}{among}"
