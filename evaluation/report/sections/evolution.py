"""How controllers were found: fitness over generations, behaviour classes. A part of Controllers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from evaluation.formatting import lines, three_digits
from evaluation.plots import plot_fitness
from evaluation.report.document import Number, Numbers, Part
from evaluation.report.elements import THIRD, Drawing, DrawingPair, FigureElement, TableElement
from evaluation.transfer.matrix import TransferMatrix
from sysid_evo.evolution import Champion, Finalist, ranking_value
from sysid_evo.registry import Spec

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


def fewer_generations(matrix: TransferMatrix, settings: Mapping[str, Any]) -> list[str]:
    """Return a sentence for each controller whose search was shorter, because a step of a model in it takes long."""
    times = settings.get("step_seconds", {})
    slow = {(one := Spec.parse(text)).label: f"{one.label} {1e6 * times[text]:.2g} µs" for text in times}
    found = []
    for champion in matrix.champions:
        planned = settings.get("polish_generations" if champion.polished else "generations", 0)
        models = ", ".join(slow[label] for label in champion.against if label in slow)
        if models and 0 < len(champion.history) < planned:
            found.append(
                f"{champion.name}: {len(champion.history)} of {planned} generations, because a step takes long in "
                f"{models}. search_minutes sets the time of a search."
            )
    return found


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


class FinalistPart(Part):
    """The best of one behaviour class of a repeat."""

    behaviour_class: str
    repeat: int
    fitness: Number
    forecast: Number


class SearchPart(Part):
    """How one controller was found; ``history`` has best, mean and worst fitness of each generation.

    ``estimator_delay`` in s; ``seed_fitness`` is that of the best finalist of each evolution run.
    """

    name: str
    against: tuple[str, ...]
    aggregate: str
    seed: int
    controller: str
    task: str
    estimator_delay: float
    noise: str
    seed_fitness: tuple[Number, ...]
    scoring_models: tuple[str, ...]
    polished: bool
    finalists: tuple[FinalistPart, ...]
    parameters: Numbers
    history: tuple[Numbers, ...]


class EvolutionPart(Part):
    """How each controller was found."""

    controllers: tuple[SearchPart, ...]

    @classmethod
    def of(cls, matrix: TransferMatrix) -> EvolutionPart:
        """Return how the controllers of a matrix were found."""
        found = (
            {**champion.to_dict(), "parameters": champion.parameters, "history": tuple(champion.history)}
            for champion in matrix.champions
        )
        return cls(controllers=tuple(map(SearchPart.model_validate, found)))
