"""The environments that Gymnasium knows by name once this package is imported."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import gymnasium

from sysid_evo.environments.making import Source, members_of
from sysid_evo.environments.single import ModelEnvironment
from sysid_evo.environments.spaces import Actions
from sysid_evo.environments.vector import ModelVectorEnvironment
from sysid_evo.registry import make_task
from sysid_evo.tasks.task import Task

ENVIRONMENTS: Mapping[str, tuple[str, str]] = {
    "sysid_evo/PointToPoint-v0": ("emulated_car", "point_to_point"),
    "sysid_evo/WalledTrack-v0": ("emulated_car", "walled_track"),
    "sysid_evo/SwingUp-v0": ("pendulum", "swing_up"),
    "sysid_evo/Balance-v0": ("cart_pole", "balance"),
    "sysid_evo/SetPoint-v0": ("thermal", "set_point"),
    "sysid_evo/TrackReference-v0": ("thermal", "track_reference"),
}
"""The emulated robot and the task behind each name; both can be given to `gymnasium.make` instead."""


def make_env(
    model: Source | Iterable[Source] | Mapping[str, Source],
    task: str | Task = "point_to_point",
    *,
    actions: Actions = "auto",
    seed: int | None = None,
) -> ModelEnvironment:
    """Return ``model`` at ``task`` as an environment of Gymnasium.

    ``model`` is a model, the path of one, the name of an emulated robot, or several: an ensemble, of which every
    episode has another member. ``task`` is a spec or a task. ``actions`` see `Actions`; ``seed`` is that of the
    first reset.
    """
    return ModelEnvironment(members_of(model), _task(task), actions=actions, seed=seed)


def make_vector_env(
    model: Source | Iterable[Source] | Mapping[str, Source],
    task: str | Task = "point_to_point",
    *,
    num_envs: int = 1,
    actions: Actions = "auto",
    seed: int | None = None,
) -> ModelVectorEnvironment:
    """Return ``num_envs`` copies of what `make_env` makes, stepped all at once."""
    return ModelVectorEnvironment(members_of(model), _task(task), num_envs, actions=actions, seed=seed)


def _task(task: str | Task) -> Task:
    return make_task(task) if isinstance(task, str) else task


for _name, (_robot, _at) in ENVIRONMENTS.items():
    if _name not in gymnasium.registry:
        gymnasium.register(
            _name,
            entry_point=f"{__name__}:make_env",
            vector_entry_point=f"{__name__}:make_vector_env",
            kwargs={"model": _robot, "task": _at},
        )
