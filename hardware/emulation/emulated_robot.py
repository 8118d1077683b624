"""An emulated robot behind the connection of a real one, in simulated time."""

from __future__ import annotations

import math
from typing import cast

import numpy as np

from hardware.emulation.held_control import HeldControl
from hardware.emulation.optical_tracker import OpticalTracker
from hardware.measurement import Measurement
from hardware.robot import Connection, Robot
from sysid_evo.arrays import Array
from sysid_evo.dynamics import Dynamics
from sysid_evo.errors import IncompatibleSystem, InvalidArgument, LinkLost
from sysid_evo.motion import PlanarBody

TRACKER_DELAY = 0.004  # s from frame to arrival: "in the order of milliseconds" (paper, section 3)
NOISE_BLOCK = 1024  # frames of noise drawn at once
CLOCK_TOLERANCE = 1e-9  # s


class EmulatedRobot(Robot):
    """A planar robot whose physics step at the tracker's rate; controllers see every ``repeats``-th."""

    def __init__(self, name: str, physics: Dynamics, *, repeats: int) -> None:
        if not isinstance(physics.system.motion, PlanarBody):
            raise IncompatibleSystem(f"robot {name!r}: the emulated tracker needs a planar body, got another motion")
        self.name = name
        self.physics = physics
        self.dynamics: HeldControl = HeldControl(physics, repeats)
        self.system = self.dynamics.system

    def connect(self, *, seed: int | None = None) -> EmulatedConnection:
        """Open a session at rest in the origin; without a seed each session draws its own noise."""
        return EmulatedConnection(self.name, self.physics, seed=seed)


class EmulatedConnection(Connection):
    """A session in simulated time: nothing waits, the clock is the tracker's.

    The first `measure` is the frame at 0 s; each further one lets the physics take one step. Noise,
    draws and the tracker's errors come from ``seed``. ``control`` (nu,) is the command in force.
    """

    def __init__(self, name: str, physics: Dynamics, *, seed: int | None) -> None:
        system = physics.system
        self.name = name
        self.frame = -1
        self._physics = physics
        self._neutral = system.neutral_control
        self.control = self._neutral
        self._expires = -math.inf
        self._open = True
        body, tracker = np.random.SeedSequence(seed).spawn(2)
        self._rng = np.random.default_rng(body)
        self._tracker = OpticalTracker(np.random.default_rng(tracker))
        history = np.tile(system.neutral_state, (1, physics.n_lags + 1, 1))
        controls = np.tile(self._neutral, (1, physics.n_lags, 1))
        self._carry = physics.start(history, controls, self._rng.standard_normal((1, physics.n_draws)))
        self._noise = np.empty((0, physics.n_noise))
        self._waited = 0.0
        self.pose = np.zeros(system.n_pose)

    @property
    def time(self) -> float:
        """The clock in s: the time of the last frame, 0 before the first."""
        return max(self.frame, 0) * self._physics.system.dt

    @property
    def state(self) -> Array:
        """The true state (nx,), which a real robot does not tell."""
        return self._carry[0, : self._physics.system.nx].copy()

    def send(self, control: Array, *, valid_for: float) -> None:
        self._check_open()
        control = self._physics.system.check_control(control).copy()
        if not valid_for > 0.0:
            raise InvalidArgument(f"send: expected valid_for > 0 s, got {valid_for}")
        self.control, self._expires = control, self.time + valid_for

    def measure(self, timeout: float) -> Measurement | None:
        self._check_open()
        system = self._physics.system
        if self.frame >= 0:
            self._waited += timeout
            if self._waited + CLOCK_TOLERANCE < system.dt:
                return None
            self._waited = 0.0
            self._advance()
        self.frame += 1
        time = self.frame * system.dt
        pose = self._tracker.observe(self.pose)
        return Measurement(time, time + TRACKER_DELAY, self.frame, self.name, True, pose)

    def close(self) -> None:
        self.control, self._open = self._neutral, False

    def _advance(self) -> None:
        """Take one step of the physics; a command that has outlived its validity is dropped first."""
        physics, system = self._physics, self._physics.system
        if self.time + CLOCK_TOLERANCE >= self._expires:
            self.control = self._neutral
        row = self.frame % NOISE_BLOCK
        if row == 0:
            self._noise = self._rng.standard_normal((NOISE_BLOCK, physics.n_noise))
        before, nx = self._carry, system.nx
        self._carry = physics.step(before, self.control[None], self._noise[row : row + 1])
        motion = cast("PlanarBody", system.motion)
        self.pose = motion.move(self.pose, before[0, :nx], self._carry[0, :nx], system.dt, system.state_names)

    def _check_open(self) -> None:
        if not self._open:
            raise LinkLost(f"the connection to {self.name!r} is closed: open another with connect()")
