"""How controllers were found: fitness over generations, behaviour classes. A part of Controllers."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from evaluation.formatting import lines, three_digits
from evaluation.plots import plot_fitness
from evaluation.report.elements import THIRD, Drawing, DrawingPair, FigureElement, TableElement
from evaluation.transfer.matrix import TransferMatrix
from sysid_evo.evolution import Champion, Finalist, ranking_value

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def fitness_picture(matrix: TransferMatrix) -> FigureElement | None:
    """Fitness over generations, one panel for each champion; None if there is no history."""
    champions = [champion for champion in matrix.champions if len(champion.history)]
    if not champions:
        return None
    everything = np.concatenate([champion.history for champion in champions])
    margin = 0.05 * (float(np.ptp(everything)) or 1.0)
    panels: list[DrawingPair] = []
    for place, champion in enumerate(champions):

        def draw(figure: Figure, champion: Champion = champion) -> None:
            ax = plot_fitness(champion, figure.add_subplot(), unit=matrix.unit)
            ax.set_ylim(everything.min() - margin, everything.max() + margin)

        label = f"fitness of {champion.name} over generations"
        drawing = Drawing(f"fitness-{place}", label, draw, THIRD, 2.1, keyed=True)
        panels.append(DrawingPair(drawing, title=champion.name))
    return FigureElement(
        "Fitness over generations",
        "Best, mean and worst of the candidates of each generation, in the models of the evolution.",
        tuple(panels),
        columns=3,
    )


def behaviour_class_table(matrix: TransferMatrix) -> TableElement | None:
    """Return the best of each behaviour class with claim and forecast; None without behaviour classes."""
    rows = []
    for champion in matrix.champions:
        best: dict[str, Finalist] = {}
        for finalist in champion.finalists:
            kind = finalist.behaviour_class.partition(" #")[0]
            if kind not in best or ranking_value(finalist) > ranking_value(best[kind]):
                best[kind] = finalist
        for kind, finalist in best.items():
            chosen = np.array_equal(finalist.parameters, champion.parameters)
            scores = (three_digits(finalist.fitness), three_digits(finalist.forecast))
            rows.append((champion.name, lines(kind, "(chosen)" if chosen else ""), *scores))
    if not any(kind for _, kind, _, _ in rows):
        return None
    return TableElement(
        title=f"Best of each behaviour class ({matrix.unit or 'fitness'})",
        columns=("controller", "behaviour class", "claimed", "forecast"),
        rows=tuple(rows),
        note=(
            "Behaviour class: the side of a channel on which a search was kept more than half of the time. Forecast: "
            "expected fitness on the robot from all models, by which one was chosen."
        ),
    )


def champion_to_json(champion: Champion) -> dict[str, Any]:
    """Return the entry of a controller in ``champions`` of the document."""
    known = {name: value for name, value in champion.to_dict().items() if name != "system"}
    return {**known, "parameters": champion.parameters, "history": champion.history}
