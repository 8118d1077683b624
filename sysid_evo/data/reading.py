"""Reading of log files: find them, choose the column map, read, check, prepare."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from sysid_evo.data.checks import (
    check_control,
    check_rate,
    check_time,
    constant_controls,
    findings,
    unused_limits,
)
from sysid_evo.data.columns import ColumnMap, ControlColumn, choose_columns, load_columns, shipped_columns
from sysid_evo.data.frames import is_stored_dataset
from sysid_evo.data.preparation import RawLog, episodes_of, merged_notes
from sysid_evo.data.readers import MISSING, Table, find_reader, log_suffixes, such_rows
from sysid_evo.data.trajectory import Trajectory
from sysid_evo.errors import InvalidArgument, InvalidData, did_you_mean
from sysid_evo.system import System
from sysid_evo.types import Array, IntArray

ADVANCED = "advance: each step has the control that was logged after it; models of this data are for simulation"
"""Note on data of a system with `System.advance`."""


@dataclass(frozen=True)
class Recording:
    """Logs of one system in SI units, with notes and remarks.

    In ``logs``, `RawLog.extra` holds the states that have a column and the map's ``extra`` columns.
    ``notes`` list the processing steps, ``remarks`` possible faults.
    """

    system: System
    logs: tuple[RawLog, ...]
    notes: tuple[str, ...]
    remarks: tuple[str, ...]

    def prepared(self) -> tuple[tuple[Trajectory, ...], tuple[str, ...]]:
        """Return the episodes, and all notes and remarks.

        Logs at the control rate are used row by row, faster ones are differentiated and filtered. Raises `InvalidData`.
        """
        prepared = [episodes_of(log, self.system) for log in self.logs]
        notes = [*self.notes, *merged_notes(prepared), *([ADVANCED] if self.system.advance else []), *self.remarks]
        episodes = [episode for one in prepared for episode in one.episodes]
        return tuple(episodes), tuple(dict.fromkeys(notes))


def read_recording(
    paths: str | Path | Iterable[str | Path], *, columns: str | Path | None = None, condition_column: str | None = None
) -> Recording:
    """Return the recording in log files, or in folders of them.

    ``columns`` is a column map (a TOML file or the name of a shipped one); by default the shipped map
    that matches the header is used. ``condition_column`` is the column with the condition of each row, text or
    numbers, instead of that of the map. Raises `InvalidData` with file, row and column.
    """
    files = log_files(paths)
    notes = []
    if columns is None:
        name = choose_columns(find_reader(files[0]).header(files[0]), files[0].name)
        chosen = shipped_columns()[name]
        notes.append(f"column map {name!r} chosen: all its columns are in the header of {files[0].name}")
    else:
        chosen = load_columns(columns)
    named = condition_column or chosen.condition
    tables, steps = zip(*(_read(file, chosen, named, notes) for file in files), strict=True)
    logs = [_log(table, chosen, step, named, notes) for table, step in zip(tables, steps, strict=True)]
    control_limits = _control_limits(logs, chosen, notes)
    remarks = [*constant_controls(logs, tables, chosen), *unused_limits(logs, tables, chosen)]
    remarks += [remark for log, table in zip(logs, tables, strict=True) for remark in findings(log, table, chosen)]
    for name, control in chosen.controls.items():
        if control.gate is not None:
            closed = np.mean(np.concatenate([table.columns[control.gate] for table in tables]) == 0.0)
            notes.append(
                f"control {name!r} is {control.column!r} times {control.gate!r}, 0 in {closed:.0%} of the rows"
            )
    if chosen.time is None:
        notes.append(f"no time column: rows are assumed to be {chosen.dt:g} s apart; lost rows cannot be detected")
    system = chosen.system(control_limits)
    for position, rate in (("m", "m/s"), ("rad", "rad/s")):
        positions = [state.name for state in system.states if state.unit == position]
        if positions and not any(state.unit == rate for state in system.states):
            notes.append(
                f"no state is the speed of {', '.join(positions)}; a body with inertia needs it. Log it, or add a "
                f'state with derivative_of = "{positions[0]}" and unit = "{rate}"'
            )
    return Recording(system, tuple(logs), tuple(notes), tuple(remarks))


def log_files(paths: str | Path | Iterable[str | Path]) -> list[Path]:
    """Return the log files in ``paths``: files, and the sorted logs of folders."""
    files: list[Path] = []
    for path in paths_of(paths):
        if path.is_dir():
            if is_stored_dataset(path):
                raise InvalidArgument(
                    f"{path}: this is a stored data set already; it cannot be imported again or mixed with logs"
                )
            suffixes = log_suffixes()
            inside = sorted(file for file in path.iterdir() if file.suffix.lower() in suffixes and file.is_file())
            if not inside and (path / "cells").is_dir():
                raise InvalidArgument(
                    f"{path}: expected recordings, but this is a run folder. Give the logs or the data set that the "
                    f"run used; sysid-evo compare --config {path} repeats the run"
                )
            if not inside:
                raise InvalidData(f"{path}: expected logs ({', '.join(suffixes)}) in this folder, found none")
            files += inside
        elif path.is_file():
            files.append(path)
        else:
            existing = [file.name for file in path.parent.iterdir()] if path.parent.is_dir() else []
            hint = did_you_mean(path.name, existing)
            raise InvalidArgument(f"{path}: expected a log or a folder of logs, found nothing there.{hint}")
    if not files:
        raise InvalidArgument("expected at least one log or folder of logs, got none")
    times = Counter(file.stem for file in files)
    repeated = sorted(stem for stem, count in times.items() if count > 1)
    if repeated:
        raise InvalidData(
            f"logs: episodes are named by their files, but several are called {', '.join(repeated)}; rename them"
        )
    return files


def paths_of(paths: str | Path | Iterable[str | Path]) -> list[Path]:
    """Return one path or several as a list."""
    return [Path(paths)] if isinstance(paths, (str, Path)) else [Path(path) for path in paths]


def _read(path: Path, columns: ColumnMap, condition: str | None, notes: list[str]) -> tuple[Table, IntArray]:
    """Return the columns of a log, including text, and the index (N,) of each row among all rows of the file.

    Rows without a number or a command are dropped, if the map allows it, and counted in ``notes``. A held command is
    that of the last row with one; the rows before the first one are dropped.
    """
    drop = columns.missing == "drop"
    held = {control.column for control in columns.controls.values() if control.hold}
    reader = find_reader(path, encoding=columns.encoding, gaps=drop or bool(held))
    table = reader.read(path, columns.number_columns)
    worded = [control.column for control in columns.controls.values() if control.words is not None]
    texts = {name: reader.texts(path, name) for name in (*worded, *([condition] if condition else []))}
    places = np.arange(len(table), dtype=np.int64)
    lacking = {name: np.isnan(values) for name, values in table.columns.items()}
    lacking |= {name: np.isin(texts[name], MISSING) for name in worded}
    if not drop:
        if held and any(gaps.any() for name, gaps in lacking.items() if name not in held.union(worded)):
            strict = [name for name in columns.number_columns if name not in held]
            find_reader(path, encoding=columns.encoding).read(path, strict)  # raises the error with row and column
        lacking = {name: gaps for name, gaps in lacking.items() if name in held}
    numbers = dict(table.columns)
    for name in sorted(name for name in held if lacking[name].any()):
        known = np.count_nonzero(~lacking[name])
        notes.append(f"{path.name}: {name!r} has a value in {known} of {len(table)} rows; held between")
        last = np.maximum.accumulate(np.where(lacking[name], -1, places))
        lacking[name] = last < 0
        if name in texts:
            texts[name] = [texts[name][row] for row in last]
        else:
            numbers[name] = numbers[name][last]
    gone = np.any([*lacking.values(), np.zeros(len(table), dtype=bool)], axis=0)
    if gone.any():
        counts = ", ".join(f"{name} {rows.sum()}" for name, rows in lacking.items() if rows.any())
        gaps = f"{gone.sum()} of {len(gone)} rows have no value in some column ({counts})"
        if (~gone).sum() < 2:
            raise InvalidData(f"{path.name}: {gaps}: expected at least two complete rows")
        first = table.rows[gone][0]
        notes.append(f"{path.name}: {gaps} and are left out, the first is row {first}; the log has gaps there")
        places = places[~gone]
        texts = {name: [values[place] for place in places] for name, values in texts.items()}
        numbers = {name: values[~gone] for name, values in numbers.items()}
        table = replace(table, rows=table.rows[~gone])
    return replace(table, columns=numbers, texts=texts), places


def _log(table: Table, columns: ColumnMap, places: IntArray, condition: str | None, notes: list[str]) -> RawLog:
    """Return the content of ``table`` in SI units; controls are gated, clipped and checked against their limits.

    ``places`` (N,) are the indices of its rows in the file; ``condition`` is the column with the condition of each row.
    """
    data = table.columns
    labels = None if condition is None else np.array(table.texts[condition], np.str_)
    if columns.time is None:
        time = columns.dt * (places - places[0])
    else:
        time = data[columns.time.column] * columns.time.scale
        check_time(table, columns.time.column, time)
        time = time - time[0]
        check_rate(table, columns.time, time, columns.dt, row_by_row=not columns.differentiated)
    controls = np.empty((len(table), len(columns.controls)))
    for i, (name, control) in enumerate(columns.controls.items()):
        values = _commands(table, name, control) * control.scale
        if control.non_negative:
            negative = np.flatnonzero(values < 0.0)
            if len(negative):
                where = table.where(control.column, int(negative[0]))
                notes.append(f"{where}: negative values of {name!r} set to 0{such_rows(len(negative))}")
            values = np.where(values > 0.0, values, 0.0)
        if control.gate is not None:
            values = values * data[control.gate]
        controls[:, i] = check_control(table, name, control, values)
    states = {n: data[s.column] * s.scale for n, s in columns.states.items() if s.column is not None}
    extra = {name: data[column.column] * column.scale for name, column in columns.extra.items()}
    pose_names = columns.motion_of_states.pose_names if columns.pose else ()
    pose = [data[columns.pose[name].column] * columns.pose[name].scale for name in pose_names]
    return RawLog(
        name=table.path.stem,
        time=time,
        pose=np.stack(pose, axis=1) if pose else np.empty((len(table), 0)),
        controls=controls,
        extra={**states, **extra},
        condition=labels,
        rates=columns.rates,
    )


def _commands(table: Table, name: str, control: ControlColumn) -> Array:
    """Return the values of a control (N,): the numbers in the file, or those that the map assigns to its words."""
    if control.words is None:
        return table.columns[control.column]
    labels = table.texts[control.column]
    unknown = [row for row, label in enumerate(labels) if label not in control.words]
    if unknown:
        raise InvalidData(
            f"{table.where(control.column, unknown[0])}: control {name!r} is {labels[unknown[0]]!r}, expected one of "
            f"{', '.join(map(repr, control.words))}{such_rows(len(unknown))}. Add it to words in the column map."
        )
    return np.array([control.words[label] for label in labels])


def _control_limits(logs: Sequence[RawLog], columns: ColumnMap, notes: list[str]) -> Mapping[str, tuple[float, float]]:
    """Return the range over all logs of every control that has no limits in the map; add a note on each."""
    control_limits = {}
    for i, (name, control) in enumerate(columns.controls.items()):
        if control.limited:
            continue
        values: Array = np.concatenate([log.controls[:, i] for log in logs])
        low, high = float(values.min()), float(values.max())
        if low == high:
            raise InvalidData(
                f"control {name!r} (column {control.column!r}) is {low:g} in every row of every file and has no limits "
                "in the column map: give it low and high, or leave it out"
            )
        control_limits[name] = (low, high)
        notes.append(f"control {name!r} has no limits in the column map: {low:g} to {high:g}, as recorded")
    return control_limits
