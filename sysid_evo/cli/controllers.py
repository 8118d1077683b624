"""Evolve, exploit, transfer: controllers."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from rich.text import Text

import evaluation
from evaluation.experiment import Experiment
from sysid_evo.cli import options
from sysid_evo.cli.console import SOME_FAILED, note, out, say, session
from sysid_evo.cli.options import listed, load_plugins, settings_of
from sysid_evo.cli.progress import PlanProgress, run_plan
from sysid_evo.cli.recordings import print_remarks
from sysid_evo.errors import InvalidArgument
from sysid_evo.plan.plan import Plan
from sysid_evo.plan.store import Store


def evolve(
    against: Annotated[str, typer.Option(help="Fitted models or robots, separated by commas.")],
    aggregate: options.Aggregate = None,
    noise: options.Noise = None,
    penalty: options.Penalty = None,
    task: options.Task = None,
    controller: options.Controller = None,
    strategy: options.Strategy = None,
    procedure: options.Procedure = None,
    run: Annotated[Path | None, typer.Option(help="Run folder with the models (default: the newest).")] = None,
    preset: options.Preset = None,
    generations: options.Generations = None,
    trials: options.Trials = None,
    repeats: options.Repeats = None,
    estimator_delay: options.EstimatorDelay = None,
    schedule: options.Schedule = None,
    seed: options.Seed = None,
    plugin: options.Plugins = None,
    jobs: options.Jobs = None,
    scheduler: options.Scheduler = None,
    dry_run: options.DryRun = False,
    as_json: options.Json = False,
) -> None:
    """Evolve a controller against one model or against an ensemble of them at once.

    A model is named as it was when it was fitted in the run folder, by the path of its file, or by the
    name of an emulated robot. Against robots and files alone, the controller is stored in a new run
    folder unless --run names one. For a real robot give the delay that `sysid-evo robots check` tells,
    so that controllers meet it in the models.
    """
    load_plugins(plugin)
    experiment = Experiment.of(settings_of(locals(), Experiment.model_fields))
    members = _members(against)
    alone = run is None and not any(evaluation.is_model_of_a_run(member) for member in members)
    store = Store(evaluation.check_run_folder(None) if alone else evaluation.latest_run_folder(run))
    planned = evaluation.plan_evolution(experiment, store, members)
    for remark in planned.remarks:
        note(remark)
    outcomes = run_plan(planned.plan, store, dry_run=dry_run, as_json=as_json, jobs=jobs, scheduler=scheduler)
    if outcomes is None:
        return
    if not outcomes[planned.champion.digest].failed:
        _print_evolved(planned, store, as_json=as_json)
    if any(outcomes[cell.digest].failed for cell in planned.plan):
        raise typer.Exit(SOME_FAILED)


def _members(text: str) -> tuple[str, ...]:
    """Split ``a,b,c`` at the commas outside brackets. Raises `InvalidArgument`."""
    members = listed("--against", text) or ()
    repeated = sorted({member for member in members if members.count(member) > 1})
    if repeated:
        raise InvalidArgument(f"--against: {', '.join(repeated)} is named twice")
    return members


def _print_evolved(planned: evaluation.EvolutionPlan, store: Store, *, as_json: bool) -> None:
    """Print what a controller claims, what is expected on the robot, what to record next, and where it is."""
    name, file = planned.champion.name, f"{store.result_path(planned.champion)}.json"
    result = evaluation.evolution_result(planned, store)
    if as_json:
        claims = {
            label: {"mean": claim.mean, "std": claim.std, "trials": claim.trials}
            for label, claim in result.claims.items()
        }
        document = {
            "controller": name,
            "file": file,
            "claims": claims,
            "forecast": None if result.forecast is None else asdict(result.forecast),
            "unit": result.unit,
            "remarks": [asdict(remark) for remark in result.remarks],
        }
        out.print_json(data=document)
        return
    for label, claim in result.claims.items():
        spread = evaluation.by_error(claim.std, claim.standard_error)
        fresh = f"{claim.trials} fresh trials, whose standard deviation is {spread}"
        mean = evaluation.by_error(claim.mean, claim.standard_error)
        out.print(f"{label}: {mean} {result.unit} in {fresh}", highlight=False, markup=False)
    if result.forecast is not None:
        out.print(result.forecast_sentence, highlight=False, markup=False)
    if result.remarks:
        print_remarks(result.remarks)
    say(f"stored as {file}")


GENERATIONS = 200
"""Of a search for an exploit, unless told otherwise."""


def exploit(
    model: Annotated[str, typer.Argument(help="A fitted model of the run, by its name or its file.")],
    run: Annotated[Path | None, typer.Option(help="Run folder with the models (default: the newest).")] = None,
    robot: Annotated[str | None, typer.Option(help="Emulated robot to show what it is worth there.")] = None,
    task: options.Task = None,
    controller: options.Controller = None,
    strategy: options.Strategy = None,
    preset: options.Preset = None,
    generations: options.Generations = None,
    trials: options.Trials = None,
    seed: options.Seed = None,
    plugin: options.Plugins = None,
    dry_run: options.DryRun = False,
    as_json: options.Json = False,
) -> None:
    """Search the controller that gains most in one model and in no other, and say how it cheats.

    The other models of the run that are of other families and predict well are compared with: evolution climbs the
    fitness in MODEL less the median of theirs.
    """
    load_plugins(plugin)
    settings = settings_of({**locals(), "robot": None}, Experiment.model_fields)
    experiment = Experiment.of({"generations": GENERATIONS, **settings})
    store = Store(evaluation.latest_run_folder(run))
    planned = evaluation.plan_exploit(experiment, store, model)
    outcomes = run_plan(Plan.of([planned.cell]), store, dry_run=dry_run, as_json=as_json)
    if outcomes is None:
        return
    if outcomes[planned.cell.digest].failed:
        raise typer.Exit(SOME_FAILED)
    matrix, found = evaluation.exploit_result(planned, store, seed=experiment.seed, robot=robot)
    (name,) = matrix.rows
    cells = {column: matrix.cell(name, column) for column in matrix.columns}
    card = () if found is None else evaluation.exploitability_card(found)
    file = f"{store.result_path(planned.cell)}.json"
    if as_json:
        document = {
            "model": planned.target.label,
            "fitness": {column: cell.mean for column, cell in cells.items()},
            "unit": matrix.unit,
            "file": file,
            "card": list(card),
            "exploitability": evaluation.plain(found),
        }
        out.print_json(data=document)
        return
    (target, here), *others = (
        (column, evaluation.by_error(cell.mean, cell.standard_error)) for column, cell in cells.items()
    )
    elsewhere = ", ".join(f"{label} {value}" for label, value in others)
    out.print(Text(f"{name}: {here} {matrix.unit} in {target}; {elsewhere}"))
    for sentence in card[1:]:
        out.print(Text(f"  {sentence}"))
    say(f"stored as {file}")


TRIALS = 100
"""Fresh trials of every controller on every system."""


def transfer(
    controllers: Annotated[
        list[str], typer.Argument(help="Files of controllers, run folders, or NAME(...) of one written by hand.")
    ],
    on: Annotated[str, typer.Option(help="Fitted models, their files, run folders, robots; separated by commas.")],
    run: Annotated[Path | None, typer.Option(help="Run folder with the models (default: the newest).")] = None,
    task: options.Task = None,
    trials: Annotated[int, typer.Option(min=1, help="Fresh trials, the same for all.")] = TRIALS,
    seed: options.Seed = None,
    plugin: options.Plugins = None,
    as_json: options.Json = False,
) -> None:
    """Run stored controllers on models and robots, and tell what each claims, achieves, has at worst and costs.

    A run folder stands for all its controllers, behind --on for all its models. Nothing is evolved, fitted or stored.
    """
    load_plugins(plugin)
    session.run = None if run is None else Store(run)
    systems = evaluation.transfer_targets(listed("--on", on) or (), run)
    robots = [place.column.robot for place in systems]
    drivers = evaluation.contenders(controllers, systems[0].system, task, robots=robots)
    evaluation.check_fit(drivers, systems)
    title = f"run {len(drivers)} controllers on {len(systems)} systems"
    with PlanProgress() as bars:
        bars.begin(title)
        matrix = evaluation.matrix_of(drivers, systems, seed=seed or 0, trials=trials, progress=bars.advance)
        bars.end(title, None)
    if as_json:
        out.print_json(data=evaluation.transfer_to_json(matrix))
    else:
        for part in evaluation.transfer_tables(matrix):
            out.print(part)
    if matrix.failures():
        for cell in () if as_json else matrix.failures():
            out.print(f"failed: {cell.champion} on {cell.column}: {cell.reason}", highlight=False, markup=False)
        raise typer.Exit(SOME_FAILED)
