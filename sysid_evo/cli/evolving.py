"""`sysid-evo evolve`: a controller against a chosen ensemble of models."""

from __future__ import annotations

import json as json_format
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sysid_evo.cli.columns import (
    check_evolution,
    dynamics_of,
    find_column,
    has_dynamics,
    is_file,
    is_model_of_a_run,
    other_models,
    record_of_file,
    split_members,
)
from sysid_evo.cli.console import out, tell
from sysid_evo.cli.exits import SOME_FAILED
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
    latest_run_folder,
    load_plugins,
    seconds,
)
from sysid_evo.cli.plans import carry_out

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from evaluation.comparison import Column, Experiment, RunCell
    from evaluation.comparison.champion_cells import ChampionCell
    from sysid_evo.plan import Again, Plan, Store

CLAIM_TRIALS = 100
AGAIN = "sysid_evo.cli.evolving:plan_again"
"""What makes the plan of a command again in another process."""


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
    from evaluation.comparison import Experiment, check_run_folder
    from sysid_evo.cli.expecting import forecast_from, forecast_sentence
    from sysid_evo.cli.unrecorded import print_regions, regions_of
    from sysid_evo.plan import Store

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
    evolution = experiment.evolution
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


def cells_of(
    experiment: Experiment, store: Store, columns: tuple[Column, ...]
) -> tuple[ChampionCell, tuple[RunCell, ...], tuple[RunCell, ...]]:
    """Return the cell of the controller against ``columns``, those of its claims there, and on the run's other models.

    What is evolved on a robot is run nowhere else: there is nothing to forecast.
    """
    from evaluation.comparison import RunCell, controller_cell
    from sysid_evo.cli.expecting import by_label

    others = other_models(store, columns)
    champion = controller_cell(experiment, columns, judges=columns + others)
    delay = experiment.evolution.estimator_delay

    def on(column: Column) -> RunCell:
        return RunCell(champion, column, delay, CLAIM_TRIALS, 0, experiment.seed)

    labels = {column.label for column in columns}
    models = [] if any(column.robot is not None for column in columns) else by_label(others)
    return champion, tuple(map(on, columns)), tuple(on(column) for column in models if column.label not in labels)


def plan_of(
    champion: ChampionCell, claims: Sequence[RunCell], elsewhere: Sequence[RunCell], again: Again | None = None
) -> Plan:
    """Return the plan of a controller, its claims, and what its forecast is made of where it is run elsewhere."""
    from sysid_evo.plan import Plan

    judged = (*claims, *elsewhere) if len(claims) + len(elsewhere) > 1 else ()
    predictions = [run.column.prediction for run in judged if run.column.prediction is not None]
    return Plan.of([champion, *claims, *elsewhere, *predictions], again=again)


def chosen_from(champion: ChampionCell, store: Store) -> int:
    """Return from how many finalists a controller was chosen by their forecasts, 0 where it was not."""
    from evaluation.comparison.champion_cells import ChooseCell, PolishCell

    choice = champion.chosen if isinstance(champion, PolishCell) else champion
    if not isinstance(choice, ChooseCell):
        return 0
    return sum(one.elsewhere is not None for one in store.outcome(choice).value.finalists)


def again_of(store: Store, settings: Mapping[str, Any], members: Sequence[str]) -> Again:
    """Return how another process makes the plan of this command: of the run's models, their data, and further files."""
    from evaluation.comparison.model_cells import files_of
    from sysid_evo.plan import Again
    from sysid_evo.store import stored_file

    records = {record.digest: record for record in store.records() if record.status == "done"}
    fits = [record for record in records.values() if record.kind == "fit"]
    data = dict.fromkeys(digest for record in fits for digest in record.needs if digest in records)
    texts = (*settings.get("plugins", ()), *members)
    files: dict[str, tuple[str, ...]] = {text: (text,) for text in texts if Path(text).is_file()}
    names = []
    for member in members:
        manifest = stored_file(member, "model") if is_file(member) else None
        own = None if manifest is None else record_of_file(store, manifest)
        if manifest is not None and own is None:
            files[member] = tuple(map(str, files_of(manifest)))
        names.append(member if own is None else Path(own.artefact).name)
    after = (*data, *(record.digest for record in fits))
    return Again(AGAIN, {"settings": settings, "members": names}, after=after, files=files)


def plan_again(made_of: Mapping[str, Any], run: Path) -> Plan:
    """Return the plan of the same command again, for another process."""
    from evaluation.comparison import Experiment
    from sysid_evo.plan import Store

    experiment = Experiment.of(made_of["settings"])
    load_plugins([Path(plugin) for plugin in experiment.plugins])
    store = Store(run)
    return plan_of(*cells_of(experiment, store, tuple(find_column(store, member) for member in made_of["members"])))
