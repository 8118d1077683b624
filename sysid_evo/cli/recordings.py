"""Import, inspect: log files become data sets; tables of what these are good for."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import typer
from rich import box
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

import evaluation
from sysid_evo.cli.console import out, say, tell
from sysid_evo.cli.options import Columns, Json, Plugins, check_new_folder, load_plugins
from sysid_evo.data.dataset import Dataset
from sysid_evo.data.frames import HEADER, SAMPLES, is_stored_dataset
from sysid_evo.data.preparation import RawLog
from sysid_evo.data.quality import RecordingQuality, recording_quality
from sysid_evo.data.reading import read_recording
from sysid_evo.data.units import spelled
from sysid_evo.errors import InvalidArgument

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
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the data set that --out holds.")] = False,
    plugin: Plugins = None,
) -> None:
    """Turn log files into a data set: check, prepare, store.

    Logs of poses, three times as fast as the control rate or faster, are differentiated and filtered;
    logs that carry velocities at the control rate are taken row by row.
    """
    load_plugins(plugin)
    check_new_folder(folder, overwrite=overwrite, replaced=(HEADER, SAMPLES))
    patterns = patterns_of(condition or ())
    recording = read_recording(logs, columns=columns, condition_column=condition_column)
    dataset = Dataset.of_recording(recording).label_conditions(patterns)
    dataset.save(folder)
    tell_notes(dataset.notes, recording.remarks)
    out.print(episode_table(dataset))
    say(f"data set stored in {folder}")


def inspect(
    logs: Annotated[
        list[Path], typer.Argument(help="A data set's folder, or log files or folders of them.", show_default=False)
    ],
    columns: Columns = None,
    controller: Annotated[
        Path | None,
        typer.Option(help="Controller of a run: also say where it drives that the recording does not cover."),
    ] = None,
    as_json: Json = False,
    plugin: Plugins = None,
) -> None:
    """Say what a recording is good for: excitation, coverage, sampling, delays, what to record next."""
    load_plugins(plugin)
    dataset, raw, warned = _open(logs, columns)
    tell_notes(dataset.notes, warned)
    quality = recording_quality(dataset, raw)
    visited = () if controller is None else evaluation.driven_by(controller, dataset.system)
    remarks = evaluation.advise_recording(dataset, quality, visited=visited)
    if as_json:
        out.print_json(data={**quality_as_json(dataset, quality), "remarks": [asdict(one) for one in remarks]})
        return
    out.print(quality_tables(dataset, quality))
    print_remarks(remarks)


def patterns_of(conditions: Sequence[str]) -> dict[str, str]:
    """Return patterns by condition from texts ``NAME=PATTERN``. Raises `InvalidArgument`."""
    patterns: dict[str, str] = {}
    for text in conditions:
        name, equals, pattern = text.partition("=")
        if not (name and equals and pattern):
            raise InvalidArgument(f"--condition: expected NAME=PATTERN, such as wet='rain_*', got {text!r}")
        if name in patterns:
            raise InvalidArgument(f"--condition: {name!r} is given twice")
        patterns[name] = pattern
    return patterns


def _open(paths: list[Path], columns: Path | None) -> tuple[Dataset, tuple[RawLog, ...], tuple[str, ...]]:
    """Return a data set, the logs it was made of (none if it was stored), and what looks wrong in them."""
    if len(paths) == 1 and is_stored_dataset(paths[0]):
        return Dataset.read(paths[0], columns=columns), (), ()
    recording = read_recording(paths, columns=columns)
    return Dataset.of_recording(recording), recording.logs, recording.remarks


def tell_notes(notes: Iterable[str], remarks: Iterable[str] = ()) -> None:
    """Print notes on standard error, and what looks wrong as a warning."""
    remarked = set(remarks)
    for note in notes:
        label, style = ("warning: ", "yellow") if note in remarked else ("note: ", "dim")
        tell(note, label=label, style=style)


MOST_ROWS = 24


def episode_table(dataset: Dataset) -> RenderableType:
    """Return one row for each episode (of very many: the first), and the sum."""
    rows = [
        (episode.name, f"{len(episode) + 1}", f"{episode.duration:.1f}", f"{moving.mean():.0%}")
        for episode, moving in zip(dataset, dataset.moving, strict=True)
    ]
    total = f"{len(dataset)} episodes", f"{dataset.n_steps + len(dataset)}", f"{dataset.duration:.1f}", ""
    head = "episode", "samples", "s", "in motion"
    shown = len(head) if dataset.system.motion is not None else len(head) - 1
    return _table(_title(dataset), head[:shown], _cut([row[:shown] for row in (*rows, total)]), names=1)


def quality_tables(dataset: Dataset, quality: RecordingQuality) -> RenderableType:
    """Return what a recording holds, as tables."""
    controls = [
        (
            _unit(use.name, use.unit),
            "  ".join(
                f"{spelled(level, use.levels)}: {share:.0%}"
                for level, share in zip(use.levels, use.shares, strict=True)
            ),
            f"{60.0 / use.per_minute:.3g}" if use.switches else "-",
        )
        for use in quality.controls
    ]
    states = [
        (
            _unit(use.name, use.unit),
            *(spelled(value, (use.low, use.high)) for value in (use.rms, use.low, use.high)),
            f"{use.bandwidth:.2g}",
        )
        for use in quality.states
    ]
    commands = [(*map(spelled, use.levels), f"{use.share:.1%}", f"{use.coverage:.0%}") for use in quality.commands]
    delays = [
        (
            f"{delay.control} x speed" if delay.at_speed else delay.control,
            delay.state,
            *((f"{delay.steps}", f"{round(1e3 * delay.seconds)}") if delay.clear else ("-", "-")),
            f"{delay.strength:+z.2f}",
        )
        for delay in quality.delays
    ]
    sampling = [
        (log.name, f"{log.rows}", *(f"{1e3 * step:.1f}" for step in (log.shortest, log.median, log.longest)))
        for log in quality.sampling
    ]
    names = tuple(use.name for use in quality.controls)
    parts: list[RenderableType] = [
        Text(
            _title(dataset) + (f", {quality.moving:.0%} in motion" if dataset.system.motion is not None else ""),
            style="bold",
        ),
        _table("Excitation", ("control", "share of time near each level", "s per switch"), controls, names=2),
        _table("States", ("state", "RMS", "lowest", "highest", "95 % below Hz"), states, names=1),
        _table(
            f"Coverage: {quality.cells} of {quality.grid} state cells visited",
            (*names, "time", "of the visited cells"),
            _cut(commands),
            names=0,
        ),
        _table("Delay of a control on a state", ("control", "state", "steps", "ms", "strength"), delays, names=2),
    ]
    if sampling:
        head = ("log", "rows", "shortest", "median", "longest")
        parts.append(_table("Time between rows in ms", head, _cut(sampling), names=1))
    return Group(*parts)


def quality_as_json(dataset: Dataset, quality: RecordingQuality) -> dict[str, Any]:
    """Return what a recording holds, the system, the episodes and the notes as strict JSON."""
    episodes = [{"name": episode.name, "steps": len(episode)} for episode in dataset]
    return {
        "system": dataset.system.to_dict(),
        "fingerprint": dataset.fingerprint,
        "notes": list(dataset.notes),
        **asdict(quality),
        "episodes": episodes,
    }


def _title(dataset: Dataset) -> str:
    name = dataset.system.name or "data set"
    episodes = "1 episode" if len(dataset) == 1 else f"{len(dataset)} episodes"
    return f"{name}: {episodes}, {dataset.duration:.0f} s at {1 / dataset.system.dt:g} Hz"


def _unit(name: str, unit: str) -> str:
    return f"{name} ({unit})" if unit else name


def _cut(rows: Sequence[tuple[str, ...]]) -> list[tuple[str, ...]]:
    """Return the rows, of more than `MOST_ROWS` the first ones and the last."""
    if len(rows) <= MOST_ROWS:
        return list(rows)
    return [*rows[: MOST_ROWS - 2], (f"... {len(rows) - MOST_ROWS + 1} more", *[""] * (len(rows[0]) - 1)), rows[-1]]


def _table(title: str, head: Sequence[str], rows: Sequence[tuple[str, ...]], *, names: int) -> Table:
    """Return a table whose first ``names`` columns are text and whose others are numbers."""
    table = Table(title=Text(title, style="bold"), title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
    for i, name in enumerate(head):
        table.add_column(Text(name), justify="left" if i < names else "right", overflow="fold")
    for row in rows:
        table.add_row(*map(Text, row))
    return table


def print_remarks(remarks: Sequence[evaluation.Remark]) -> None:
    """Print what to record next, the most important first."""
    if not remarks:
        out.print("Nothing stands out that should be recorded next.")
        return
    for part in evaluation.remark_lines("What to record next?", remarks):
        out.print(part)
