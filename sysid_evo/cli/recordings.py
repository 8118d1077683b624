"""`sysid-evo import`, `inspect` and `record`: recordings become data sets, and are looked at."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

import typer

from sysid_evo.cli.console import err, out, tell
from sysid_evo.cli.exits import code_of_loop
from sysid_evo.cli.options import Columns, Json, Plugins, Seed, check_new_folder, load_plugins

if TYPE_CHECKING:
    from collections.abc import Iterable

    from sysid_evo.data import Dataset, RawLog

Logs: TypeAlias = Annotated[list[Path], typer.Argument(help="Log files, or folders of them.", show_default=False)]


def import_(
    logs: Logs,
    folder: Annotated[Path, typer.Option("--out", help="Folder for the data set.", show_default=False)],
    columns: Columns = None,
    condition: Annotated[
        list[str] | None,
        typer.Option(help="NAME=PATTERN: logs whose names fit were recorded in this condition, as wet='rain_*'."),
    ] = None,
    condition_column: Annotated[
        str | None,
        typer.Option(help="Column of the logs that names the condition of each row; a change of it splits a log."),
    ] = None,
    plugin: Plugins = None,
) -> None:
    """Turn log files into a data set: check, prepare, store.

    Logs of poses, three times as fast as the control rate or faster, are differentiated and filtered;
    logs that carry velocities at the control rate are taken row by row.
    """
    from sysid_evo.cli.advice_tables import episode_table
    from sysid_evo.data import read_recording
    from sysid_evo.data.conditions import parsed

    load_plugins(plugin)
    patterns = parsed("--condition", condition or [])
    recording = read_recording(logs, columns=columns, condition_column=condition_column)
    dataset = recording.dataset().labelled(patterns)
    dataset.save(folder)
    _tell(dataset.notes, recording.doubts)
    out.print(episode_table(dataset))
    out.print(f"data set stored in {folder}", highlight=False, markup=False, soft_wrap=True)


def inspect(
    logs: Annotated[
        list[Path], typer.Argument(help="A data set's folder, or log files or folders of them.", show_default=False)
    ],
    columns: Columns = None,
    controller: Annotated[
        Path | None,
        typer.Option(help="Controller of a run: also say where it drives that the recording does not cover."),
    ] = None,
    json: Json = False,
    plugin: Plugins = None,
) -> None:
    """Say what a recording is good for: excitation, coverage, sampling, delays, what to record next."""
    from sysid_evo.cli.advice_tables import advice_as_json, advice_tables
    from sysid_evo.cli.unrecorded import inspected, print_regions
    from sysid_evo.data import advise
    from sysid_evo.data.support import Support, recorded_pairs, split_pairs

    load_plugins(plugin)
    dataset, raw, doubts = _open(logs, columns)
    advice = advise(dataset, raw)
    _tell(dataset.notes, doubts)
    if json:
        out.print_json(advice_as_json(dataset, advice))
    else:
        out.print(advice_tables(dataset, advice))
    if controller is not None and not json:
        support = Support.of(dataset.system, *split_pairs(dataset.system, recorded_pairs(dataset)))
        print_regions(*inspected(controller, support))


def record(
    folder: Annotated[Path, typer.Option("--out", help="Folder for the data set.", show_default=False)],
    robot: Annotated[
        str, typer.Option(help="Registered robot, NAME(parameter=value, ...), or a TOML file.")
    ] = "emulated_car",
    seed: Seed = None,
    minutes: Annotated[float, typer.Option(min=0.1, help="Length of the excitation.")] = 6.0,
    manoeuvre: Annotated[
        str | None, typer.Option(help="Instead, one that measures: step, coast_down or circle.")
    ] = None,
    plugin: Plugins = None,
) -> None:
    """Drive a robot through manoeuvres; store the journals of the runs (`journal/`), what the tracker saw
    (`raw/`) and the data set made of it.

    Every frame and command is in the journal as soon as it happens; Ctrl-C, a lost tracker or a lost
    link end the recording in neutral, and what was recorded until then is kept and prepared.
    """
    from hardware.loop.stops import Stops
    from hardware.preflight import check_recording
    from hardware.recording.measuring import measuring
    from hardware.recording.scripted import save_raw
    from hardware.robot import find_robot
    from sysid_evo.cli.advice_tables import episode_table
    from sysid_evo.cli.progress import Bars
    from sysid_evo.data.measured import measured

    load_plugins(plugin)
    check_new_folder(folder)
    machine = find_robot(robot)
    journal = folder / "journal"
    check_recording(machine, journal, duration=60.0 * minutes)
    manoeuvres = None if manoeuvre is None else measuring(machine.system, manoeuvre)
    title = f"record {robot}"
    with Bars() as bars, Stops() as stops:
        bars.begin(title)
        drive = (
            partial(machine.record, duration=60.0 * minutes)
            if manoeuvres is None
            else partial(machine.record_manoeuvres, manoeuvres)
        )
        recorded = drive(seed=seed or 0, folder=journal, stops=stops, progress=bars.advance)
        ended = recorded.report.sentence if recorded.report.reason.is_fault else None
        bars.end(title, ended)
    dataset = recorded.dataset
    for log in recorded.logs:
        save_raw(log, dataset.system, folder / "raw" / f"{log.name}.csv")
    dataset.save(folder)
    _tell(dataset.notes, ())
    out.print(episode_table(dataset))
    for one in measured(dataset):
        out.print(str(one), highlight=False, markup=False, soft_wrap=True)
    out.print(f"data set stored in {folder}", highlight=False, markup=False, soft_wrap=True)
    if ended is not None:
        err.print(f"the recording was cut short: {ended}", highlight=False, markup=False, soft_wrap=True)
        raise typer.Exit(code_of_loop(recorded.report.reason))


def _open(paths: list[Path], columns: Path | None) -> tuple[Dataset, tuple[RawLog, ...], tuple[str, ...]]:
    """Return a data set, the logs it was made of (none if it was stored), and what looks wrong in them."""
    from sysid_evo.data import Dataset, read_recording
    from sysid_evo.data.reading import is_stored

    if len(paths) == 1 and is_stored(paths[0]):
        return Dataset.read(paths[0], columns=columns), (), ()
    recording = read_recording(paths, columns=columns)
    return recording.dataset(), recording.logs, recording.doubts


def _tell(notes: Iterable[str], doubts: Iterable[str]) -> None:
    """Print notes on standard error, and what looks wrong as a warning."""
    doubtful = set(doubts)
    for note in notes:
        label, style = ("warning: ", "yellow") if note in doubtful else ("note: ", "dim")
        tell(note, label=label, style=style)
