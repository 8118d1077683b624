"""`sysid-evo coevolve` and `sysid-evo match`: controllers against each other."""

from __future__ import annotations

import json as json_format
import shlex
from pathlib import Path
from typing import Annotated, Any

import typer

from sysid_evo.cli.console import out, session
from sysid_evo.cli.options import (
    Aggregate,
    Controller,
    Generations,
    Json,
    Plugins,
    Seed,
    Strategy,
    Trials,
    given,
    latest_run_folder,
    load_plugins,
)

GENERATIONS, TRIALS = 100, 3


def coevolve(
    against: Annotated[str, typer.Option(help="Fitted models or emulated robots that both race on, by commas.")],
    task: Annotated[str, typer.Option(help="The race: duel(parameter=value, ...).")] = "duel",
    name: Annotated[str, typer.Option(help="What the champions are called: NAME-1 and NAME-2.")] = "rival",
    populations: Annotated[int, typer.Option(min=1, max=2, help="Two, or one that is its own rival.")] = 2,
    run: Annotated[Path | None, typer.Option(help="Run folder with the models (default: the newest).")] = None,
    controller: Controller = None,
    strategy: Strategy = None,
    aggregate: Aggregate = None,
    generations: Generations = None,
    trials: Trials = None,
    seed: Seed = None,
    plugin: Plugins = None,
    json: Json = False,
) -> None:
    """Evolve controllers against each other, two bodies in each race.

    They are stored in the run folder; the same command goes on where it was stopped.
    """
    from evaluation.comparison import check_run_folder
    from sysid_evo.cli.columns import dynamics_of, find_column, is_model_of_a_run, split_members
    from sysid_evo.cli.progress import Bars
    from sysid_evo.engine import DynamicsRunner
    from sysid_evo.evolution import ControllerEvolution
    from sysid_evo.plan import Store
    from sysid_evo.registry import Spec
    from sysid_evo.rivals import evolve_rivals
    from sysid_evo.rivals.meeting import duel_of
    from sysid_evo.store import CheckpointFile, save_champion

    load_plugins(plugin)
    named = given(task=task, controller=controller, strategy=strategy)
    chosen: dict[str, Any] = {option: Spec.parse(text) for option, text in named.items()} | given(aggregate=aggregate)
    settings = ControllerEvolution(generations=generations or GENERATIONS, trials=trials or TRIALS, **chosen)
    duel_of(settings.task)
    members = split_members(against)
    alone = run is None and not any(is_model_of_a_run(member) for member in members)
    store = Store(check_run_folder(None) if alone else latest_run_folder(run))
    columns = {column.label: column for column in (find_column(store, member) for member in members)}
    runners = {label: DynamicsRunner(dynamics_of(store, column)) for label, column in columns.items()}
    system = next(iter(runners.values())).dynamics.system
    session.run, folder, title = store.path, store.path / "controllers", f"coevolve {name}"
    folder.mkdir(parents=True, exist_ok=True)
    checkpoint = CheckpointFile(folder / f"{name}.checkpoint")
    with Bars(f"--run {shlex.quote(str(store.path))}") as bars:
        bars.begin(title)
        champions = evolve_rivals(
            name,
            runners,
            system,
            settings,
            seed=seed or 0,
            populations=populations,
            checkpoint=checkpoint,
            progress=bars.advance,
        )
        bars.end(title, None)
    files = [save_champion(champion, folder / champion.name) for champion in champions]
    checkpoint.path.unlink(missing_ok=True)
    found = [
        {"controller": one.name, "file": str(file), "lead": one.seed_fitness[0]}
        for one, file in zip(champions, files, strict=True)
    ]
    if json:
        out.print_json(json_format.dumps(found))
        return
    for row in found:
        told = f"{row['controller']}: {row['lead']:+.1f} m ahead of the other's best; stored as {row['file']}"
        out.print(told, highlight=False, markup=False, soft_wrap=True)


def match(
    first: Annotated[Path, typer.Argument(help="File of a controller.")],
    second: Annotated[Path, typer.Argument(help="File of its rival.")],
    robot: Annotated[str, typer.Option(help="Emulated robot, or file of a model, that both race on.")] = "emulated_car",
    task: Annotated[str, typer.Option(help="The race: duel(parameter=value, ...).")] = "duel",
    trials: Annotated[int, typer.Option(min=1, help="Races.")] = 100,
    seed: Seed = None,
    plugin: Plugins = None,
    json: Json = False,
) -> None:
    """Let two stored controllers race, and tell who wins how often.

    Champions of a duel see each other; those of walled_track race as if they were alone.
    """
    import numpy as np

    from sysid_evo.cli.columns import is_file
    from sysid_evo.errors import InvalidArgument
    from sysid_evo.registry import make_robot
    from sysid_evo.rivals import match as race
    from sysid_evo.store import load_champion, load_model

    load_plugins(plugin)
    champions = [load_champion(path.with_suffix("")) for path in (first, second)]
    dynamics = load_model(robot) if is_file(robot) else make_robot(robot).dynamics
    if dynamics is None:
        raise InvalidArgument(f"--robot: {robot} is no program that two bodies can be made of")
    met = race(champions[0], champions[1], dynamics, task=task, trials=trials, seed=seed or 0)
    lead, error = float(met.lead.mean()), float(met.lead.std() / np.sqrt(len(met.lead)))
    if json:
        out.print_json(json_format.dumps({"won": met.won, "lead": lead, "error": error, "trials": trials}))
        return
    told = f"{champions[0].name} wins {100.0 * met.won:.0f} % of {trials} races against {champions[1].name}"
    out.print(f"{told}; on average it ends {lead:+.2f} ± {error:.2f} m ahead", highlight=False, soft_wrap=True)
