"""Evolve, exploit, coevolve, transfer, match, export: controllers."""

from __future__ import annotations

import json as json_format
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from evaluation.members import (
    check_evolution,
    check_fit,
    contenders,
    dynamics_of,
    find_column,
    has_dynamics,
    is_model_of_a_run,
    matrix_of,
    other_models,
    places,
)
from evaluation.run_evolution import (
    _looked_at,
    again_of,
    cells_of,
    chosen_from,
    forecast_from,
    forecast_sentence,
    plan_of,
    regions_of,
)
from sysid_evo.cli.console import SOME_FAILED, out, session, tell
from sysid_evo.cli.options import (
    Aggregate,
    Caution,
    Controller,
    DryRun,
    EstimatorDelay,
    Generations,
    Jobs,
    Json,
    Noise,
    Plugins,
    Preset,
    Recipe,
    Runs,
    Schedule,
    Scheduler,
    Seed,
    Strategy,
    Task,
    Trials,
    given,
    listed,
    load_plugins,
    seconds,
    split_members,
)
from sysid_evo.cli.progress import Bars, carry_out

if TYPE_CHECKING:
    from evaluation.exploitability import ModelExploitability
    from sysid_evo.evolution.champion import Champion
    from sysid_evo.export.exported_controller import Law, Real


def evolve(
    against: Annotated[str, typer.Option(help="Fitted models or robots, separated by commas.")],
    aggregate: Aggregate = None,
    noise: Noise = None,
    caution: Caution = None,
    task: Task = None,
    controller: Controller = None,
    strategy: Strategy = None,
    recipe: Recipe = None,
    run: Annotated[Path | None, typer.Option(help="Run folder with the models (default: the newest).")] = None,
    preset: Preset = "standard",
    generations: Generations = None,
    trials: Trials = None,
    runs: Runs = None,
    estimator_delay: EstimatorDelay = None,
    schedule: Schedule = None,
    seed: Seed = None,
    plugin: Plugins = None,
    jobs: Jobs = None,
    scheduler: Scheduler = None,
    dry_run: DryRun = False,
    json: Json = False,
) -> None:
    """Evolve a controller against one model or against an ensemble of them at once.

    A model is named as it was when it was fitted in the run folder, by the path of its file, or by the
    name of an emulated robot. Against robots and files alone, the controller is stored in a new run
    folder unless --run names one. For a real robot give the delay that `sysid-evo robots check` tells,
    so that controllers meet it in the models.
    """
    from evaluation.cells.controllers import evolution_settings
    from evaluation.experiment import Experiment
    from evaluation.run_folder import check_run_folder, latest_run_folder
    from sysid_evo.cli.recordings import print_regions
    from sysid_evo.plan.store import Store

    load_plugins(plugin)
    settings = given(
        aggregate=aggregate,
        noise=noise,
        caution=caution,
        task=task,
        controller=controller,
        strategy=strategy,
        recipe=recipe,
        schedule=schedule,
        preset=preset,
        generations=generations,
        trials=trials,
        runs=runs,
        estimator_delay=seconds(estimator_delay),
        seed=seed,
        plugins=None if plugin is None else tuple(str(path.resolve()) for path in plugin),
    )
    experiment = Experiment.of(settings)
    members = split_members(against)
    alone = run is None and not any(is_model_of_a_run(member) for member in members)
    store = Store(check_run_folder(None) if alone else latest_run_folder(run))
    columns = tuple(find_column(store, member) for member in members)
    evolution = evolution_settings(experiment)
    for doubt in check_evolution(store, columns, evolution):
        tell(doubt, label="note: ", style="dim")
    champion, claims, elsewhere = cells_of(experiment, store, columns)
    plan = plan_of(champion, claims, elsewhere, again=again_of(store, settings, members))
    outcomes = carry_out(plan, store, dry_run=dry_run, json=json, jobs=jobs, scheduler=scheduler)
    if outcomes is None:
        return
    failed = [cell for cell in plan if outcomes[cell.digest].failed]
    file = f"{store.where(champion)}.json"
    found: dict[str, Any] = {"controller": champion.name, "file": file, "claims": {}}
    if champion not in failed:
        unit = ""
        for cell in claims:
            value = store.outcome(cell).value
            if value is not None:
                unit = value.unit
                found["claims"][cell.column.label] = {"mean": value.mean, "std": value.std, "trials": value.trials}
        on_models = all(column.robot is None for column in columns)
        runs_there = (*claims, *elsewhere) if on_models else ()
        expected = forecast_from(store, store.outcome(champion).value, runs_there)
        found["forecast"] = None if expected is None else asdict(expected)
        models = {column.label: dynamics_of(store, column) for column in columns if has_dynamics(column)}
        regions = regions_of(store.outcome(champion).value, models)
        if json:
            unrecorded = [region.sentence for region in regions]
            out.print_json(json_format.dumps({**found, "unit": unit, "record_next": unrecorded}))
        else:
            for label, claim in found["claims"].items():
                fresh = f"{claim['trials']} fresh trials, whose standard deviation is {claim['std']:.1f}"
                out.print(f"{label}: {claim['mean']:.1f} {unit} in {fresh}", highlight=False, markup=False)
            if expected is not None:
                chosen = chosen_from(champion, store)
                out.print(forecast_sentence(expected, unit, chosen=chosen), highlight=False, markup=False)
            print_regions(champion.name, regions)
            out.print(f"stored as {file}", highlight=False, markup=False, soft_wrap=True)
    if failed:
        raise typer.Exit(SOME_FAILED)


GENERATIONS = 200


def exploit(
    model: Annotated[str, typer.Argument(help="A fitted model of the run, by its name or its file.")],
    run: Annotated[Path | None, typer.Option(help="Run folder with the models (default: the newest).")] = None,
    robot: Annotated[str | None, typer.Option(help="Emulated robot to show what it is worth there.")] = None,
    task: Task = None,
    controller: Controller = None,
    strategy: Strategy = None,
    preset: Preset = "quick",
    generations: Generations = None,
    trials: Trials = None,
    seed: Seed = None,
    plugin: Plugins = None,
    dry_run: DryRun = False,
    json: Json = False,
) -> None:
    """Search the controller that gains most in one model and in no other, and say how it cheats.

    The other models of the run that are of other families and predict well are compared with: evolution climbs the
    fitness in MODEL less the median of theirs.
    """
    from evaluation.cells.assessment import SearchCell
    from evaluation.cells.controllers import evolution_settings
    from evaluation.experiment import Experiment
    from evaluation.run_folder import latest_run_folder
    from sysid_evo.plan.plan import Plan
    from sysid_evo.plan.store import Store

    load_plugins(plugin)
    settings = given(
        task=task,
        controller=controller,
        strategy=strategy,
        preset=preset,
        generations=generations or GENERATIONS,
        trials=trials,
        seed=seed,
    )
    experiment = Experiment.of(settings)
    store = Store(latest_run_folder(run))
    target = find_column(store, model)
    others = tuple(one for one in other_models(store, (target,)) if one.registered != target.registered)
    evolution = evolution_settings(experiment)
    check_evolution(store, (target,), evolution)
    cell = SearchCell(target, others, evolution, experiment.seed)
    outcomes = carry_out(Plan.of([cell]), store, dry_run=dry_run, json=json)
    if outcomes is None:
        return
    if outcomes[cell.digest].failed:
        raise typer.Exit(SOME_FAILED)
    champion: Champion = store.load(cell)
    columns = (target, *others, *(() if robot is None else (find_column(store, robot),)))
    matrix, found = _looked_at(champion, target, columns, store, experiment.seed, robot is not None)
    shown = {column: matrix.cell(champion.name, column).mean for column in matrix.columns}
    file = f"{store.where(cell)}.json"
    if json:
        from evaluation.exploitability import card
        from evaluation.exploitability.results import exploitability_to_json

        told: dict[str, Any] = {"model": target.label, "fitness": shown, "unit": matrix.unit, "file": file}
        told["card"] = [] if found is None else list(card(found))
        told["exploitability"] = None if found is None else exploitability_to_json(found)
        out.print_json(json_format.dumps(told))
        return
    _print(champion.name, shown, matrix.unit, found)
    out.print(f"stored as {file}", highlight=False, markup=False, soft_wrap=True)


def _print(name: str, shown: dict[str, float], unit: str, found: ModelExploitability | None) -> None:
    from rich.text import Text

    from evaluation.exploitability import card

    (target, here), *others = shown.items()
    elsewhere = ", ".join(f"{label} {value:.1f}" for label, value in others)
    out.print(Text(f"{name}: {here:.1f} {unit} in {target}; {elsewhere}"))
    for sentence in () if found is None else card(found)[1:]:
        out.print(Text(f"  {sentence}"))


SUFFIXES = {"python": ".py", "c": ".c", "onnx": ".onnx"}

REALS = ("double", "float")


def export(
    controller: Annotated[Path, typer.Argument(help="File of an evolved controller, as RUN/controllers/NAME.")],
    to: Annotated[str, typer.Option(help="python (NumPy only), c (C99 without allocation) or onnx.")],
    file: Annotated[Path | None, typer.Option("--out", help="New file (default: NAME with its suffix, here).")] = None,
    name: Annotated[str | None, typer.Option(help="What it is called in the file (default: its own name).")] = None,
    real: Annotated[str, typer.Option(help="Precision of C and ONNX: double or float.")] = "double",
    plugin: Plugins = None,
) -> None:
    """Write an evolved controller as one file: from its observations, in order, to legal controls.

    The file says what it expects, in which units, how often it is to be called, and how to use and check it.
    """
    from sysid_evo.errors import InvalidArgument
    from sysid_evo.evolution.champion import load_champion
    from sysid_evo.export.c_file import c_text
    from sysid_evo.export.exported_controller import law_of
    from sysid_evo.export.onnx_file import onnx_bytes
    from sysid_evo.export.python_file import python_text
    from sysid_evo.files import write_atomically

    load_plugins(plugin)
    if to not in SUFFIXES:
        raise InvalidArgument(f"--to: expected {', '.join(SUFFIXES)}, got {to!r}")
    if real not in REALS:
        raise InvalidArgument(f"--real: expected {' or '.join(REALS)}, got {real!r}")
    law = replace(law_of(load_champion(controller)), called=name or "")
    path = file or Path(f"{law.name}{SUFFIXES[to]}")
    if path.exists():
        raise InvalidArgument(f"--out: {path} exists already; remove it, or name another file")
    precision: Real = "float" if real == "float" else "double"
    if to == "onnx":
        content = onnx_bytes(law, precision)
    else:
        content = (python_text(law) if to == "python" else c_text(law, precision, path.name)).encode()
    write_atomically(path, lambda temporary: temporary.write_bytes(content))
    for line in (f"{law.champion.name} written to {path}", *how_to_use(law, to, path)):
        out.print(line, highlight=False, markup=False, soft_wrap=True)


def how_to_use(law: Law, to: str, path: Path) -> tuple[str, ...]:
    """Return in a few lines what the file takes and gives, and how to call it."""
    seen = ", ".join(f"{c.name} ({c.unit})" if c.unit else c.name for c in law.observations)
    every = f"every {law.system.dt:g} s, from {seen} to {', '.join(law.system.control_names)}"
    if to == "python":
        return (
            f"use:   from {path.stem} import Controller; control = Controller().step(observation), {every}",
            f"check: python {path}",
        )
    if to == "c":
        return (
            f"use:   {law.name}_reset(&memory), then {law.name}_step(&memory, observation, control) {every}",
            f"check: cc -std=c99 -DTEST_{law.name.upper()} {path} -lm -o check && ./check",
        )
    names = ", ".join(f"memory_{name}" for name in law.program.remembered) or "none"
    return (
        f"use:   inputs observation and memory ({names}; zeros at first), outputs control and the next memory, {every}",
    )


TRIALS = 100


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
    from evaluation.report.render.terminal import to_rich
    from evaluation.report.report import transfer_to_json
    from evaluation.report.sections.behaviour import manner_sheet
    from evaluation.report.sections.controllers import standing_sheet
    from evaluation.report.sections.transfer import transfer_sheet
    from evaluation.transfer.summary import summary_of

    load_plugins(plugin)
    session.run = run
    systems = places(listed("--on", on) or (), run)
    drivers = contenders(controllers, systems[0].system, task)
    check_fit(drivers, systems)
    title = f"run {len(drivers)} controllers on {len(systems)} systems"
    with Bars() as bars:
        bars.begin(title)
        matrix = matrix_of(drivers, systems, seed=seed or 0, trials=trials, progress=bars.advance)
        bars.end(title, None)
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
