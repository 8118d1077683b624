"""`sysid-evo evolve`: a controller against a chosen ensemble of models."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sysid_evo.cli.console import err, out
from sysid_evo.cli.options import (
    EstimatorDelay,
    Plugins,
    Preset,
    Seed,
    latest_run_folder,
    load_plugins,
    new_run_folder,
    split_names,
)

if TYPE_CHECKING:
    from sysid_evo.dynamics import Dynamics


def evolve(
    against: Annotated[str, typer.Option(help="Fitted models or robots, separated by commas.")],
    aggregate: Annotated[str, typer.Option(help="How their fitnesses become one: min, mean, median.")] = "min",
    run: Annotated[Path | None, typer.Option(help="Run folder with the models (default: the newest).")] = None,
    preset: Preset = "standard",
    generations: Annotated[int | None, typer.Option(min=1, help="Instead of the preset's.")] = None,
    trials: Annotated[int | None, typer.Option(min=1, help="Of every candidate in each generation.")] = None,
    runs: Annotated[int | None, typer.Option(min=1, help="From different seeds; the best counts.")] = None,
    estimator_delay: EstimatorDelay = 0.0,
    seed: Seed = 0,
    plugin: Plugins = None,
) -> None:
    """Evolve a controller against one model or against an ensemble of them at once.

    A model is named by its family, as it stands in the run folder (or family-seed), by the path of
    its file, or by the name of an emulated robot. Against robots alone, the controller is stored in a
    new run folder unless --run names one. For a real robot give the delay that `sysid-evo robots
    check` tells, so that controllers meet it in the models.
    """
    from sysid_evo.cli.progress import Bars
    from sysid_evo.engine import DynamicsRunner
    from sysid_evo.experiment import controller_preset, ensemble_name, evolve_champions
    from sysid_evo.randomness import trial_seeds
    from sysid_evo.registry import aggregates
    from sysid_evo.store import RunFolder
    from sysid_evo.wrappers import DelayedEstimate

    load_plugins(plugin)
    members = split_names(against)
    aggregates.check(aggregate)
    alone = run is None and all(is_robot(member) for member in members)
    folder = new_run_folder(None) if alone else latest_run_folder(run)
    dynamics = {member: find_dynamics(folder, member) for member in members}
    runners = {member: DynamicsRunner(found) for member, found in dynamics.items()}
    settings = controller_preset(preset)
    settings = replace(
        settings,
        aggregate=aggregate,
        generations=generations or settings.generations,
        trials=trials or settings.trials,
        runs=runs or settings.runs,
        estimator_delay=estimator_delay / 1000.0,
    )
    system = next(iter(dynamics.values())).system
    name = ensemble_name(members, aggregate)
    with Bars() as bars:
        outcome = evolve_champions(
            RunFolder(folder), [members], runners, system, settings, seed=seed, observer=bars, reuse=False
        )[name]
    if outcome.value is None:
        raise typer.Exit(1)
    task = settings.make_task(system)
    seeds = trial_seeds(seed, 100, generation=2**32)
    for member, found in dynamics.items():
        runner = DynamicsRunner(DelayedEstimate(found, settings.estimator_delay))
        fitness = runner.run(settings.make_controller(task), outcome.value.parameters[None], task, seeds).fitness
        out.print(f"{member}: {fitness.mean():.1f} ± {fitness.std():.1f} {task.fitness_unit} in 100 fresh trials")
    err.print(f"stored as {RunFolder(folder).controller(name, seed)}", highlight=False, markup=False)


def is_robot(name: str) -> bool:
    """Whether ``name`` is that of a robot, perhaps with the seed of a variant (``name:seed``)."""
    from sysid_evo.registry import robots

    return name.split(":")[0] in robots.names()


def find_dynamics(folder: Path, name: str) -> Dynamics:
    """Return the model or emulated robot that ``name`` stands for. Raises `InvalidArgument`."""
    from sysid_evo.errors import InvalidArgument
    from sysid_evo.registry import make_robot
    from sysid_evo.store import load_model

    if is_robot(name):
        robot = make_robot(name)
        if robot.dynamics is None:
            raise InvalidArgument(f"{name} is a physical robot: controllers are evolved on models or emulated robots")
        return robot.dynamics
    if Path(name).suffix in (".json", ".safetensors"):
        return load_model(name)
    stored = sorted({path.with_suffix("") for path in (folder / "models").glob("*.json")})
    fitting = [path for path in stored if path.name == name or path.name.rpartition("-")[0] == name]
    if len(fitting) != 1:
        found = ", ".join(path.name for path in fitting or stored) or "none"
        problem = "stands for several models" if fitting else "is not among the models"
        raise InvalidArgument(f"{name!r} {problem} of {folder}: {found}")
    return load_model(fitting[0])
