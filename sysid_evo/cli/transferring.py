"""`sysid-evo transfer`: stored controllers on any models and robots."""

from __future__ import annotations

import json as json_format
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sysid_evo.cli.console import out, session
from sysid_evo.cli.exits import SOME_FAILED
from sysid_evo.cli.options import Json, Plugins, Seed, Task, listed, load_plugins

if TYPE_CHECKING:
    from collections.abc import Sequence

    from evaluation.transfer import TransferMatrix
    from sysid_evo.cli.contenders import Contender, Place

TRIALS = 100
TRACES = 10


def transfer(
    controllers: Annotated[
        list[str], typer.Argument(help="Files of controllers, run folders, or NAME(...) of one written by hand.")
    ],
    on: Annotated[str, typer.Option(help="Fitted models, their files, run folders, robots; separated by commas.")],
    run: Annotated[Path | None, typer.Option(help="Run folder with the models (default: the newest).")] = None,
    task: Task = None,
    trials: Annotated[int, typer.Option(min=1, help="Fresh trials, the same for all.")] = TRIALS,
    seed: Seed = None,
    plugin: Plugins = None,
    json: Json = False,
) -> None:
    """Run stored controllers on models and robots, and tell what each claims, achieves, has at worst and costs.

    A run folder stands for all its controllers, behind --on for all its models. Nothing is evolved, fitted or stored.
    """
    from evaluation.behaviour import manners
    from evaluation.forecast import summary_of
    from evaluation.report.document import transfer_to_json
    from evaluation.report.tables import manner_sheet, standing_sheet, transfer_sheet
    from evaluation.report.terminal import to_rich
    from sysid_evo.cli.contenders import check_fit, contenders, places

    load_plugins(plugin)
    session.run = run
    systems = places(listed("--on", on) or (), run)
    drivers = contenders(controllers, systems[0].system, task)
    check_fit(drivers, systems)
    matrix = matrix_of(drivers, systems, seed=seed or 0, trials=trials)
    if json:
        out.print_json(json_format.dumps(transfer_to_json(matrix)))
    else:
        sheets = [transfer_sheet(matrix), standing_sheet(matrix, summary_of(matrix))]
        for sheet in (*sheets, manner_sheet(manners(matrix), matrix.robot)):
            for part in [] if sheet is None else to_rich(sheet):
                out.print(part)
    if matrix.failures():
        for cell in () if json else matrix.failures():
            out.print(f"failed: {cell.champion} on {cell.column}: {cell.reason}", highlight=False, markup=False)
        raise typer.Exit(SOME_FAILED)


def matrix_of(
    drivers: Sequence[Contender], systems: Sequence[Place], *, seed: int, trials: int, traces: int = TRACES
) -> TransferMatrix:
    """Run every controller on every system in the same fresh trials, with a bar."""
    from evaluation.transfer import TransferMatrix, run_cell, transfer_seeds
    from sysid_evo.cli.contenders import with_models
    from sysid_evo.cli.progress import Bars
    from sysid_evo.evolution import observed_late

    families = {place.label: place.column.registered for place in systems}
    champions = []
    for one in drivers:
        champion, elsewhere = with_models(one, systems)
        champions.append(champion)
        families |= elsewhere
    robots = [place.label for place in systems if place.column.robot is not None]
    seeds, cells = transfer_seeds(seed, trials), []
    runners = {place.label: place.runner for place in systems}
    title = f"run {len(champions)} controllers on {len(systems)} systems"
    with Bars() as bars:
        bars.begin(title)
        for champion in champions:
            for label, runner in runners.items():
                late = observed_late(label, runner, champion.estimator_delay)
                cells.append(run_cell(champion, label, late, seeds, traces=traces))
                bars.advance(len(cells), len(champions) * len(systems))
        bars.end(title, None)
    return TransferMatrix.of(
        champions,
        tuple(runners),
        cells,
        families=families,
        robot=robots[-1] if robots else None,
        other_robots=robots[:-1],
    )
