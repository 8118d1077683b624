"""The tables of a report."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from evaluation.exploitability import ModelExploitability
from evaluation.labels import folded, percent
from evaluation.prediction import ErrorScore, ModelPrediction, Prediction
from evaluation.report.contents import EpisodeSummary, Report
from evaluation.report.predicting import N_IN_WORDS, horizon_name
from evaluation.report.sheets import Heat, Sheet, lines, listed, number, plus_minus, seed_range, three_digits
from evaluation.report.transferring import ONE_SEED
from evaluation.transfer import (
    NOT_RUN,
    Cell,
    ControllerSummary,
    TransferMatrix,
    TransferSummary,
)

LEAST_SHARE = 1e-3


def prediction_sheet(prediction: Prediction) -> Sheet:
    """N of every model at every horizon and in free run, with intervals."""
    horizons = prediction.horizons
    leaders: dict[int | None, set[str]] = {}
    for horizon in horizons:
        ranking = prediction.ranking(horizon)
        equal = {d.first for d in prediction.differences(horizon) if not d.significant}
        leaders[horizon] = equal | ({ranking[0].name} if ranking else set())
    rows = [
        (
            lines(model.name, _divergence(model)),
            *(_n_cell(model, model.score(horizon), model.name in leaders[horizon]) for horizon in horizons),
        )
        for model in prediction.models
    ]
    protocol = prediction.cases.protocol
    return Sheet(
        title=f"Prediction error N, {N_IN_WORDS} (0 is perfect)",
        columns=("model", *(horizon_name(prediction, h).replace(" (", "\n(") for h in horizons)),
        rows=tuple(rows),
        note=(
            "N: RMSE / standard deviation of the truth, mean over channels. "
            f"{protocol.describe(prediction.cases.system.dt)} {len(prediction.cases.windows)} windows; "
            f"free run: each whole episode from sample {protocol.first}. "
            "* best, or no significant difference from the best (paired bootstrap, single comparisons). "
            "clip: windows in which the simulation reached its clip, and the median time until then."
        ),
    )


def channel_sheet(prediction: Prediction, horizon: int | None) -> Sheet:
    """RMSE (standard deviation) [relative error] of every channel, as in Table 1 of the paper, and fit."""
    system = prediction.cases.system
    heads = [lines(channel.name, f"({channel.unit})" if channel.unit else "") for channel in system.states]
    rows = []
    for model in prediction.models:
        score = model.score(horizon)
        cells = ["failed" if model.failed else "–"] * system.nx if score is None else _channel_cells(score)
        rows.append((model.name, *cells))
    start = "from sample" if horizon is None else "from measured states,"
    protocol = prediction.cases.protocol
    begin = f"{protocol.first} of each episode" if horizon is None else f"{protocol.history} samples of history"
    return Sheet(
        title=f"Error per channel, {horizon_name(prediction, horizon)}",
        columns=("model", *heads),
        rows=tuple(rows),
        note=(
            f"RMSE (standard deviation of the error) [RMSE / RMS of the signal], then fit = 100 (1 - RMSE / std of the "
            f"truth). Simulated {start} {begin}; moving samples only."
        ),
        details=horizon is not None,
    )


def transfer_sheet(matrix: TransferMatrix) -> Sheet:
    """Mean fitness (standard deviation over trials) of every controller on every system."""
    columns = tuple(lines(folded(c), "(robot)" if c == matrix.robot else "") for c in matrix.columns)
    rows = [
        (champion.name, *(_fitness_cell(matrix.cell(champion.name, c), c in champion.against) for c in matrix.columns))
        for champion in matrix.champions
    ]
    unit = matrix.unit or "fitness"
    means = matrix.means()
    known = means[np.isfinite(means)]
    low, top = min(0.0, known.min(initial=0.0)), known.max(initial=0.0)
    shades = tuple(
        tuple((m - low) / (top - low) if np.isfinite(m) and top > low else None for m in row) for row in means
    )
    own = frozenset(
        (i, j)
        for i, champion in enumerate(matrix.champions)
        for j, column in enumerate(matrix.columns)
        if column in champion.against
    )
    robots = len(matrix.columns) - len(matrix.models)
    return Sheet(
        title=f"Transfer matrix: {unit}, mean (standard deviation over trials)",
        columns=("controller", *columns),
        rows=tuple(rows),
        note=(
            f"{_trials(matrix)} = evolved against this model. "
            "clip: steps whose state was clipped to the model's envelope; div: trials that diverged."
        ),
        heat=Heat(shades, own, len(matrix.models) if robots and matrix.models else None),
    )


def controller_sheet(matrix: TransferMatrix, summary: TransferSummary) -> Sheet:
    """Claimed and achieved fitness, and the gaps between them."""
    robot: tuple[str, ...] = ("on the\nrobot", "reality\ngap") if matrix.robot is not None else ()
    rows = [_controller_row(controller, summary, bool(robot)) for controller in summary.controllers]
    seeds = [len(controller.seed_fitness) for controller in summary.controllers if controller.claimed is not None]
    spread = f"below a claim: its range over {max(seeds)} evolution seeds. " if max(seeds, default=0) > 1 else ""
    unknown = f" {ONE_SEED}" if min(seeds, default=2) < 2 else ""
    return Sheet(
        title=f"Claimed and achieved ({matrix.unit or 'fitness'}, ± standard error)",
        columns=("controller", "claimed", "other\nmodels", "exploit.\ngap", "other\nfamilies", *robot),
        rows=tuple(rows),
        note=(
            f"claimed: on the models it was evolved against, joined as in its evolution, in fresh trials. {spread}"
            "other families: median over the models of families it was not evolved against. "
            "Gap: claimed minus achieved; exploitation on the other models, reality on the robot. "
            f"chosen: without the robot, the best on other families.{unknown}"
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
    """The limit of every probe, and the shares of steps beyond it, outside the data first."""
    first = models[0].probes
    limits = [f"> {probe.limit:.3g} {probe.unit}" if probe.limit is not None else "no data" for probe in first]
    heads = [lines(folded(p.name).replace("_", " "), limit) for p, limit in zip(first, limits, strict=True)]
    shares = [(model.outside_visited, *(probe.visited for probe in model.probes)) for model in models]
    on_robot = [(model.outside_robot, *(probe.robot for probe in model.probes)) for model in models]
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
            "Beyond the 99.9 % quantile of each probe in the training data. Controllers evolved on each model, run on "
            "it; below, the same controllers on the robot."
        ),
        heat=Heat(tuple(tuple(_depth(share) for share in row) for row in (*shares, normal)), alarm=True),
    )


def failure_sheet(report: Report) -> Sheet:
    """What could not be computed, and why."""
    rows = tuple((failure.what, failure.reason) for failure in report.all_failures)
    return Sheet("Failed", ("what", "reason"), rows, prose=True)


def episode_sheet(report: Report) -> Sheet:
    """The episodes of the data set."""
    rows = [
        (e.name, part, f"{e.duration:.1f}", str(e.steps), percent(e.moving))
        for part, episodes in (("training", report.data.training), ("test", report.data.test))
        for e in _shown(episodes)
    ]
    return Sheet("Episodes", ("episode", "used for", "seconds", "steps", "moving"), tuple(rows), details=True)


def channel_list(report: Report) -> Sheet:
    """The channels of the system."""
    system = report.data.system
    rows = [
        (
            channel.name,
            kind,
            channel.unit or "–",
            number(channel.low, 3),
            number(channel.high, 3),
            "–" if channel.levels is None else listed([f"{level:g}" for level in channel.levels]),
        )
        for kind, channels in (("state", system.states), ("control", system.controls))
        for channel in channels
    ]
    return Sheet(
        f"Channels, sampled every {system.dt:g} s",
        ("channel", "kind", "unit", "lowest", "highest", "levels"),
        tuple(rows),
        details=True,
    )


def model_sheet(report: Report) -> Sheet:
    """The models and their hyper-parameters."""
    rows = [
        (model.name, model.family, model.knowledge, listed([f"{k} = {v}" for k, v in model.parameters.items()]))
        for model in report.models
    ]
    heads = ("model", "family", "knowledge", "hyper-parameters")
    return Sheet("Models", heads, tuple(rows), details=True, prose=True)


def key_sheet(title: str, values: Mapping[str, Any]) -> Sheet:
    """Keys and values; what is nested gets a dotted key."""
    return Sheet(title, ("name", "value"), tuple(_flat(values)), details=True, prose=True)


def _flat(values: Mapping[str, Any], prefix: str = "") -> list[tuple[str, str]]:
    rows: list[tuple[str, str]] = []
    for key, value in values.items():
        if isinstance(value, Mapping):
            rows += _flat(value, f"{prefix}{key}.")
        else:
            text = value if isinstance(value, str) else json.dumps(value, default=str)
            rows.append((f"{prefix}{key}", text))
    return rows


def _shown(episodes: tuple[EpisodeSummary, ...], most: int = 40) -> tuple[EpisodeSummary, ...]:
    return episodes[:most]


def _on_robot(share: float | None) -> str:
    return f"robot {percent(share)}" if share else ""


def _depth(share: float | None) -> float | None:
    """Return the shade of a share, from 0 at 0.1 % to 1 at all; the scale is logarithmic."""
    return None if share is None or share <= LEAST_SHARE else 1.0 - float(np.log10(share) / np.log10(LEAST_SHARE))


def _n_cell(model: ModelPrediction, score: ErrorScore | None, leads: bool) -> str:
    if model.failed:
        return "failed"
    if score is None:
        return "–"
    low, high = score.interval
    return lines(f"{'* ' if leads else ''}{three_digits(score.n)}", f"{three_digits(low)}-{three_digits(high)}")


def _divergence(model: ModelPrediction) -> str:
    found = model.divergence
    if found is None or found.share == 0:
        return ""
    return f"clip {percent(found.share)}, {number(found.median_time, 2)} s"


def _channel_cells(score: ErrorScore) -> list[str]:
    cells = zip(score.rmse, score.error_std, score.relative_percent, score.fit_percent, strict=True)
    return [
        lines(f"{size:.4f} ({std:.4f})", f"[{number(rel)} %]", f"fit {number(fit)} %") for size, std, rel, fit in cells
    ]


def _trials(matrix: TransferMatrix) -> str:
    """Say how many trials a cell has; on a robot that is driven there may be fewer."""
    counts = sorted({cell.trials for cell in matrix.cells.values() if cell.trials})
    if len(counts) > 1:
        return f"{counts[0]} to {counts[-1]} fresh trials, the first ones the same in every cell."
    return f"{matrix.trials} fresh trials, the same in every cell."


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
        lines(plus_minus(controller.claimed), seed_range(controller)),
        plus_minus(controller.others),
        plus_minus(controller.exploitation_gap),
        plus_minus(controller.other_families),
    ]
    if robot:
        row += [plus_minus(controller.achieved), plus_minus(controller.reality_gap)]
    return tuple(row)
