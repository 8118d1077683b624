"""Robots with sensors and no pose: physics or equations, session, recording."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import astuple, dataclass
from typing import Any, ClassVar

import numpy as np

from hardware.connection import Measurement
from hardware.emulation.held_control import HeldControl
from hardware.emulation.parameters import RobotParameters
from hardware.emulation.simulated_robot import PhysicsConnection, SimulatedRobot
from hardware.recording.manoeuvres import Manoeuvre, excitation_manoeuvres
from hardware.recording.record import RecordingJob, RecordingResult, prepare_logs
from hardware.run_report import LoopReport, StopReason, StopRequest
from hardware.self_test import SelfTestFinding, equation_findings, sensors_finding
from sysid_evo.carry import clip_state
from sysid_evo.data.preparation import REACH, STENCIL, RawLog
from sysid_evo.errors import InvalidSystem, LinkLost
from sysid_evo.kernels import DynamicsKernel, ScalarStep
from sysid_evo.laws import array_form
from sysid_evo.models.dynamics import PlainDynamics, rk4
from sysid_evo.system import System
from sysid_evo.types import Array, check_shape


@dataclass(frozen=True)
class Sensor:
    """Sensor of a state with a normal error of deviation ``noise`` and steps of ``resolution``; 0 is none."""

    noise: float = 0.0
    resolution: float = 0.0


class SensedPhysics(PlainDynamics):
    """Physics in fine steps, and their sensors.

    ``sensors`` names the measured states. ``estimated_rates`` names for each other state the measured one whose rate it
    is: it is estimated from that. A state that is in neither is measured without errors.
    """

    sensors: ClassVar[Mapping[str, Sensor]] = {}
    estimated_rates: ClassVar[Mapping[str, str]] = {}

    def release_state(self, rng: np.random.Generator) -> Array:
        """Return the state (nx,) in which a recording begins, by default at rest."""
        return self.system.neutral_state.copy()

    @property
    def measured_sensors(self) -> Mapping[str, Sensor]:
        """The sensor of each state that is not estimated."""
        measured = (name for name in self.system.state_names if name not in self.estimated_rates)
        return {name: self.sensors.get(name, Sensor()) for name in measured}


class ScalarPhysics(SensedPhysics):
    """Physics of one ``law(x, u, w, p)`` of single numbers for both forms, which returns the next carry.

    ``p`` are the `numbers`, ``w`` is the noise, 0 for none. By default the carry is the state and the last control.
    ``parameters`` are ``nominal`` unless given.
    """

    law: ClassVar[Callable[..., Any]]
    nominal: ClassVar[RobotParameters]
    lag: ClassVar[str] = "motor_lag"
    n_lags = 1
    n_noise = 1

    def __init__(self, parameters: RobotParameters | None = None) -> None:
        self.parameters = self.nominal if parameters is None else parameters

    @property
    def numbers(self) -> Array:
        """The parameters of the law in their order, and the share of ``lag`` (s) that a step covers."""
        share = -math.expm1(-self.system.dt / getattr(self.parameters, self.lag))
        return np.array([*astuple(self.parameters), share])

    def start(self, states: Array, controls: Array, draws: Array | None = None) -> Array:
        return np.concatenate([states[:, -1], controls[:, -1]], axis=1)

    def step(self, carry: Array, control: Array, noise: Array | None = None) -> Array:
        noise = np.zeros((len(carry), self.n_noise)) if noise is None else noise
        return np.stack(array_form(type(self).law)(carry.T, control.T, noise.T, self.numbers), axis=1)

    def kernel(self) -> DynamicsKernel:
        step = ScalarStep(type(self).law, n_carry=self.n_carry, nu=self.system.nu, n_noise=self.n_noise)
        return DynamicsKernel(step, self.numbers)


class Equations(SensedPhysics):
    """Base class of robots from equations: give ``system`` and `rates_of_change`, and make a `SensedRobot` of it.

    One step of ``system.dt`` takes ``substeps`` steps of the classical fourth-order Runge-Kutta method, under one
    control. The carry is the state. If states have limits, the loops that step it clip to them. Raises `InvalidSystem`
    without a system.
    """

    substeps: int = 4

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        system = getattr(cls, "system", None)
        if not isinstance(system, System):
            raise InvalidSystem(
                f"{cls.__name__}: expected a class attribute system = System(states=..., controls=..., dt=...), "
                f"got {system!r}"
            )
        cls.n_carry = system.nx

    @abstractmethod
    def rates_of_change(self, states: Array, controls: Array) -> Array | Mapping[str, Array]:
        """Return the change of every state per second, (B, nx), in ``states`` (B, nx) under ``controls`` (B, nu).

        It may also be one array (B,) for each state, by the state's name.
        """

    @property
    def state_bounds(self) -> Array | None:
        limits = np.array([[c.low for c in self.system.states], [c.high for c in self.system.states]])
        return limits if np.isfinite(limits).any() else None

    def start(self, states: Array, controls: Array, draws: Array | None = None) -> Array:
        return states[:, -1].copy()

    def step(self, carry: Array, control: Array, noise: Array | None = None) -> Array:
        for _ in range(self.substeps):
            carry = rk4(lambda states: self._rates(states, control), carry, self.system.dt / self.substeps)
        return carry

    def _rates(self, states: Array, controls: Array) -> Array:
        """Return the change per second (B, nx). Raises `InvalidSystem` for other names than those of the states."""
        given, names = self.rates_of_change(states, controls), self.system.state_names
        if isinstance(given, Mapping):
            if set(given) != set(names):
                raise InvalidSystem(
                    f"{type(self).__name__}.rates_of_change: expected the change per second of {', '.join(names)}, "
                    f"got {', '.join(map(str, given)) or 'none'}"
                )
            given = np.stack([np.broadcast_to(given[name], len(states)) for name in names], axis=1)
        return check_shape(f"{type(self).__name__}.rates_of_change", given, states.shape)


class SensedRobot(SimulatedRobot):
    """A robot without a pose; its sensors are read at every fine step, controllers run at every ``repeats``-th."""

    stepped: ClassVar[bool] = True

    def __init__(self, name: str, physics: SensedPhysics, *, repeats: int = 1, default_task: str = "") -> None:
        self.name = name
        self.physics = physics
        self.default_task = default_task
        self.dynamics: HeldControl = HeldControl(physics, repeats)
        self.system = self.dynamics.system

    def connect(self, *, seed: int | None = None) -> SensedConnection:
        return SensedConnection(self.name, self.physics, seed=seed)

    def self_test(
        self, *, seconds: float, seed: int | None = None, stop: StopRequest | None = None
    ) -> tuple[SelfTestFinding, ...]:
        """Report the sensor readings at rest, and the response of the equations to each control."""
        period, readings = self.physics.system.dt, []
        stop = StopRequest() if stop is None else stop
        with self.connect(seed=seed) as connection:
            for _ in range(max(2, round(seconds / period))):
                with stop.answer(self.name):
                    connection.measure(period)
                readings.append(connection.reading)
                if stop.reason is not None:
                    break
        names, rates = tuple(self.physics.measured_sensors), self.physics.estimated_rates
        sensors = sensors_finding(self.system, names, np.array(readings), rates, period)
        return equation_findings(self.dynamics, sensors, stop=stop)

    def manoeuvres(self, *, duration: float, rng: np.random.Generator) -> list[Manoeuvre]:
        return excitation_manoeuvres(self.system, duration=duration, rng=rng)

    def _record_run(self, manoeuvres: Sequence[Manoeuvre], job: RecordingJob) -> RecordingResult:
        """Drive these manoeuvres, read the sensors, and estimate the other states from them.

        Each manoeuvre is a session of its own, begun in the release state. Nothing is written to the job's folder: a
        session in simulated time cannot be lost half way. Raises `InvalidData` if it is too short.
        """
        total = sum(len(manoeuvre.controls) for manoeuvre in manoeuvres)
        logs: list[RawLog] = []
        done, reason, detail = 0, StopReason.PILOT, ""
        stop = job.stop
        for number, manoeuvre in enumerate(manoeuvres):
            try:
                log = self._driven(manoeuvre, np.random.SeedSequence(job.seed, spawn_key=(number,)), stop)
            except LinkLost as error:
                reason, detail = stop.reason or StopReason.LINK_LOST, str(error)
                break
            if stop.reason is not None:
                reason, detail = stop.reason, stop.detail
                break
            logs.append(log)
            done += len(manoeuvre.controls)
            if job.progress is not None:
                job.progress(done, total)
        report = LoopReport(reason, detail, lateness=np.zeros(done), gaps=np.full(max(0, done - 1), self.system.dt))
        if report.reason.is_fault and not logs:
            raise LinkLost(f"{self.name}: {report.sentence}; nothing was recorded")
        return RecordingResult(tuple(logs), prepare_logs(logs, self.system), report)

    def _driven(self, manoeuvre: Manoeuvre, seeds: np.random.SeedSequence, stop: StopRequest) -> RawLog:
        """Return the sensor readings during a manoeuvre, up to a stop, and the rates estimated from them."""
        release, session = seeds.spawn(2)
        state = self.physics.release_state(np.random.default_rng(release))
        system, period = self.system, self.physics.system.dt
        seed = int(session.generate_state(1, np.uint64)[0])
        readings, controls = [], []
        with SensedConnection(self.name, self.physics, seed=seed, state=state) as connection:
            connection.measure(period)
            for control in manoeuvre.controls:
                connection.send(control, valid_for=2.0 * system.dt)
                for _ in range(self.dynamics.repeats):
                    readings.append(connection.reading)
                    controls.append(control)
                    with stop.answer(self.name):
                        connection.measure(period)
                if stop.reason is not None:
                    break
        measured = dict(zip(self.physics.measured_sensors, np.array(readings).T, strict=True))
        rates = {
            name: rate(self._unwrapped(of, measured[of]), period) for name, of in self.physics.estimated_rates.items()
        }
        time = period * np.arange(len(readings), dtype=np.float64)
        return RawLog(manoeuvre.name, time, np.empty((len(time), 0)), np.array(controls), {**measured, **rates})

    def _unwrapped(self, name: str, values: Array) -> Array:
        period = self.system.periods.get(self.system.state_names.index(name))
        return values if period is None else np.unwrap(values, period=period)


class SensedConnection(PhysicsConnection):
    """A session with a `SensedRobot`, which has no pose; ``reading`` are the last sensor readings, in order."""

    _physics: SensedPhysics

    def __init__(self, name: str, physics: SensedPhysics, *, seed: int | None, state: Array | None = None) -> None:
        super().__init__(name, physics, seed=seed, state=state)
        self.reading = self._read()

    def _advance(self) -> None:
        self._carry, _ = clip_state(self._stepped(), self._physics.state_bounds)

    def _look(self, time: float) -> Measurement:
        self.reading = self._read()
        return Measurement(time, time, self.frame, self.name, True, self.pose)

    def _read(self) -> Array:
        system, sensors = self._physics.system, self._physics.measured_sensors
        true = self._carry[0, [system.state_names.index(name) for name in sensors]]
        noise = np.array([sensor.noise for sensor in sensors.values()])
        step = np.array([sensor.resolution for sensor in sensors.values()])
        value = true + noise * self._errors.standard_normal(len(true))
        whole: Array = np.where(step > 0.0, step, 1.0)
        return np.where(step > 0.0, np.round(value / whole) * whole, value)


def rate(values: Array, step: float) -> Array:
    """Return the change per second of ``values`` (N,) every ``step`` s; the first and last two repeat their neighbours.

    Those are cut off by the filter of the preparation anyway.
    """
    if len(values) <= 2 * REACH:
        return np.zeros(len(values))
    return np.pad(np.convolve(values, STENCIL, mode="valid") / step, REACH, mode="edge")
