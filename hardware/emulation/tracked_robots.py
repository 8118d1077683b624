"""Robots with a pose: physics under an emulated optical tracker, or any model without tracker errors."""

from __future__ import annotations

import math

import numpy as np

from hardware.connection import GateLimits, Measurement
from hardware.emulation.held_control import HeldControl
from hardware.emulation.simulated_robot import PhysicsConnection, SimulatedConnection, SimulatedRobot
from sysid_evo.carry import clip_state
from sysid_evo.errors import IncompatibleSystem
from sysid_evo.models.dynamics import Dynamics, started
from sysid_evo.motion import PlanarBody
from sysid_evo.types import Array


class TrackedRobot(SimulatedRobot):
    """A planar robot whose physics step at the tracker's rate; controllers run at every ``repeats``-th step.

    ``gate`` are the limits of the body's motion, if they are above the defaults (`GateLimits`). Raises
    `IncompatibleSystem` for another motion.
    """

    def __init__(self, name: str, physics: Dynamics, *, repeats: int, gate: GateLimits | None = None) -> None:
        if not isinstance(physics.system.motion, PlanarBody):
            raise IncompatibleSystem(f"robot {name!r}: the emulated tracker needs a planar body, got another motion")
        self.name = name
        self.physics = physics
        self.dynamics: HeldControl = HeldControl(physics, repeats)
        self.system = self.dynamics.system
        self.gate = GateLimits.read(gate)

    def connect(self, *, seed: int | None = None) -> TrackedConnection:
        return TrackedConnection(self.name, self.physics, seed=seed, gate=self.gate)


class TrackedConnection(PhysicsConnection):
    """A session with an emulated robot under an emulated tracker."""

    def __init__(self, name: str, physics: Dynamics, *, seed: int | None, gate: GateLimits | None = None) -> None:
        super().__init__(name, physics, seed=seed)
        self.gate_limits = GateLimits.read(gate)
        self._tracker = TrackerErrorModel(self._errors)

    def _advance(self) -> None:
        before, self._carry = self.state, self._stepped()
        self.pose = self._system.move(self.pose, before, self.state)

    def _look(self, time: float) -> Measurement:
        pose = self._tracker.observe(self.pose)
        return Measurement(time, time + TRACKER_DELAY, self.frame, self.name, True, pose)


TRACKER_DELAY = 0.004  # s from frame to arrival: "in the order of milliseconds" (paper, section 3)
POSITION_ERROR = 0.001  # m: "in the order of millimeters" (paper, section 3)
HEADING_ERROR = math.radians(0.3)  # from 1 mm on markers some 15 cm apart
CORRELATION = 0.3
"""Correlation of one frame's error with the next: the cameras see the same markers from almost the same angle."""


class TrackerErrorModel:
    """Adds first-order correlated normal errors to planar poses, frame by frame.

    Standard deviations are 1 mm in x and y and 0.3 degrees in heading; headings are in [-pi, pi).
    """

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng
        self._error = rng.standard_normal(3)
        self._scale = np.array([POSITION_ERROR, POSITION_ERROR, HEADING_ERROR])

    def observe(self, pose: Array) -> Array:
        """Return the measurement of the true ``pose`` (3,): m, m, rad."""
        measured: Array = pose + self._scale * self._error
        measured[2] = (measured[2] + math.pi) % (2.0 * math.pi) - math.pi
        fresh = math.sqrt(1.0 - CORRELATION**2)
        self._error = CORRELATION * self._error + fresh * self._rng.standard_normal(3)
        return measured


FRAMES = 10  # of the tracker in one sample: 200 Hz at 20 Hz
LEAD = 2
"""Frames between the command that starts a session and the sample that it starts.

Later commands are due at multiples of dt after the first; one that is late by less than this still
counts for its own sample.
"""


class ModelRobot(SimulatedRobot):
    """Any ``dynamics`` whose motion has a pose, with a tracker without errors, so that a person can drive a model.

    Paper, section 5.2.3. Raises `IncompatibleSystem` for dynamics without a motion.
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

    def connect(self, *, seed: int | None = None) -> ModelConnection:
        return ModelConnection(self.name, self.dynamics, seed=seed)


class ModelConnection(SimulatedConnection):
    """A session with a model, which uses the command in force at the start of each of its samples.

    It rests in the origin until the first command that is not neutral; its samples are counted from there. Poses are
    exact at the ends of a sample and interpolated in between. The body is lost once the state is no longer finite.
    """

    gate_limits = GateLimits(speed=math.inf, yaw_rate=math.inf, jump=math.inf, turn=math.inf, frozen=None)
    """None: a model has no limits of motion, and its poses have no noise."""

    def __init__(self, name: str, dynamics: Dynamics, *, seed: int | None) -> None:
        system = dynamics.system
        super().__init__(name, system, system.dt / FRAMES)
        self._dynamics = dynamics
        self._rng = np.random.default_rng(seed)
        self._carry = started(dynamics, system.neutral_state[None], self._rng.standard_normal((1, dynamics.n_draws)))
        self._origin = self.pose
        self._before = self._after = system.neutral_state
        self._phase = -LEAD
        self._resting = True

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
        self._carry, _ = clip_state(stepped, dynamics.state_bounds)
        self._after = self._carry[0, :nx].copy()

    def _look(self, time: float) -> Measurement:
        seen = bool(np.isfinite(self.pose).all())
        return Measurement(time, time, self.frame, self.name, seen, self.pose)
