"""Conversion of data sets to and from pandas, and a folder with Parquet."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sysid_evo.data.readers import read_parquet
from sysid_evo.data.trajectory import TERMINATED, TRUNCATED, Trajectory
from sysid_evo.errors import ArtefactError, InvalidArgument, InvalidData, SysidEvoError
from sysid_evo.files import write_atomically
from sysid_evo.system import System
from sysid_evo.types import Array

if TYPE_CHECKING:
    import pandas as pd


UNEVEN = 0.05
"""Largest deviation of a time step of a table from dt, as a share of dt."""


def episodes_of_frame(system: System, frame: pd.DataFrame, *, episode: str | None = None) -> list[Trajectory]:
    """Return the episodes of a table, see `Dataset.from_pandas`."""
    if not hasattr(frame, "columns") or not hasattr(frame, "groupby"):
        raise InvalidArgument(
            f"from_pandas: expected a pandas table, got {type(frame).__name__}. For arrays use "
            "Dataset.from_arrays(system, states, controls), for log files Dataset.read(path, columns=...)"
        )
    wanted = [*system.state_names, *system.control_names, *([episode] if episode else [])]
    missing = [name for name in wanted if name not in frame.columns]
    if missing:
        raise InvalidData(
            f"table: missing columns {', '.join(missing)}; it has {', '.join(map(str, frame))}. "
            "Each channel needs a column of its name: rename them with frame.rename(columns={...})"
        )
    if len(frame) < 2:
        raise InvalidData(f"table: expected two rows or more, one for each dt, got {len(frame)}")
    poses = list(pose_names(system))
    has_pose = bool(poses) and all(name in frame.columns for name in poses)
    groups = frame.groupby(episode, sort=False) if episode else [("episode-0", frame)]
    tables = [(str(name), table) for name, table in groups]
    for name, table in tables:
        _expect_even(system, name, table)
    return [
        Trajectory(
            states=table[list(system.state_names)].to_numpy(),
            controls=system.controls_of_steps(table[list(system.control_names)].to_numpy()),
            dt=system.dt,
            pose=table[poses].to_numpy() if has_pose else None,
            name=name,
            **_rewards_of(system, table),
        )
        for name, table in tables
    ]


REWARD = "reward"


def _rewards_of(system: System, table: pd.DataFrame) -> dict[str, Any]:
    """Return rewards and ending of an episode from its columns `reward`, `terminated` and `truncated`, if it has any.

    Values belong to the step that begins in their row, so those of the last row are not read.
    """
    columns = [name for name in table.columns if name not in (*system.state_names, *system.control_names)]
    endings = [name for name in (TERMINATED, TRUNCATED) if name in columns and bool(table[name].iloc[-2])]
    rewards = table[REWARD].to_numpy(dtype=np.float64)[:-1] if REWARD in columns else None
    if rewards is not None and not np.isfinite(rewards).all():
        rewards = None
    return {"rewards": rewards, "ending": endings[0] if endings else ""}


def _expect_even(system: System, name: str, table: pd.DataFrame) -> None:
    """Raise `InvalidData` if a table has times and its rows are not ``dt`` apart."""
    seconds = _seconds(system, table)
    if seconds is None:
        return
    steps = np.diff(seconds)
    wrong = np.flatnonzero(~(np.abs(steps - system.dt) <= UNEVEN * system.dt))
    if len(wrong):
        raise InvalidData(
            f"table: episode {name!r} has {len(wrong)} of {len(steps)} steps that are not dt = {system.dt:g} s long, "
            f"the first after row {wrong[0]}, {steps[wrong[0]]:g} s. Rows must be dt apart: resample the table, save "
            "it as CSV for Dataset.read(path, columns=...), which resamples, or drop its time"
        )


def _seconds(system: System, table: pd.DataFrame) -> Array | None:
    """Return the times of the rows (N,), in seconds: the column ``time``, or an index of times; None without."""
    import pandas as pd

    if "time" in table.columns and "time" not in (*system.state_names, *system.control_names):
        column = table["time"]
        if pd.api.types.is_numeric_dtype(column.dtype):
            return column.to_numpy(dtype=np.float64)
        index = pd.Index(column)
    else:
        index = table.index
    if not isinstance(index, pd.DatetimeIndex | pd.TimedeltaIndex):
        return None
    return np.asarray(pd.TimedeltaIndex(index - index[0]).total_seconds(), dtype=np.float64)


def frame_of(system: System, episodes: Sequence[Trajectory]) -> pd.DataFrame:
    """Return episodes as a table, see `Dataset.to_pandas`."""
    import pandas as pd

    names = channel_names(system, "episode", "time")
    tables = [sample_table(system, episode) for episode in episodes]
    frame = pd.DataFrame(np.concatenate(tables), columns=list(names))
    if any(episode.rewards is not None for episode in episodes):
        channel_names(system, REWARD, TERMINATED, TRUNCATED)
        frame[REWARD] = np.concatenate([_padded(episode.rewards, len(episode)) for episode in episodes])
        for name in (TERMINATED, TRUNCATED):
            ended = [[*[False] * (len(episode) - 1), episode.ending == name, False] for episode in episodes]
            frame[name] = np.concatenate(ended)
    frame.insert(0, "time", np.concatenate([times(episode) for episode in episodes]))
    frame.insert(0, "episode", np.repeat([episode.name for episode in episodes], [len(table) for table in tables]))
    return frame


def sample_table(system: System, episode: Trajectory) -> Array:
    """Return states, controls and pose as columns, one row per sample (T + 1, n).

    The controls of the last sample (with `System.advance` the first), and the pose of an episode without one, are nan.
    """
    blank = np.full((1, system.nu), np.nan)
    controls = [blank, episode.controls] if system.advance else [episode.controls, blank]
    pose = np.full((len(episode) + 1, system.n_pose), np.nan) if episode.pose is None else episode.pose
    return np.concatenate([episode.states, np.concatenate(controls), pose], axis=1)


def _padded(rewards: Array | None, steps: int) -> Array:
    """Return the rewards with one row for each sample (steps + 1,); nan in the last, and if there are none."""
    return np.full(steps + 1, np.nan) if rewards is None else np.append(rewards, np.nan)


def channel_names(system: System, *others: str) -> tuple[str, ...]:
    """Return the names of states, controls and pose. Raises `InvalidData` if one is in ``others`` or used twice."""
    names = (*system.state_names, *system.control_names, *pose_names(system))
    taken = sorted({name for name in names if name in others or names.count(name) > 1})
    if taken:
        raise InvalidData(
            f"data set: the channels {', '.join(taken)} cannot become columns, because {', '.join(others)} and the "
            "coordinates of the pose have these names; rename the channels"
        )
    return names


def pose_names(system: System) -> tuple[str, ...]:
    """Return the names of the pose's coordinates; none without a motion."""
    return () if system.motion is None else system.motion.pose_names


def times(episode: Trajectory) -> Array:
    """Return the time of each sample since the episode began (T + 1,), in seconds."""
    return episode.dt * np.arange(len(episode) + 1, dtype=np.float64)


SCHEMA = "sysid-evo/dataset/1"
HEADER, SAMPLES = "dataset.json", "samples.parquet"


def write_samples(
    folder: Path, system: System, episodes: Sequence[Trajectory], notes: Sequence[str], fingerprint: str
) -> Path:
    """Write a data set to ``folder``, one row per sample; the last controls of an episode are null.

    Raises `InvalidData` if two columns would have the same name.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    names = channel_names(system, "episode", "step")
    columns: dict[str, list[Any]] = {"episode": [], "step": []} | {name: [] for name in names}
    for episode in episodes:
        rows = sample_table(system, episode)
        columns["episode"].append(pa.repeat(episode.name, len(rows)))
        columns["step"].append(pa.array(np.arange(len(rows))))
        for i, name in enumerate(names):
            columns[name].append(pa.array(rows[:, i], from_pandas=True))
    if any(episode.rewards is not None for episode in episodes):
        channel_names(system, REWARD)
        columns[REWARD] = [pa.array(_padded(episode.rewards, len(episode)), from_pandas=True) for episode in episodes]
    table = pa.table({name: pa.chunked_array(parts) for name, parts in columns.items()})
    header = {
        "schema": SCHEMA,
        "system": system.to_dict(),
        "episodes": [
            {"name": episode.name, "steps": len(episode), "pose": episode.pose is not None}
            | ({"condition": episode.condition} if episode.condition else {})
            | ({} if episode.rewards is None else {"rewards": True})
            | ({"ending": episode.ending} if episode.ending else {})
            for episode in episodes
        ],
        "notes": list(notes),
        "fingerprint": fingerprint,
    }
    folder.mkdir(parents=True, exist_ok=True)
    write_atomically(folder / SAMPLES, lambda path: pq.write_table(table, path))
    write_atomically(folder / HEADER, lambda path: path.write_text(json.dumps(header, indent=1, allow_nan=False)))
    return folder


def read_samples(folder: Path) -> tuple[System, tuple[Trajectory, ...], tuple[str, ...], str]:
    """Return the arguments of `write_samples`. Raises `ArtefactError` if a file is damaged or of another version."""
    import pyarrow as pa

    path = folder / HEADER
    try:
        header = json.loads(path.read_text())
        if not isinstance(header, dict):
            raise InvalidData(f"expected names and values in {HEADER}, got a {type(header).__name__}")
        if header.get("schema") != SCHEMA:
            raise ArtefactError(f"{path}: expected schema {SCHEMA!r}, got {header.get('schema')!r}")
        system = System.from_dict(header["system"])
        names = (*system.state_names, *system.control_names, *pose_names(system))
        if any(entry.get("rewards") for entry in header["episodes"]):
            names = (*names, REWARD)
        table = read_parquet(folder / SAMPLES, names)
        data = {name: table[name].to_numpy(zero_copy_only=False) for name in names}
        episodes, first = [], 0
        for entry in header["episodes"]:
            rows = slice(first, first + entry["steps"] + 1)
            first = rows.stop
            states = _columns(data, system.state_names, rows)
            controls = system.controls_of_steps(_columns(data, system.control_names, rows))
            pose = _columns(data, pose_names(system), rows) if entry["pose"] else None
            rewards = data[REWARD][rows][:-1] if entry.get("rewards") else None
            name, condition, ending = entry["name"], entry.get("condition", ""), entry.get("ending", "")
            episodes.append(Trajectory(states, controls, system.dt, pose, name, condition, rewards, ending))
        del table, data
        pa.default_memory_pool().release_unused()
        return system, tuple(episodes), tuple(header["notes"]), header["fingerprint"]
    except FileNotFoundError as error:
        raise ArtefactError(
            f"{folder}: expected a data set ({HEADER} and {SAMPLES}), {error.filename} is missing"
        ) from error
    except ArtefactError:
        raise
    except (KeyError, TypeError, ValueError, RecursionError, pa.ArrowException) as error:
        raise unreadable(folder, error) from error


def unreadable(folder: Path, error: Exception) -> ArtefactError:
    """Return the error to raise for a damaged data set."""
    kind = "" if isinstance(error, SysidEvoError) else f"{type(error).__name__}: "
    return ArtefactError(f"{folder}: not a readable data set: {kind}{error}")


def is_stored_dataset(path: str | Path) -> bool:
    """Return whether ``path`` is a folder that `write_samples` wrote."""
    return (Path(path) / HEADER).is_file()


def _columns(data: Mapping[str, Array], names: Sequence[str], rows: slice) -> Array:
    """Return the columns ``names`` as (rows, len(names)); ``names`` may be empty."""
    columns = [data[name][rows] for name in names]
    return np.column_stack(columns) if columns else np.empty((rows.stop - rows.start, 0))
