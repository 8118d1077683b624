"""Racing on the walled track against another body, which is seen."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.registry import register_task
from sysid_evo.system import Channel
from sysid_evo.tasks.task import TaskState
from sysid_evo.tasks.walled_track import WalledTrack

if TYPE_CHECKING:
    from sysid_evo.engine.compiled.kernel import TaskKernel


@register_task("duel")
class Duel(WalledTrack):
    """The walled track for two: what a controller is shown is that of `WalledTrack`, and where its rival is.

    Parameters as there; at a wall a body is slowed. A single body that does it is alone: its rival is as far ahead as
    can be seen, and fitness is how far (m) it comes. Two bodies meet in a `Race`.

    | observation after those of `WalledTrack` | unit |
    |---|---|
    | how far ahead the rival is, and how far to the left, at most ``reach`` | m |
    """

    def __init__(
        self,
        *,
        horizon: int = 500,
        radius: float = 1.6,
        width: float = 0.7,
        bends: float = 0.5,
        body: float = 0.07,
        rays: int = 5,
        view: float = math.pi,
        reach: float = 2.0,
    ) -> None:
        super().__init__(
            horizon=horizon, radius=radius, width=width, bends=bends, body=body, rays=rays, view=view, reach=reach
        )
        self.observations = (
            *self.observations,
            Channel("rival_ahead", "m", -reach, reach),
            Channel("rival_left", "m", -reach, reach),
        )

    def observe(self, task_state: TaskState, state: Array) -> Array:
        nobody = np.tile([self.reach, 0.0], (len(state), 1))
        return np.concatenate([super().observe(task_state, state), nobody], axis=1)

    def observe_rival(self, task_state: TaskState, state: Array, pose: Array) -> Array:
        """Return what is observed where the rival has the ``pose`` (B, 3), (B, len(observations))."""
        x, y, heading = task_state.pose.T
        dx, dy = pose[:, 0] - x, pose[:, 1] - y
        ahead, left = np.cos(heading) * dx + np.sin(heading) * dy, np.cos(heading) * dy - np.sin(heading) * dx
        shown = np.clip(np.stack([ahead, left], axis=1), -self.reach, self.reach)
        return np.concatenate([super().observe(task_state, state), shown], axis=1)

    def kernel(self) -> TaskKernel | None:
        from sysid_evo.engine.kernels.race import duel_kernel

        return duel_kernel(self)
