"""The model inside a controller: the file of a fitted model, the name of an emulated robot, or a `Dynamics`."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

from sysid_evo.errors import IncompatibleTask, InvalidArgument
from sysid_evo.models.dynamics import Dynamics
from sysid_evo.models.storage import load_model
from sysid_evo.registry.registry import make_robot
from sysid_evo.tasks.task import Task


def load_inner_model(what: str, model: str | Dynamics, task: Task) -> Dynamics:
    """Return the dynamics that ``model`` names, for the controller ``what`` at a bound ``task``.

    Raises `ArtefactError` and `UnknownName` if it does not exist, `IncompatibleTask` for a model of another system.
    """
    dynamics = model if isinstance(model, Dynamics) else _named(what, model)
    differences = task.system.differences(dynamics.system)
    if differences:
        raise IncompatibleTask(f"{what}: the model is of another system: {'; '.join(differences)}")
    return dynamics


def _named(what: str, model: str) -> Dynamics:
    file = Path(f"{model.removesuffix('.safetensors').removesuffix('.json')}.json")
    if file.is_file() or file.suffix == Path(model).suffix:
        return _stored(file.resolve(), file.stat().st_mtime_ns if file.is_file() else 0)
    dynamics: Dynamics | None = make_robot(model).dynamics
    if dynamics is None:
        raise InvalidArgument(f"{what}: {model} is a physical robot; give the file of a model")
    return dynamics


@lru_cache(maxsize=16)
def _stored(file: Path, _changed: int) -> Dynamics:
    return load_model(file)
