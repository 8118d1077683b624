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
from sysid_evo.data.frames import channel_names, pose_names, sample_table
from sysid_evo.data.trajectory import Trajectory
from sysid_evo.errors import ArtefactError
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
    names = channel_names(system, "episode", "step")
    columns: dict[str, list[Any]] = {"episode": [], "step": []} | {name: [] for name in names}
    for episode in dataset.episodes:
        samples = sample_table(system, episode)
        columns["episode"].append(pa.repeat(episode.name, len(samples)))
        columns["step"].append(pa.array(np.arange(len(samples))))
        for i, name in enumerate(names):
            columns[name].append(pa.array(samples[:, i], from_pandas=True))
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
        names = (*system.state_names, *system.control_names, *pose_names(system))
        table = pq.read_table(folder / SAMPLES, columns=list(names))
        data = {name: table[name].to_numpy(zero_copy_only=False) for name in names}
        episodes, first = [], 0
        for entry in header["episodes"]:
            rows = slice(first, first + entry["steps"] + 1)
            first = rows.stop
            states = _columns(data, system.state_names, rows)
            controls = _columns(data, system.control_names, rows)[:-1]
            pose = _columns(data, pose_names(system), rows) if entry["pose"] else None
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
