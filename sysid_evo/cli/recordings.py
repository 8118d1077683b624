"""Import, inspect: log files become data sets; tables of their quality."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from rich import box
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

import evaluation
import sysid_evo.data
from sysid_evo.cli.console import out, print_line, print_status
from sysid_evo.cli.options import Columns, Json, Plugins, argument, check_new_folder, load_plugins, option
from sysid_evo.data.units import spelled
from sysid_evo.errors import InvalidArgument

if TYPE_CHECKING:
    from sysid_evo.data import Dataset, RawLog, RecordingQuality


def import_(
    logs: Annotated[list[Path], argument("Log files, or folders of them", "LOGS")],
    folder: Annotated[Path, option("Folder for the data set", "DIR", "--out")],
    columns: Columns = None,
    condition: Annotated[list[str] | None,
        option("NAME=PATTERN: condition of the logs whose names match, such as wet='rain_*'; repeatable", "NAME",
        panel="Data and models")] = None,
    condition_column: Annotated[str | None,
        option("Column that names the condition of each row; a change splits the log", "NAME",
        panel="Data and models")] = None,
    advance: Annotated[bool,
        option("Each step has the control that was logged after it, see inspect", "", "--advance",
        panel="Data and models")] = False,
    overwrite: Annotated[bool, option("Replace the data set in --out", "", "--overwrite")] = False,
    plugin: Plugins = None,
) -> None:  # fmt: skip
    """Convert log files to a data set: check, prepare, store.

    Logs of poses at three times the control rate or faster are differentiated and filtered. Logs of velocities at the
    control rate are used row by row.
    """
    load_plugins(plugin)
    check_new_folder(folder, overwrite=overwrite, replaced=(sysid_evo.data.HEADER, sysid_evo.data.SAMPLES))
    patterns = patterns_of(condition or ())
    recording = sysid_evo.data.read_recording(logs, columns=columns, condition_column=condition_column)
    if advance:
        recording = replace(recording, system=replace(recording.system, advance=True))
    dataset = sysid_evo.data.Dataset.of_recording(recording).label_conditions(patterns)
    dataset.save(folder)
    print_notes(dataset.notes, recording.remarks)
    out.print(episode_table(dataset))
    print_line(f"data set stored in {folder}")


def inspect(
    logs: Annotated[list[Path], argument("Data set, log files, or folders of logs", "DATA")],
    columns: Columns = None,
    controller: Annotated[Path | None,
        option("Controller file: also report the states it visits that the recording lacks", "FILE",
        panel="Data and models")] = None,
    as_json: Json = False, plugin: Plugins = None,
) -> None:  # fmt: skip
    """Report excitation, coverage, sampling and delays of a recording.

    Then recommends recordings that are still missing.
    """
    load_plugins(plugin)
    dataset, raw, warned = _open(logs, columns)
    print_notes(dataset.notes, warned)
    quality = sysid_evo.data.recording_quality(dataset, raw)
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
    """Return a data set, its logs (none if it was stored), and warnings about them."""
    if len(paths) == 1 and sysid_evo.data.is_stored_dataset(paths[0]):
        return sysid_evo.data.Dataset.read(paths[0], columns=columns), (), ()
    recording = sysid_evo.data.read_recording(paths, columns=columns)
    return sysid_evo.data.Dataset.of_recording(recording), recording.logs, recording.remarks


def print_notes(notes: Iterable[str], remarks: Iterable[str] = ()) -> None:
    """Print notes on standard error; those among the remarks are warnings."""
    remarked = set(remarks)
    for note in notes:
        label, style = ("warning: ", "yellow") if note in remarked else ("note: ", "dim")
        print_status(note, label=label, style=style)


MOST_ROWS = 24


def episode_table(dataset: Dataset) -> RenderableType:
    """Return a table with a row for each episode, the first ones of many, and the total."""
    rows = [
        (episode.name, f"{len(episode) + 1}", f"{episode.duration:.1f}", f"{moving.mean():.0%}")
        for episode, moving in zip(dataset, dataset.moving, strict=True)
    ]
    total = f"{len(dataset)} episodes", f"{dataset.n_steps + len(dataset)}", f"{dataset.duration:.1f}", ""
    head = "episode", "samples", "s", "in motion"
    shown = len(head) if dataset.system.motion is not None else len(head) - 1
    return _table(_title(dataset), head[:shown], _cut([row[:shown] for row in (*rows, total)]), names=1)


def quality_tables(dataset: Dataset, quality: RecordingQuality) -> RenderableType:
    """Return the quality of a recording as tables."""
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
    """Return quality, system, episodes and notes of a recording as strict JSON."""
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
    """Return at most `MOST_ROWS` rows: the first ones and the last."""
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
    """Print recommended recordings, the most important first."""
    if not remarks:
        out.print("No further recordings are recommended.")
        return
    for part in evaluation.remark_lines("What to record next?", remarks):
        out.print(part)
