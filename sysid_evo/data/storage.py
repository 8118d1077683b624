"""A data set on disk: ``dataset.json`` and ``samples.parquet`` in a folder of its own."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from sysid_evo.arrays import Array
from sysid_evo.data.trajectory import Trajectory
from sysid_evo.errors import ArtefactError, InvalidData
from sysid_evo.files import write_atomically
from sysid_evo.system import System

if TYPE_CHECKING:
    from sysid_evo.data.dataset import Dataset

SCHEMA = "sysid-evo/dataset/1"
HEADER, SAMPLES = "dataset.json", "samples.parquet"


def save_dataset(dataset: Dataset, folder: Path) -> Path:
    """Write ``dataset`` into ``folder``: one row a sample; the last controls of an episode are null.

    Raises `InvalidData` if two columns would have the same name.
    """
    system = dataset.system
    columns: dict[str, list[Any]] = {"episode": [], "step": []}
    names = (*system.state_names, *system.control_names, *_pose_names(system))
    taken = sorted({name for name in names if name in columns or names.count(name) > 1})
    if taken:
        raise InvalidData(
            f"data set: the channels {', '.join(taken)} cannot be stored, as the columns episode and step and the "
            "coordinates of the pose have these names; rename the channels"
        )
    columns.update({name: [] for name in names})
    for episode in dataset.episodes:
        rows = len(episode) + 1
        blank = np.full((1, system.nu), np.nan)
        pose = np.full((rows, system.n_pose), np.nan) if episode.pose is None else episode.pose
        table = np.concatenate([episode.states, np.concatenate([episode.controls, blank]), pose], axis=1)
        columns["episode"].append(pa.repeat(episode.name, rows))
        columns["step"].append(pa.array(np.arange(rows)))
        for i, name in enumerate(names):
            columns[name].append(pa.array(table[:, i], from_pandas=True))
    table = pa.table({name: pa.chunked_array(parts) for name, parts in columns.items()})
    header = {
        "schema": SCHEMA,
        "system": system.to_dict(),
        "episodes": [_described(episode) for episode in dataset.episodes],
        "notes": list(dataset.notes),
        "fingerprint": dataset.fingerprint,
    }
    folder.mkdir(parents=True, exist_ok=True)
    write_atomically(folder / SAMPLES, lambda path: pq.write_table(table, path))
    write_atomically(folder / HEADER, lambda path: path.write_text(json.dumps(header, indent=1, allow_nan=False)))
    return folder


def load_dataset(folder: Path) -> Dataset:
    """Read what `save_dataset` wrote. Raises `ArtefactError` if it is damaged or of another version."""
    from sysid_evo.data.dataset import Dataset

    path = folder / HEADER
    try:
        header = json.loads(path.read_text())
        if header.get("schema") != SCHEMA:
            raise ArtefactError(f"{path}: expected schema {SCHEMA!r}, got {header.get('schema')!r}")
        system = System.from_dict(header["system"])
        names = (*system.state_names, *system.control_names, *_pose_names(system))
        table = pq.read_table(folder / SAMPLES, columns=list(names))
        data = {name: table[name].to_numpy(zero_copy_only=False) for name in names}
        episodes, first = [], 0
        for entry in header["episodes"]:
            rows = slice(first, first + entry["steps"] + 1)
            first = rows.stop
            states = _columns(data, system.state_names, rows)
            controls = _columns(data, system.control_names, rows)[:-1]
            pose = _columns(data, _pose_names(system), rows) if entry["pose"] else None
            episodes.append(Trajectory(states, controls, system.dt, pose, entry["name"], entry.get("condition", "")))
        del table, data
        pa.default_memory_pool().release_unused()
        dataset = Dataset(system, tuple(episodes), tuple(header["notes"]))
    except FileNotFoundError as error:
        raise ArtefactError(
            f"{folder}: expected a data set ({HEADER} and {SAMPLES}), {error.filename} is missing"
        ) from error
    except (KeyError, TypeError, ValueError, pa.ArrowException) as error:
        if isinstance(error, ArtefactError):
            raise
        raise ArtefactError(f"{folder}: not a readable data set: {type(error).__name__}: {error}") from error
    if dataset.fingerprint != header["fingerprint"]:
        raise ArtefactError(f"{folder}: the samples do not match the fingerprint in {HEADER}; the files were changed")
    return dataset


def _described(episode: Trajectory) -> dict[str, Any]:
    """Return what the header says of an episode; without a condition there is no such key."""
    told = {"condition": episode.condition} if episode.condition else {}
    return {"name": episode.name, "steps": len(episode), "pose": episode.pose is not None, **told}


def _columns(data: Mapping[str, Array], names: Sequence[str], rows: slice) -> Array:
    """Return these columns side by side, (rows, len(names)); there may be none."""
    columns = [data[name][rows] for name in names]
    return np.column_stack(columns) if columns else np.empty((rows.stop - rows.start, 0))


def _pose_names(system: System) -> tuple[str, ...]:
    return () if system.motion is None else system.motion.pose_names
