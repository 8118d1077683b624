"""Evolve, exploit, transfer, export: controllers."""

from __future__ import annotations

import shlex
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.text import Text

import evaluation
import sysid_evo.export
import sysid_evo.plan
from evaluation.experiment import Experiment
from sysid_evo.cli import options
from sysid_evo.cli.console import SOME_FAILED, as_option, note, out, print_line, print_status, session
from sysid_evo.cli.options import (
    Plugins,
    argument,
    fitted_models,
    listed,
    load_plugins,
    names_of,
    number,
    option,
    with_settings,
)
from sysid_evo.cli.progress import PlanProgress, run_plan
from sysid_evo.cli.recordings import print_remarks
from sysid_evo.errors import InvalidArgument
from sysid_evo.files import write_atomically


def systems() -> list[str]:
    """Return the models of the newest run and the robots, to run controllers on."""
    return [*fitted_models(), *names_of("robot")()]


EVOLUTION = (
    "task", "controller", "strategy", "procedure", "aggregate", "starts", "noise",
    "estimator_delay", "preset", "generations", "search_minutes", "trials", "repeats", "seed", "plugins",
)  # fmt: skip
"""The settings of a comparison that one evolution has, too."""


@with_settings(Experiment, *EVOLUTION)
def evolve(
    *,
    against: Annotated[str, option("Models of the run, model files, robots; comma-separated", "LIST", panel="Models",
        values=systems)],
    run: options.Run = None, settings: dict[str, Any], jobs: options.Jobs = None, scheduler: options.Scheduler = None,
    dry_run: options.DryRun = False, as_json: options.Json = False,
) -> None:  # fmt: skip
    """Evolve a controller on one model or on an ensemble of models.

    The controller is stored in the run folder, or in a new one if --against names only robots and files. For a physical
    robot, set --estimator-delay to the value that `sysid-evo robots check` reports. Defaults are in parentheses.
    """
    load_plugins(settings.get("plugins"))
    experiment = Experiment.of(settings, as_option)
    members = _members(against)
    alone = run is None and not any(evaluation.is_model_of_a_run(member) for member in members)
    store = sysid_evo.plan.Store(evaluation.check_run_folder(None) if alone else evaluation.latest_run_folder(run))
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
    members = listed("--against", text)
    repeated = sorted({member for member in members if members.count(member) > 1})
    if repeated:
        raise InvalidArgument(f"--against: {', '.join(repeated)} is named twice")
    return members


def _print_evolved(planned: evaluation.EvolutionPlan, store: sysid_evo.plan.Store, *, as_json: bool) -> None:
    """Print claims, forecast and file of a controller, and recommended recordings."""
    name, file = planned.champion.name, f"{store.result_path(planned.champion)}.json"
    result = evaluation.evolution_result(planned, store)
    if as_json:
        document = {
            "controller": name, "file": file, "unit": result.unit,
            "claims": {label: {"mean": claim.mean, "std": claim.std, "trials": claim.trials}
                       for label, claim in result.claims.items()},
            "forecast": None if result.forecast is None else asdict(result.forecast),
            "remarks": [asdict(remark) for remark in result.remarks],
        }  # fmt: skip
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
    print_line(f"stored as {file}")
    print_status(f"run it on a robot with: sysid-evo drive --robot ROBOT --controller {shlex.quote(file)}")
    print_status(f"take it away as one file with: sysid-evo export {shlex.quote(file)} --to python")


GENERATIONS = 200
"""Generations of the search for an exploiting controller."""


@with_settings(
    Experiment, "task", "controller", "strategy", "preset", "generations", "trials", "seed", "plugins",
    generations=GENERATIONS,
)  # fmt: skip
def exploit(
    *,
    model: Annotated[str, argument("Fitted model of the run, by its name or its file", "MODEL", values=fitted_models)],
    run: options.Run = None,
    robot: Annotated[str | None, option("Emulated robot on which to score it, too", "SPEC", panel="Models",
        values=names_of("robot"))] = None,
    settings: dict[str, Any], dry_run: options.DryRun = False, as_json: options.Json = False,
) -> None:  # fmt: skip
    """Search the controller that exploits one model most.

    The objective is the fitness on MODEL minus the median of the fitness on the other models of the run that belong to
    other families and predict well. Defaults are in parentheses.
    """
    load_plugins(settings.get("plugins"))
    experiment = Experiment.of(settings, as_option)
    store = sysid_evo.plan.Store(evaluation.latest_run_folder(run))
    planned = evaluation.plan_exploit(experiment, store, model)
    outcomes = run_plan(sysid_evo.plan.Plan.of([planned.cell]), store, dry_run=dry_run, as_json=as_json)
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
            "model": planned.target.label, "fitness": {column: cell.mean for column, cell in cells.items()},
            "unit": matrix.unit, "file": file, "card": list(card), "exploitability": evaluation.plain(found),
        }  # fmt: skip
        out.print_json(data=document)
        return
    (target, here), *others = (
        (column, evaluation.by_error(cell.mean, cell.standard_error)) for column, cell in cells.items()
    )
    elsewhere = ", ".join(f"{label} {value}" for label, value in others)
    out.print(Text(f"{name}: {here} {matrix.unit} in {target}; {elsewhere}"))
    for sentence in card[1:]:
        out.print(Text(f"  {sentence}"))
    print_line(f"stored as {file}")


TRIALS = 100
"""Trials of each controller on each system."""


def transfer(
    controllers: Annotated[list[str], argument("Controller files, run folders, or SPEC of a baseline controller",
        "CONTROLLERS")],
    on: Annotated[str, option("Models, model files, run folders, robots; comma-separated", "LIST", panel="Models",
        values=systems)],
    run: options.Run = None,
    task: Annotated[str | None, option("Task of the controllers", "SPEC", panel="Controllers",
        values=names_of("task"))] = None,
    trials: Annotated[int, option("Trials, the same for all", "N", panel="Budget", shown=str(TRIALS),
        parser=number(1))] = TRIALS,
    seed: options.Seed = None, plugin: options.Plugins = None, as_json: options.Json = False,
) -> None:  # fmt: skip
    """Run stored controllers on models and robots; report their fitness.

    Reports predicted and measured fitness, worst trial and run time. A run folder means all its controllers, after --on
    all its models. Nothing is evolved, fitted or stored.
    """
    load_plugins(plugin)
    session.run = None if run is None else sysid_evo.plan.Store(run)
    systems = evaluation.transfer_targets(listed("--on", on), run)
    robots = [place.column.robot for place in systems]
    drivers = evaluation.stored_controllers(controllers, systems[0].system, task, robots=robots)
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


SUFFIXES = {"python": ".py", "c": ".c"}
REALS = ("double", "float")


def export(
    controller: Annotated[Path, argument("File of an evolved controller: RUN/controllers/NAME", "CONTROLLER")],
    to: Annotated[str, option("python (NumPy only) or c (C99 without allocation)", "NAME", panel="File",
        values=lambda: SUFFIXES)],
    file: Annotated[Path | None, option("File to write", "FILE", "--out", panel="File",
        shown="NAME with its suffix")] = None,
    name: Annotated[str | None, option("Name of the controller in the file", "NAME", panel="File",
        shown="its own name")] = None,
    real: Annotated[str, option("Precision of C: double or float", "NAME", panel="File", shown="double",
        values=lambda: REALS)] = "double",
    plugin: Plugins = None,
) -> None:  # fmt: skip
    """Write a controller as a Python or C file.

    The file computes controls from observations. Its head states inputs, outputs, units and sampling time, and how to
    use and check it.
    """
    load_plugins(plugin)
    if to not in SUFFIXES:
        raise InvalidArgument(f"--to: expected {', '.join(SUFFIXES)}, got {to!r}")
    if real not in REALS:
        raise InvalidArgument(f"--real: expected {' or '.join(REALS)}, got {real!r}")
    # a copy of another file, to be used under this name
    chosen = evaluation.CHOSEN if controller.stem == evaluation.CHOSEN else ""
    law = replace(sysid_evo.export.exported_controller(sysid_evo.load_champion(controller)), called=name or chosen)
    path = file or Path(f"{law.name}{SUFFIXES[to]}")
    if path.exists():
        raise InvalidArgument(f"--out: {path} exists already; remove it, or name another file")
    precision: sysid_evo.export.Real = "float" if real == "float" else "double"
    text = sysid_evo.export.python_text(law) if to == "python" else sysid_evo.export.c_text(law, precision, path.name)
    write_atomically(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))
    for line in (f"{law.champion.name} written to {path}", *how_to_use(law, to, path)):
        print_line(line)


def how_to_use(law: sysid_evo.export.ExportedController, to: str, path: Path) -> tuple[str, ...]:
    """Return the inputs and outputs of the file and how to call it, in a few lines."""
    seen = ", ".join(f"{c.name} ({c.unit})" if c.unit else c.name for c in law.observations)
    every = f"every {law.system.dt:g} s, from {seen} to {', '.join(law.system.control_names)}"
    if to == "python" and law.raw is not None:
        return (
            f"use:   from {path.stem} import Controller; controller = Controller(); env.step(controller(observation)), "
            "from the raw observation of the environment to its raw action",
            f"check: python {path}",
        )
    if to == "python":
        return (
            f"use:   from {path.stem} import Controller; control = Controller().step(observation), {every}",
            f"check: python {path}",
        )
    return (
        f"use:   {law.name}_reset(&memory), then {law.name}_step(&memory, observation, control) {every}",
        f"check: cc -std=c99 -DTEST_{law.name.upper()} {path} -lm -o check && ./check",
    )
