"""An emulated robot behind the connection of a real one, in simulated time."""

from __future__ import annotations

import numpy as np

from hardware.emulation.held_control import HeldControl
from hardware.emulation.optical_tracker import OpticalTracker
from hardware.emulation.simulated_robot import SimulatedConnection, SimulatedRobot
from hardware.measurement import Measurement
from hardware.trackers.gates import GateLimits
from sysid_evo.arrays import Array
from sysid_evo.dynamics import Dynamics
from sysid_evo.errors import IncompatibleSystem
from sysid_evo.motion import PlanarBody

TRACKER_DELAY = 0.004  # s from frame to arrival: "in the order of milliseconds" (paper, section 3)
NOISE_BLOCK = 1024  # frames of noise drawn at once


class EmulatedRobot(SimulatedRobot):
    """A planar robot whose physics step at the tracker's rate; controllers see every ``repeats``-th.

    ``gate`` says what the body can do, if that is more than the limits that hold for most
    (`GateLimits`). Raises `IncompatibleSystem` for another motion.
    """

    def __init__(self, name: str, physics: Dynamics, *, repeats: int, gate: GateLimits | None = None) -> None:
        if not isinstance(physics.system.motion, PlanarBody):
            raise IncompatibleSystem(f"robot {name!r}: the emulated tracker needs a planar body, got another motion")
        self.name = name
        self.physics = physics
        self.frame_period = physics.system.dt
        self.dynamics: HeldControl = HeldControl(physics, repeats)
        self.system = self.dynamics.system
        self.gate = GateLimits.read(gate)

    def connect(self, *, seed: int | None = None) -> EmulatedConnection:
        return EmulatedConnection(self.name, self.physics, seed=seed, gate=self.gate)


class EmulatedConnection(SimulatedConnection):
    """A session with an emulated robot: each frame lets the physics take one step.

    Noise, draws and the tracker's errors come from ``seed``.
    """

    def __init__(self, name: str, physics: Dynamics, *, seed: int | None, gate: GateLimits | None = None) -> None:
        system = physics.system
        self._gate = GateLimits.read(gate)
        super().__init__(name, system, system.dt)
        self._physics = physics
        body, tracker = np.random.SeedSequence(seed).spawn(2)
        self._rng = np.random.default_rng(body)
        self._tracker = OpticalTracker(np.random.default_rng(tracker))
        history = np.tile(system.neutral_state, (1, physics.n_lags + 1, 1))
        controls = np.tile(system.neutral_control, (1, physics.n_lags, 1))
        self._carry = physics.start(history, controls, self._rng.standard_normal((1, physics.n_draws)))
        self._noise = np.empty((0, physics.n_noise))

    @property
    def gate_limits(self) -> GateLimits:
        return self._gate

    @property
    def state(self) -> Array:
        """The true state (nx,), which a real robot does not tell."""
        return self._carry[0, : self._physics.system.nx].copy()

    def _advance(self) -> None:
        physics, system = self._physics, self._physics.system
        row = self.frame % NOISE_BLOCK
        if row == 0:
            self._noise = self._rng.standard_normal((NOISE_BLOCK, physics.n_noise))
        before, nx = self._carry, system.nx
        self._carry = physics.step(before, self.control[None], self._noise[row : row + 1])
        self.pose = system.move(self.pose, before[0, :nx], self._carry[0, :nx])

    def _look(self, time: float) -> Measurement:
        pose = self._tracker.observe(self.pose)
        return Measurement(time, time + TRACKER_DELAY, self.frame, self.name, True, pose)
