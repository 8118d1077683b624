"""Functions that make environments, and the environments that are registered in Gymnasium."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TypeAlias

import gymnasium

from sysid_evo.artefacts import is_stored_artefact as is_stored
from sysid_evo.data.frames import is_stored_dataset
from sysid_evo.environments.environments import Actions, ModelEnvironment, ModelVectorEnvironment
from sysid_evo.errors import InvalidArgument
from sysid_evo.models.dynamics import Dynamics
from sysid_evo.models.storage import load_model
from sysid_evo.registry.registry import make_robot
from sysid_evo.tasks.task import Task, make_task

Source: TypeAlias = Dynamics | str | Path
"""A model, an emulated robot's dynamics, the file of a stored model, or the name of an emulated robot."""


def make_env(
    model: Source | Iterable[Source] | Mapping[str, Source],
    task: str | Task = "point_to_point",
    *,
    actions: Actions = "auto",
    seed: int | None = None,
    render_mode: None = None,
) -> ModelEnvironment:
    """Return a Gymnasium environment of ``task`` on ``model``.

    ``model`` is a model, the path of one, the name of an emulated robot, or several of these: an ensemble, whose member
    is drawn for each episode. ``task`` is a spec or a task; see `Actions` for ``actions``; ``seed`` is used by the
    first reset. Raises `InvalidArgument` for a ``render_mode``, since environments do not render.
    """
    _refuse_rendering(render_mode)
    return ModelEnvironment(load_members(model), _task(task), actions=actions, seed=seed)


def make_vector_env(
    model: Source | Iterable[Source] | Mapping[str, Source],
    task: str | Task = "point_to_point",
    *,
    num_envs: int = 1,
    actions: Actions = "auto",
    seed: int | None = None,
    render_mode: None = None,
) -> ModelVectorEnvironment:
    """Return ``num_envs`` copies of the environment of `make_env`, which are stepped together.

    `sysid_evo.environments.stable_baselines.StableBaselinesEnv` wraps it for Stable-Baselines3.
    """
    _refuse_rendering(render_mode)
    return ModelVectorEnvironment(load_members(model), _task(task), num_envs, actions=actions, seed=seed)


def _refuse_rendering(render_mode: str | None) -> None:
    if render_mode is not None:
        raise InvalidArgument(
            f"environment: expected no render_mode, since environments do not render, got {render_mode!r}. The state "
            "is in the info of every step. To watch a trained policy, store it as a controller (champion_from_policy, "
            "save_champion) and run `sysid-evo drive --controller FILE --watch`"
        )


def _task(task: str | Task) -> Task:
    return make_task(task) if isinstance(task, str) else task


def load_members(source: Source | Iterable[Source] | Mapping[str, Source]) -> dict[str, Dynamics]:
    """Return the dynamics of ``source`` by name; several are an ensemble.

    A folder, such as ``models`` of a run, means all models in it. Raises `InvalidArgument`, `ArtefactError`, and the
    errors of the registry of robots.
    """
    if isinstance(source, Mapping):
        return {name: _dynamics(one) for name, one in source.items()}
    if isinstance(source, Dynamics):
        return {type(source).__name__: source}
    if isinstance(source, (str, Path)):
        if (folder := Path(source)).is_dir():
            files = sorted(folder.glob("*.json"))
            if not files or is_stored_dataset(folder):
                raise InvalidArgument(
                    f"environment: no model is stored in {folder}: give the folder 'models' of a run, or the file of "
                    "a model"
                )
            return {file.stem: _dynamics(file) for file in files}
        return {_name_of(source): _dynamics(source)}
    return {f"{_name_of(one)}-{i}": _dynamics(one) for i, one in enumerate(source, start=1)}


def _dynamics(source: Source) -> Dynamics:
    if isinstance(source, Dynamics):
        return source
    if is_stored(str(source), "model"):
        return load_model(source)
    dynamics: Dynamics | None = make_robot(str(source)).dynamics
    if dynamics is None:
        raise InvalidArgument(
            f"environment: {str(source)!r} is not an emulated robot, so it has no equations: give an emulated robot "
            "or the file of a model"
        )
    return dynamics


def _name_of(source: Source) -> str:
    return type(source).__name__ if isinstance(source, Dynamics) else Path(source).stem


ENVIRONMENTS: Mapping[str, tuple[str, str]] = {
    "sysid_evo/PointToPoint-v0": ("emulated_car", "point_to_point"),
    "sysid_evo/WalledTrack-v0": ("emulated_car", "walled_track"),
    "sysid_evo/SwingUp-v0": ("pendulum", "swing_up"),
    "sysid_evo/Balance-v0": ("cart_pole", "balance"),
    "sysid_evo/SetPoint-v0": ("thermal", "set_point"),
    "sysid_evo/TrackReference-v0": ("thermal", "track_reference"),
}
"""Emulated robot and task of each environment; `gymnasium.make` also accepts ``model`` and ``task``."""


for _name, (_robot, _at) in ENVIRONMENTS.items():
    if _name not in gymnasium.registry:
        gymnasium.register(
            _name,
            entry_point=f"{__name__}:make_env",
            vector_entry_point=f"{__name__}:make_vector_env",
            kwargs={"model": _robot, "task": _at},
        )
