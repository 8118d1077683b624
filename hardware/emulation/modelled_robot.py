"""A model as a robot: what a person drives to feel a model (paper, section 5.2.3)."""

from __future__ import annotations

import math

import numpy as np

from hardware.emulation.simulated_robot import SimulatedConnection, SimulatedRobot
from hardware.measurement import Measurement
from hardware.trackers.gates import GateLimits
from sysid_evo.arrays import Array
from sysid_evo.dynamics import Dynamics, clip_state
from sysid_evo.errors import IncompatibleSystem

FRAMES = 10  # of the tracker in one sample: 200 Hz at 20 Hz
LEAD = 2
"""Frames between the command that starts a session and the sample that it starts.

Later commands are due at multiples of dt after the first; one that is late by less than this still
counts for its own sample.
"""


class ModelledRobot(SimulatedRobot):
    """Any ``dynamics`` whose motion has a pose, seen by a tracker without errors.

    Raises `IncompatibleSystem` for dynamics without a motion.
    """

    def __init__(self, name: str, dynamics: Dynamics) -> None:
        if dynamics.system.motion is None:
            raise IncompatibleSystem(
                f"model {name!r}: expected a system with a motion, which gives a pose, got none. Equations without a "
                "pose become a robot by hardware.emulation.sensed_robot.SensedRobot"
            )
        self.name = name
        self.dynamics: Dynamics = dynamics
        self.system = dynamics.system
        self.frame_period = dynamics.system.dt / FRAMES

    def connect(self, *, seed: int | None = None) -> ModelledConnection:
        return ModelledConnection(self.name, self.dynamics, seed=seed)


class ModelledConnection(SimulatedConnection):
    """A session with a model, which takes up the command in force at the start of each of its samples.

    It rests in the origin until the first command that is not neutral; its samples are counted from
    there. Poses are exact at the ends of a sample and, in between, those of a state that changes
    evenly. The body is lost from sight once the state is no longer finite.
    """

    def __init__(self, name: str, dynamics: Dynamics, *, seed: int | None) -> None:
        system = dynamics.system
        super().__init__(name, system, system.dt / FRAMES)
        self._dynamics = dynamics
        self._rng = np.random.default_rng(seed)
        history = np.tile(system.neutral_state, (1, dynamics.n_lags + 1, 1))
        controls = np.tile(system.neutral_control, (1, dynamics.n_lags, 1))
        self._carry = dynamics.start(history, controls, self._rng.standard_normal((1, dynamics.n_draws)))
        self._origin = self.pose
        self._before = self._after = system.neutral_state
        self._phase = -LEAD
        self._resting = True

    @property
    def gate_limits(self) -> GateLimits:
        """None: a model may go as it likes, and its poses have no noise."""
        return GateLimits(speed=math.inf, yaw_rate=math.inf, jump=math.inf, turn=math.inf, frozen=None)

    def send(self, control: Array, *, valid_for: float) -> None:
        super().send(control, valid_for=valid_for)
        self._resting = self._resting and bool((self.control == self._neutral).all())

    def _advance(self) -> None:
        if self._resting:
            return
        if self._phase == 0:
            self._step()
        self._phase += 1
        if self._phase <= 0:
            return
        system, share = self._dynamics.system, self._phase / FRAMES
        now = self._after if self._phase == FRAMES else self._before + share * (self._after - self._before)
        self.pose = system.move(self._origin, self._before, now, share * system.dt)
        if self._phase == FRAMES:
            self._phase, self._origin = 0, self.pose

    def _step(self) -> None:
        dynamics, nx = self._dynamics, self._dynamics.system.nx
        noise = self._rng.standard_normal((1, dynamics.n_noise)) if dynamics.n_noise else None
        self._before = self._carry[0, :nx].copy()
        with np.errstate(all="ignore"):
            stepped = dynamics.step(self._carry, self.control[None], noise)
        self._carry, _ = clip_state(stepped, dynamics.envelope)
        self._after = self._carry[0, :nx].copy()

    def _look(self, time: float) -> Measurement:
        seen = bool(np.isfinite(self.pose).all())
        return Measurement(time, time, self.frame, self.name, seen, self.pose)
