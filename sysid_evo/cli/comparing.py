"""`sysid-evo compare`: the whole chain from recordings to a verdict."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sysid_evo.cli.console import err, out
from sysid_evo.cli.options import (
    Columns,
    EstimatorDelay,
    Plugins,
    Seed,
    Test,
    load_plugins,
    new_run_folder,
    split_names,
)

if TYPE_CHECKING:
    from sysid_evo.cli.progress import Bars
    from sysid_evo.data import Dataset
    from sysid_evo.engine import Runner
    from sysid_evo.store import RunFolder

DEFAULT_ROBOT = "emulated_car"
RECORDED_MINUTES = 6.0
PAPER_FAMILIES = ("backprop27", "evolved3", "nearest_neighbour", "parametrised")
DEFAULT_FAMILIES = {"paper": PAPER_FAMILIES}
OTHER_FAMILIES = (*PAPER_FAMILIES, "sindy", "mlp_ensemble")
"""What is compared when no family is named and the preset has no choice of its own."""
DEFAULT_ENSEMBLES = (("evolved3", "nearest_neighbour"), ("backprop27", "nearest_neighbour", "parametrised"))
"""The paper's two multi-model controllers, mm1c and, as far as its text says, mm2c."""
DATA_PARTS = ("training", "test")
"""Folders in the run's ``data`` folder."""
HELD_BACK = 0.25
"""Share of every episode held back for the test when no episode is named."""


def compare(
    data: Annotated[Path | None, typer.Option(help="Recordings of a robot (default: record an emulated one).")] = None,
    test: Test = None,
    models: Annotated[str | None, typer.Option(help="Families, separated by commas, or 'all'.")] = None,
    ensembles: Annotated[str | None, typer.Option(help="Members joined by +, ensembles separated by commas.")] = None,
    robot: Annotated[
        str | None, typer.Option(help="Robot for the last column (default without --data: emulated_car).")
    ] = None,
    preset: Annotated[str, typer.Option(help="Budget: quick, standard or paper.")] = "quick",
    only: Annotated[str | None, typer.Option(help="'prediction' leaves the controllers out.")] = None,
    generations: Annotated[int | None, typer.Option(min=1, help="Of controllers, instead of the preset's.")] = None,
    aggregate: Annotated[str, typer.Option(help="Of an ensemble's fitnesses: min, mean, median.")] = "min",
    estimator_delay: EstimatorDelay = 0.0,
    yardstick: Annotated[bool, typer.Option("--yardstick", help="Also evolve on the emulated robot itself.")] = False,
    seed: Seed = 0,
    folder: Annotated[Path | None, typer.Option("--out", help="Run folder (default runs/<time>).")] = None,
    columns: Columns = None,
    plugin: Plugins = None,
) -> None:
    """Fit models, evolve controllers in them, and compare both: which predict, which transfer.

    With no options, all on an emulated toy car. Interrupted, it goes on with the same --out.
    """
    from evaluation.comparison import ComparisonSettings
    from evaluation.comparison import compare as run_comparison
    from evaluation.report import save_report, tables
    from sysid_evo.cli.progress import Bars
    from sysid_evo.errors import InvalidArgument
    from sysid_evo.experiment import controller_preset
    from sysid_evo.registry import models as registry
    from sysid_evo.store import RunFolder

    if only not in (None, "prediction"):
        raise InvalidArgument(f"--only: expected 'prediction', got {only!r}")
    load_plugins(plugin)
    families = split_names(models) or DEFAULT_FAMILIES.get(preset, OTHER_FAMILIES)
    if families == ("all",):
        families = tuple(name for name, _ in registry.load_all())
    evolution = replace(controller_preset(preset), aggregate=aggregate, estimator_delay=estimator_delay / 1000.0)
    settings = ComparisonSettings(
        models=families,
        ensembles=choose_ensembles(ensembles, families),
        preset=preset,
        seed=seed,
        evolution=evolution if generations is None else replace(evolution, generations=generations),
        controllers=only is None,
        yardstick=yardstick,
    )
    for family in families:
        registry.get(family)
    if yardstick and data is not None and robot is None:
        raise InvalidArgument("--yardstick: name the emulated robot that it is evolved on with --robot")
    path = new_run_folder(folder)
    with Bars(path) as bars:
        robot = robot or (DEFAULT_ROBOT if data is None else None)
        dataset = record(robot or DEFAULT_ROBOT, seed, bars) if data is None else read(data, columns)
        training, held_back = dataset.split(test if test else HELD_BACK)
        asked = {**settings.to_dict(), "robot": robot, "data": training.fingerprint, "test": held_back.fingerprint}
        run = RunFolder.open(path, asked)
        keep_data(run, training, held_back)
        report = run_comparison(
            run,
            training,
            held_back,
            settings,
            observer=bars,
            robot=None if robot is None or only else (robot, runner_of(robot)),
            title=f"{data.name if data is not None else robot}: {', '.join(families)}",
        )
        _, page = save_report(report, run.path)
    for table in tables(report):
        out.print(table)
    err.print(where_time_went(report.timings), highlight=False)
    out.print(f"Report: {page}", highlight=False, soft_wrap=True)


def keep_data(run: RunFolder, training: Dataset, test: Dataset) -> None:
    """Store both parts of the data in the run folder, so that its report can be made again."""
    from sysid_evo.data.reading import is_stored

    for name, part in zip(DATA_PARTS, (training, test), strict=True):
        if not is_stored(run.path / "data" / name):
            part.save(run.path / "data" / name)


def where_time_went(timings: Mapping[str, float]) -> str:
    """Return the seconds that each kind of cell took, the longest first."""
    kinds: dict[str, float] = {}
    for cell, seconds in timings.items():
        kind = cell.split(" ", 1)[0]
        kinds[kind] = kinds.get(kind, 0.0) + seconds
    total = sum(kinds.values())
    parts = [f"{kind} {seconds:.1f} s" for kind, seconds in sorted(kinds.items(), key=lambda item: -item[1])]
    return f"Time: {total:.1f} s in all: {', '.join(parts)}"


def choose_ensembles(text: str | None, families: tuple[str, ...]) -> tuple[tuple[str, ...], ...]:
    """Read ``a+b,a+b+c``; by default those of `DEFAULT_ENSEMBLES` that can be formed, else all families together."""
    if text is None:
        chosen = [members for members in DEFAULT_ENSEMBLES if set(members) <= set(families)]
        return tuple(chosen) or ((families,) if len(families) > 1 else ())
    return tuple(tuple(member.strip() for member in ensemble.split("+")) for ensemble in split_names(text))


def record(robot: str, seed: int, bars: Bars) -> Dataset:
    """Record the excitation manoeuvres on an emulated robot."""
    from hardware.recording.scripted import record_dataset
    from sysid_evo.errors import LinkLost

    cell = f"record {robot}"
    bars.start(cell)
    recorded = record_dataset(
        robot,
        seed=seed,
        duration=60.0 * RECORDED_MINUTES,
        progress=lambda done, total: bars.progress(cell, done, total),
    )
    bars.finish(cell, cached=False, reason=None)
    if recorded.report.reason.is_fault:
        raise LinkLost(f"{robot}: {recorded.report.sentence}")
    return recorded.dataset


def read(data: Path, columns: Path | None) -> Dataset:
    """Read recordings and tell what their preparation noted."""
    from sysid_evo.data import Dataset

    dataset = Dataset.read(data, columns=columns)
    for note in dataset.notes:
        err.print(f"note: {note}", markup=False, highlight=False)
    return dataset


def runner_of(spec: str) -> Runner:
    """Return how controllers are run on an emulated robot. Raises `InvalidArgument` for a physical one."""
    from sysid_evo.engine import DynamicsRunner
    from sysid_evo.errors import InvalidArgument
    from sysid_evo.registry import make_robot

    robot = make_robot(spec)
    if robot.dynamics is None:
        raise InvalidArgument(f"{spec} is a physical robot: it cannot be a column of an automatic comparison")
    return DynamicsRunner(robot.dynamics)
