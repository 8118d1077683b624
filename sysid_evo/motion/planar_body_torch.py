"""A body on a plane, on tensors."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from sysid_evo.motion.planar_body import frame_change, turn


@dataclass(frozen=True)
class TorchPlanarBody:
    """`PlanarBody` on tensors, with its roles in these columns of the state."""

    forward: int
    lateral: int | None
    yaw_rate: int

    def integrate(self, state: Tensor, change: Tensor, dt: float) -> Tensor:
        after = state + change
        if self.lateral is None:
            return after
        angle = state[..., self.yaw_rate] * dt
        columns = list(torch.unbind(after, dim=-1))
        columns[self.forward], columns[self.lateral] = turn(
            columns[self.forward], columns[self.lateral], torch.cos(angle), -torch.sin(angle)
        )
        return torch.stack(columns, dim=-1)

    def turned(self, state: Tensor, rate: Tensor) -> Tensor:
        if self.lateral is None:
            return rate
        columns = list(torch.unbind(rate, dim=-1))
        forward, lateral = frame_change(state[..., self.forward], state[..., self.lateral], state[..., self.yaw_rate])
        columns[self.forward] = columns[self.forward] + forward
        columns[self.lateral] = columns[self.lateral] + lateral
        return torch.stack(columns, dim=-1)
