"""What an environment can be made of: models, files of models, names of emulated robots, and several of these."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TypeAlias

from sysid_evo.data.reading import is_stored as is_data_set
from sysid_evo.dynamics import Dynamics
from sysid_evo.errors import InvalidArgument
from sysid_evo.extras import check_installed
from sysid_evo.registry import make_robot

check_installed("an environment", ("gymnasium",))

Source: TypeAlias = Dynamics | str | Path
"""A model or an emulated robot's dynamics, the file of a stored model, or the name of an emulated robot."""


def members_of(source: Source | Iterable[Source] | Mapping[str, Source]) -> dict[str, Dynamics]:
    """Return the dynamics by name that ``source`` stands for; several are an ensemble.

    A folder stands for all models in it, as the folder ``models`` of a run does. Raises `InvalidArgument`,
    `ArtefactError`, and what the registry of robots raises.
    """
    if isinstance(source, Mapping):
        return {name: _dynamics(one) for name, one in source.items()}
    if isinstance(source, Dynamics):
        return {type(source).__name__: source}
    if isinstance(source, (str, Path)):
        if Path(source).is_dir():
            return _folder(Path(source))
        return {_name(source): _dynamics(source)}
    listed = list(source)
    return {f"{_name(one)}-{i + 1}": _dynamics(one) for i, one in enumerate(listed)}


def _dynamics(source: Source) -> Dynamics:
    if isinstance(source, Dynamics):
        return source
    from sysid_evo.store import is_stored, load_model

    if is_stored(str(source), "model"):
        return load_model(source)
    dynamics: Dynamics | None = make_robot(str(source)).dynamics
    if dynamics is None:
        raise InvalidArgument(
            f"environment: {str(source)!r} is no emulated robot: its equations are not known. "
            "Name the file of a model, or a robot that exists as a program"
        )
    return dynamics


def _folder(folder: Path) -> dict[str, Dynamics]:
    files = sorted(folder.glob("*.json"))
    if not files or is_data_set(folder):
        raise InvalidArgument(f"environment: no model is stored in {folder}; in a run they stand in the folder models")
    return {file.stem: _dynamics(file) for file in files}


def _name(source: Source) -> str:
    return type(source).__name__ if isinstance(source, Dynamics) else Path(source).stem
