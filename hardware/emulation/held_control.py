"""A fine dynamics at the control rate: the control is held while the fine step repeats; NumPy and compiled form."""

from __future__ import annotations

import numpy as np

from sysid_evo.errors import InvalidArgument
from sysid_evo.kernels import LANES, DynamicsKernel, KernelSource, Layout, view
from sysid_evo.models import Dynamics, PlainDynamics
from sysid_evo.types import Array


class HeldControl(PlainDynamics):
    """``fine`` sampled every ``repeats`` of its steps, with the control held in between.

    One step takes the noise of ``repeats`` fine ones, (B, repeats * fine.n_noise), the earliest first. In a history
    each coarse sample is repeated as ``repeats`` equal fine ones. ``fine`` may have a method ``held_kernel(repeats)``,
    its own compiled form of several steps.
    """

    def __init__(self, fine: Dynamics, repeats: int) -> None:
        if repeats < 1:
            raise InvalidArgument(f"held control: expected at least one fine step, got {repeats}")
        self.fine = fine
        self.repeats = repeats
        self.system = fine.system.with_dt(round(fine.system.dt * repeats, 12))
        self.n_carry = fine.n_carry
        self.n_lags = -(-fine.n_lags // repeats)
        self.n_noise = fine.n_noise * repeats
        self.n_draws = fine.n_draws

    @property
    def state_bounds(self) -> Array | None:
        return self.fine.state_bounds

    def start(self, states: Array, controls: Array, draws: Array | None = None) -> Array:
        lags = self.fine.n_lags
        held = np.repeat(controls, self.repeats, axis=1)
        earlier = np.repeat(states[:, :-1], self.repeats, axis=1)
        return self.fine.start(
            np.concatenate([earlier[:, earlier.shape[1] - lags :], states[:, -1:]], axis=1),
            held[:, held.shape[1] - lags :],
            draws,
        )

    def step(self, carry: Array, control: Array, noise: Array | None = None) -> Array:
        size = self.fine.n_noise
        for k in range(self.repeats):
            carry = self.fine.step(carry, control, None if noise is None else noise[:, k * size : (k + 1) * size])
        return carry

    def kernel(self) -> DynamicsKernel | None:
        if hasattr(self.fine, "held_kernel"):
            own: DynamicsKernel = self.fine.held_kernel(self.repeats)
            return own
        fine = self.fine.kernel()
        if fine is None:
            return None
        parameters = HEAD.pack(fine.parameters, repeats=self.repeats, n_noise=self.fine.n_noise)
        return DynamicsKernel(KernelSource(held, {"fine": fine.source}), parameters, fine.n_scratch)


HEAD = Layout("repeats", "n_noise")


def held(carry, control, noise, parameters, scratch):
    """Repeat the fine step, each time with the next rows of noise."""
    own, rows = view(parameters, HEAD.size), int(parameters[HEAD.n_noise]) * LANES
    for k in range(int(parameters[HEAD.repeats])):
        fine(carry, control, view(noise, k * rows), own, scratch)  # noqa: F821
