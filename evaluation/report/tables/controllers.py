"""Tables of controllers: what each claims and achieves, and how models are exploited."""

from __future__ import annotations

import numpy as np

from evaluation.exploitability import ModelExploitability
from evaluation.labels import folded, percent
from evaluation.report.sheets import Heat, Sheet, lines, listed, number, of_each_run, plus_minus
from evaluation.report.transferring import seeds_unknown
from evaluation.transfer import (
    NOT_RUN,
    Cell,
    ControllerSummary,
    Figures,
    PairedEstimate,
    TransferMatrix,
    TransferSummary,
)
from sysid_evo.evolution import Finalist, worth

CONSENSUS = "other\nfamilies"
"""The heading of what models of other families say together."""
FAINTEST = 1e-3
"""The share from which on a cell is painted."""


def transfer_sheet(matrix: TransferMatrix) -> Sheet:
    """Mean fitness (standard deviation over trials) of every controller on every system, and on other families."""
    places = _with_consensus(matrix)
    columns = tuple(
        CONSENSUS if c is None else lines(folded(c), "(robot)" if c == matrix.robot else "") for c in places
    )
    figures = Figures(matrix)
    medians = {champion.name: figures.consensus(champion) for champion in matrix.champions}
    rows = [
        (
            champion.name,
            *(
                _consensus_cell(medians[champion.name])
                if c is None
                else _fitness_cell(matrix.cell(champion.name, c), c in champion.against)
                for c in places
            ),
        )
        for champion in matrix.champions
    ]
    unit = matrix.unit or "fitness"
    means = np.array(
        [[_value(medians[row]) if c is None else matrix.cell(row, c).mean for c in places] for row in matrix.rows]
    ).reshape(len(matrix.rows), len(places))
    known = means[np.isfinite(means)]
    low, top = min(0.0, known.min(initial=0.0)), known.max(initial=0.0)
    shades = tuple(
        tuple((m - low) / (top - low) if np.isfinite(m) and top > low else None for m in row) for row in means
    )
    own = frozenset(
        (i, j)
        for i, champion in enumerate(matrix.champions)
        for j, column in enumerate(places)
        if column in champion.against
    )
    models = sum(column is None or column in matrix.models for column in places)
    return Sheet(
        title=f"Transfer matrix: {unit}, mean (standard deviation over trials)",
        columns=("controller", *columns),
        rows=tuple(rows),
        note=(
            f"{_trials(matrix)} = evolved against this model. "
            "other families: median over the models of families that it was not evolved in. "
            "clip: steps whose state was clipped to the model's envelope; div: trials that diverged."
        ),
        heat=Heat(shades, own, models if 0 < models < len(places) else None),
    )


def controller_sheet(matrix: TransferMatrix, summary: TransferSummary) -> Sheet:
    """Claimed and achieved fitness, and the gaps between them."""
    robot: tuple[str, ...] = ("on the\nrobot", "reality\ngap") if matrix.robot is not None else ()
    rows = [_controller_row(controller, summary, bool(robot)) for controller in summary.controllers]
    runs = [len(controller.seed_fitness) for controller in summary.controllers if controller.claimed is not None]
    each = f"below a claim: the champion of each of {max(runs)} evolution runs. " if max(runs, default=0) > 1 else ""
    unknown = f" {said}" if (said := seeds_unknown(summary)) else ""
    return Sheet(
        title=f"Claimed and achieved ({matrix.unit or 'fitness'}, ± standard error)",
        columns=("controller", "claimed", "other\nmodels", "exploit.\ngap", "other\nfamilies", *robot),
        rows=tuple(rows),
        note=(
            f"claimed: on the models it was evolved against, joined as in its evolution, in fresh trials. {each}"
            "other families: median over the models of families it was not evolved against. "
            "Gap: claimed minus achieved; exploitation on the other models, reality on the robot. "
            f"chosen: without the robot, by its forecast.{unknown}"
        ),
    )


def measure_sheet(matrix: TransferMatrix) -> Sheet | None:
    """What the task tells beside the fitness, where each controller was evolved and on the robot; None if nothing."""
    rows, names = [], list(dict.fromkeys(name for cell in matrix.cells.values() for name in cell.measures))
    for champion in matrix.champions:
        own = next((column for column in champion.against if column in matrix.columns), None)
        places = dict.fromkeys(column for column in (own, matrix.robot) if column is not None)
        for column in places:
            told = matrix.cell(champion.name, column).measures
            shown = ["–" if told.get(name) is None else number(told[name]) for name in names]
            rows.append((champion.name, folded(column), *shown))
    if not names:
        return None
    return Sheet(
        title="What else was measured",
        columns=("controller", "on", *(name.replace(" ", "\n") for name in names)),
        rows=tuple(rows),
        note="Means over the trials that have the number; the first model that it was evolved on, and the robot.",
    )


def finalist_sheet(matrix: TransferMatrix) -> Sheet | None:
    """The best of each niche, what it claims, and what all models say together; None without niches."""
    rows = []
    for champion in matrix.champions:
        best: dict[str, Finalist] = {}
        for finalist in champion.finalists:
            kind = finalist.niche.partition(" #")[0]
            if kind not in best or worth(finalist) > worth(best[kind]):
                best[kind] = finalist
        for kind, finalist in best.items():
            chosen = np.array_equal(finalist.parameters, champion.parameters)
            elsewhere = "–" if finalist.elsewhere is None else number(finalist.elsewhere)
            rows.append((champion.name, lines(kind, "(chosen)" if chosen else ""), number(finalist.fitness), elsewhere))
    if not any(kind for _, kind, _, _ in rows):
        return None
    return Sheet(
        title=f"Kinds of behaviour that were found ({matrix.unit or 'fitness'})",
        columns=("controller", "niche", "claimed", "forecast"),
        rows=tuple(rows),
        note=(
            "niche: the side of a channel on which a search was kept more than half of the time; the best of its "
            "starts. forecast: what all models say of it together, by which it was chosen."
        ),
    )


def exploitability_sheet(models: tuple[ModelExploitability, ...]) -> Sheet:
    """What is claimed on each model, and how much of it lies outside the data."""
    rows = [
        (
            lines(model.model, "" if model.controllers == (model.model,) else f"({listed(model.controllers)})"),
            plus_minus(model.claimed),
            plus_minus(model.others),
            plus_minus(model.achieved),
            lines(percent(model.outside_visited), _on_robot(model.outside_robot)),
            percent(model.outside_held_out),
            percent(model.clipped_share),
        )
        for model in models
    ]
    return Sheet(
        title="Exploitability: fitness of the controllers evolved on each model",
        columns=("model", "here", "other\nmodels", "robot", "outside\ndata", "held-\nout", "clipped"),
        rows=tuple(rows),
        note=(
            "outside data: share of visited (state, control) pairs farther from the training data than its own 99 % "
            "nearest-neighbour distance (leave one out, channels in standard deviations); held-out: the same for the "
            "test data. clipped: share of steps whose state was clipped to the model's envelope."
        ),
    )


def probe_sheet(models: tuple[ModelExploitability, ...]) -> Sheet:
    """The limit of every probe that saw something, and the shares of steps beyond it, outside the data first."""
    probes = [[model.probes[i] for model in models] for i in range(len(models[0].probes))]
    loud = [
        row for row in probes if any(_seen(share) for one in row for share in (one.visited, one.robot, one.held_out))
    ]
    quiet = [row[0].name.replace("_", " ") for row in probes if row not in loud]
    first = [row[0] for row in loud]
    limits = [f"> {probe.limit:.3g} {probe.unit}" if probe.limit is not None else "no data" for probe in first]
    heads = [lines(folded(p.name).replace("_", " "), limit) for p, limit in zip(first, limits, strict=True)]
    shares = [(model.outside_visited, *(row[i].visited for row in loud)) for i, model in enumerate(models)]
    on_robot = [(model.outside_robot, *(row[i].robot for row in loud)) for i, model in enumerate(models)]
    normal = (models[0].outside_held_out, *(probe.held_out for probe in first))
    rows = [
        (model.model, *(lines(percent(s), _on_robot(r)) for s, r in zip(seen, robot, strict=True)))
        for model, seen, robot in zip(models, shares, on_robot, strict=True)
    ]
    return Sheet(
        title="What controllers do that the data do not show: shares of visited steps",
        columns=("model", "outside\nthe data", *heads),
        rows=(*rows, ("held-out data", *(percent(share) for share in normal))),
        note=(
            "Beyond 1.15 times the 99.9 % quantile of each probe in the training data (1.6 times for what a recording "
            "smooths: yaw acceleration, at once). Controllers evolved on each model, run on it; below, the same "
            "controllers on the robot."
            + (f" In less than 0.1 % of the steps anywhere: {', '.join(quiet)}." if quiet else "")
        ),
        heat=Heat(tuple(tuple(_depth(share) for share in row) for row in (*shares, normal)), alarm=True),
    )


def _seen(share: float | None) -> bool:
    """Whether a share is more than next to nothing."""
    return share is not None and share > FAINTEST


def _trials(matrix: TransferMatrix) -> str:
    """Say how many trials a cell has; on a robot that is driven there may be fewer."""
    counts = sorted({cell.trials for cell in matrix.cells.values() if cell.trials})
    if len(counts) > 1:
        return f"{counts[0]} to {counts[-1]} fresh trials, the first ones the same in every cell."
    return f"{matrix.trials} fresh trials, the same in every cell."


def _with_consensus(matrix: TransferMatrix) -> tuple[str | None, ...]:
    """Return the columns with None for the consensus of other families, before the robots, if these are several."""
    families = {matrix.families[column] for column in matrix.models}
    robots = tuple(column for column in matrix.columns if column not in matrix.models)
    return (*matrix.models, *((None,) if len(families) > 2 else ()), *robots)


def _value(figure: PairedEstimate | None) -> float:
    return float("nan") if figure is None else figure.value


def _consensus_cell(figure: PairedEstimate | None) -> str:
    return "–" if figure is None else f"{number(figure.value)} ±{number(figure.standard_error)}"


def _fitness_cell(cell: Cell, own: bool) -> str:
    if cell.failed:
        return "–" if cell.reason == NOT_RUN else "failed"
    return lines(
        f"{'= ' if own else ''}{number(cell.mean)} ({number(cell.std)})",
        f"clip {percent(cell.clipped_share)}" if cell.clipped_share > 0 else "",
        f"div {percent(cell.diverged_share)}" if cell.diverged_share > 0 else "",
        f"{len(cell.missing)} missing" if cell.missing else "",
    )


def _controller_row(controller: ControllerSummary, summary: TransferSummary, robot: bool) -> tuple[str, ...]:
    row = [
        lines(controller.name, "(chosen)" if controller.name == summary.pick else ""),
        lines(plus_minus(controller.claimed), of_each_run(controller)),
        plus_minus(controller.others),
        plus_minus(controller.exploitation_gap),
        plus_minus(controller.other_families),
    ]
    if robot:
        row += [plus_minus(controller.achieved), plus_minus(controller.reality_gap)]
    return tuple(row)


def _on_robot(share: float | None) -> str:
    return f"robot {percent(share)}" if share else ""


def _depth(share: float | None) -> float | None:
    """Return the shade of a share, from 0 at 0.1 % to 1 at all; the scale is logarithmic."""
    return None if share is None or share <= FAINTEST else 1.0 - float(np.log10(share) / np.log10(FAINTEST))
