"""A simulator as a robot: self-test, recording by steps, sweeps and random feedback, no connection."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from hardware.connection import Connection
from hardware.recording.manoeuvres import Manoeuvre
from hardware.recording.record import RecordingJob, RecordingResult
from hardware.robot import Robot
from hardware.run_report import LoopReport, StopReason, StopRequest
from hardware.self_test import SelfTestFinding, describe_channel
from hardware.simulators.simulator import LONGEST_SEED, ExternalSimulator, SimulatorRunner, SimulatorSession, ending_of
from sysid_evo.data import Dataset, Trajectory
from sysid_evo.data.units import spelled_range
from sysid_evo.errors import IncompatibleSystem, InvalidArgument, InvalidData, LinkLost
from sysid_evo.progress import Counter
from sysid_evo.system import System
from sysid_evo.types import Array

FEWEST = 100
"""Minimum number of samples of every script."""
SHORTEST = 2
"""Minimum number of samples of an episode that is kept."""

HOLDS = (1.0, 4.0, 12.0)
"""Mean samples between steps of a control, from faster than most systems to slower."""

SCRIPTS = (*(f"steps-{hold:g}" for hold in HOLDS), "sweep", *(f"feedback-{i}" for i in range(1, 5)))
"""Half of the recording is feedback."""


def record_simulator(simulator: ExternalSimulator, duration: float, job: RecordingJob) -> RecordingResult:
    """Excite ``simulator`` for ``duration`` s of its time and return the recording.

    An eighth of the time is used for each of steps of three lengths, sine sweeps, and four times random feedback. When
    an episode ends, because it is over or its time is up, the next begins with a reset of the simulator. The same seed
    gives the same recording. A step whose numbers are not finite is left out and ends the episode. Raises
    `InvalidArgument` if it is too short, `InvalidData` if the simulator ends every episode at once.
    """
    system, stop = simulator.system, job.stop
    each = samples_each(simulator, duration)
    rng = np.random.default_rng(job.seed)
    episodes: list[Trajectory] = []
    tried: list[tuple[int, Array]] = []
    reason, detail, done = StopReason.SAMPLES, "", 0
    counter = Counter(job.progress, len(SCRIPTS) * each)
    try:
        with simulator.open() as session:
            for name in SCRIPTS:
                script = _script(name, system, [episode.states for episode in episodes], tried, rng.spawn(1)[0])
                made = enumerate(_episodes(session, simulator, script, each, rng, counter, stop), start=1)
                for count, (states, controls, rewards, ending) in made:
                    done += len(controls)
                    if len(controls) >= SHORTEST:
                        episode = Trajectory(
                            np.array(states),
                            np.array(controls),
                            system.dt,
                            name=f"{name}-{count}",
                            rewards=np.array(rewards) if simulator.rewarded else None,
                            ending=ending,
                        )
                        episodes.append(episode)
                if stop.reason is not None:
                    reason = stop.reason
                    break
    except LinkLost as error:
        reason, detail = stop.reason or StopReason.LINK_LOST, str(error)
    if reason is StopReason.SAMPLES and done < each * len(SCRIPTS):
        detail = f"{each * len(SCRIPTS) - done} steps were left out, since their numbers are not finite"
    report = LoopReport(reason, detail, np.zeros(0), np.zeros(0))
    if reason.is_fault and not episodes:
        raise LinkLost(f"{simulator.name}: {report.sentence}; nothing was recorded")
    if not episodes:
        raise InvalidData(
            f"{simulator.name}: every episode ended within {SHORTEST} steps, so that nothing was recorded"
        )
    return RecordingResult((), Dataset(system, tuple(episodes)), report)


def samples_each(simulator: ExternalSimulator, duration: float) -> int:
    """Return the samples of each script in a recording of ``duration`` s. Raises `InvalidArgument` for too few."""
    dt, count = simulator.system.dt, len(SCRIPTS)
    each = round(duration / dt / count)
    if each < FEWEST:
        raise InvalidArgument(
            f"recording of {simulator.name}: expected at least {FEWEST * count * dt / 60.0:.2g} min for "
            f"{count} scripts of {FEWEST} samples, got {duration / 60.0:.2g} min"
        )
    return each


def _script(
    name: str, system: System, seen: list[Array], tried: list[tuple[int, Array]], rng: np.random.Generator
) -> ExcitationScript:
    kind, _, which = name.partition("-")
    if kind == "steps":
        return RandomSteps(system, float(which), rng)
    if kind == "sweep":
        return SineSweep(system, rng)
    return RandomFeedback(system, np.concatenate(seen) if seen else system.neutral_state[None], tried, rng)


def _episodes(
    session: SimulatorSession,
    simulator: ExternalSimulator,
    script: ExcitationScript,
    steps: int,
    rng: np.random.Generator,
    counter: Counter,
    stop: StopRequest,
) -> Iterator[tuple[list[Array], list[Array], list[float], str]]:
    """Yield states, controls, rewards and ending of each episode, ``steps`` in all, fewer if it is stopped."""
    system, done, lasted, before = simulator.system, 0, 0, counter.done
    while done < steps and stop.reason is None:
        with stop.answer(simulator.name):
            states, controls, rewards = [session.reset(int(rng.integers(LONGEST_SEED)))], [], []
        script.begin(lasted)
        ended, ending = False, ""
        while done < steps and not ended and stop.reason is None:
            control = system.actuate(script.next(states[-1]))
            with stop.answer(simulator.name):
                state, reward, over, late = session.step(control)
            done += 1
            if not (np.isfinite(state).all() and np.isfinite(reward)):  # the step is not data, all before it is
                break
            states.append(state)
            controls.append(control)
            rewards.append(reward)
            ended, ending = over or late, ending_of(over, late)
        lasted = len(controls)
        counter.advance(before + done - counter.done)
        yield states, controls, rewards, ending


SWEEP = 200
"""Samples of one sine sweep."""
FASTEST, SLOWEST = 4.0, 100.0
"""Samples in one period at either end of a sweep."""
FEEDBACK = 0.2
"""Mean share of the samples of a feedback that are replaced by steps."""
MIN_FEEDBACKS, REUSE_SHARE, WEIGHT_CHANGE = 20, 0.5, 0.1
"""Number of feedbacks before one is reused, share of episodes with a reused one, and change of its weights."""


class ExcitationScript(ABC):
    """An endless sequence of controls: numbers in [-1, 1] for `System.actuate`."""

    @abstractmethod
    def begin(self, lasted: int) -> None:
        """Begin an episode; the one before ``lasted`` that many steps, 0 if there was none."""

    @abstractmethod
    def next(self, state: Array) -> Array:
        """Return the next control (nu,), in ``state`` (nx,)."""


class RandomSteps(ExcitationScript):
    """Every control jumps to a value at random times, independently; one time in three to one of its limits."""

    def __init__(self, system: System, mean: float, rng: np.random.Generator) -> None:
        self._rng, self._mean = rng, mean
        self._value = self._drawn(system.nu)

    def begin(self, lasted: int) -> None:
        self._value = self._drawn(len(self._value))

    def next(self, state: Array) -> Array:
        jumps = self._rng.random(len(self._value)) < 1.0 / self._mean
        self._value = np.where(jumps, self._drawn(len(self._value)), self._value)
        return self._value

    def _drawn(self, count: int) -> Array:
        inner = self._rng.uniform(-1.0, 1.0, count)
        return np.where(self._rng.random(count) < 1.0 / 3.0, np.sign(inner), inner)


class SineSweep(ExcitationScript):
    """Sines of rising frequency, from one period in 100 samples to one in 4, each control with its phase and height."""

    def __init__(self, system: System, rng: np.random.Generator) -> None:
        self._rng, self._nu = rng, system.nu
        self._values: Iterator[Array] = iter(())

    def begin(self, lasted: int) -> None:
        self._values = iter(())

    def next(self, state: Array) -> Array:
        value = next(self._values, None)
        if value is None:
            frequency = np.geomspace(1.0 / SLOWEST, 1.0 / FASTEST, SWEEP)[:: self._rng.choice([1, -1])]
            phase = 2.0 * np.pi * (np.cumsum(frequency)[:, None] + self._rng.random(self._nu))
            self._values = iter(self._rng.uniform(0.3, 1.0, self._nu) * np.sin(phase))
            value = next(self._values)
        return value


class RandomFeedback(ExcitationScript):
    """A feedback towards an earlier state, with weights drawn for every episode and some steps in between.

    A system whose episodes end soon under any fixed sequence, such as a cart with a pole, lasts under some feedbacks,
    and has large motions under others. Every second episode uses weights near those of one that lasted long, so that it
    goes where the state can be kept. ``seen`` are states (N, nx) that give scale and targets, ``tried`` the durations
    in steps and weights (nu, n) of earlier feedbacks, to which this one adds.
    """

    def __init__(self, system: System, seen: Array, tried: list[tuple[int, Array]], rng: np.random.Generator) -> None:
        self._system, self._rng, self._tried = system, rng, tried
        self._seen = system.regressors(seen)
        spread = self._seen.std(axis=0)
        self._scale = 1.0 / np.where(spread > 0.0, spread, 1.0)
        self._steps = RandomSteps(system, 3.0, rng)
        self._weights = np.zeros((system.nu, len(self._scale)))
        self.begin(0)

    def begin(self, lasted: int) -> None:
        if lasted > 0:
            self._tried.append((lasted, self._weights * self._scale))
        self._weights = self._drawn()
        self._aim = self._seen[self._rng.integers(len(self._seen))]
        self._dither = self._rng.uniform(0.0, 2.0 * FEEDBACK)

    def next(self, state: Array) -> Array:
        step = self._steps.next(state)
        if self._rng.random() < self._dither:
            return step
        return np.tanh(self._weights @ ((self._system.regressors(state) - self._aim) * self._scale))

    def _drawn(self) -> Array:
        """Return new weights, or weights near those that lasted longest."""
        drawn = self._rng.standard_normal(self._weights.shape)
        if len(self._tried) >= MIN_FEEDBACKS and self._rng.random() < REUSE_SHARE:
            longest = sorted(self._tried, key=lambda one: -one[0])[: max(1, len(self._tried) // 20)]
            weights: Array = longest[self._rng.integers(len(longest))][1] / self._scale
            return weights + WEIGHT_CHANGE * np.abs(weights) * drawn
        return float(np.exp(self._rng.uniform(-1.5, 1.5))) * drawn


class SimulatorRobot(Robot):
    """A ``simulator`` that advances only when it is stepped, so that nothing runs in real time."""

    stepped: ClassVar[bool] = True
    dynamics = None
    simulator: ExternalSimulator

    def __init__(self, simulator: ExternalSimulator) -> None:
        self.name, self.system, self.simulator = simulator.name, simulator.system, simulator

    def connect(self, *, seed: int | None = None) -> Connection:
        """Raise `IncompatibleSystem`: an environment has no clock and no tracker."""
        raise IncompatibleSystem(
            f"{self.name} is an environment: it has no clock and no tracker, so the control loop cannot drive it. "
            "sysid-evo record and compare run it step by step"
        )

    def runner(self) -> SimulatorRunner:
        return SimulatorRunner(self.simulator)

    def step_seconds(self) -> float:
        """Return the mean seconds of a step under random controls, with the resets in between.

        Steps at rest may be much cheaper, for example those of an integrator that chooses its steps. The first step is
        not counted, because it may load what the others need.
        """
        rng, count = np.random.default_rng(0), 0
        with self.simulator.open() as session:
            session.reset(0)
            session.step(self.system.actuate(np.zeros(self.system.nu)))
            began = now = time.perf_counter()
            while count < TIMED_STEPS and now < began + TIMED_SECONDS:
                _, _, ended, late = session.step(self.system.actuate(rng.uniform(-1.0, 1.0, self.system.nu)))
                if ended or late:
                    session.reset(count)
                count, now = count + 1, time.perf_counter()
        return (now - began) / count

    def self_test(
        self, *, seconds: float, seed: int | None = None, stop: StopRequest | None = None
    ) -> tuple[SelfTestFinding, ...]:
        """Report its channels, and how episodes run under random controls for ``seconds`` of its own time."""
        simulator, system = self.simulator, self.system
        stop = StopRequest() if stop is None else stop
        states, controls = (", ".join(map(describe_channel, channels)) for channels in (system.states, system.controls))
        sentence = f"States: {states}. Controls: {controls}. One step is {system.dt:g} s; it does not run in real time."
        rng, steps = np.random.default_rng(seed or 0), max(FEWEST_TRIED, round(seconds / system.dt))
        lengths, seen, rewards = [0], [], []
        began = time.perf_counter()
        with simulator.open() as session:
            with stop.answer(simulator.name):
                seen.append(session.reset(int(rng.integers(LONGEST_SEED))))
            for _ in range(steps):
                if stop.reason is not None:
                    break
                control = system.actuate(rng.uniform(-1.0, 1.0, system.nu))
                with stop.answer(simulator.name):
                    state, reward, ended, late = session.step(control)
                lengths[-1] += 1
                seen.append(state)
                rewards.append(reward)
                if ended or late:
                    lengths.append(0)
                    with stop.answer(simulator.name):
                        seen.append(session.reset(int(rng.integers(LONGEST_SEED))))
        took = time.perf_counter() - began
        low, high = np.min(seen, axis=0), np.max(seen, axis=0)
        ranges = [f"{c.name} {spelled_range(a, b)}" for c, a, b in zip(system.states, low, high, strict=True)]
        over = lengths[:-1]
        episodes = f"{len(over)} episodes ended, after {min(over)} to {max(over)} steps" if over else "No episode ended"
        reward_range = (
            f"rewards from {min(rewards):.3g} to {max(rewards):.3g} a step" if rewards else "no step was taken"
        )
        counted = f"{episodes}, in {len(rewards)} steps"
        return (
            SelfTestFinding("system", True, sentence, {"dt": system.dt}),
            SelfTestFinding("states", bool(np.isfinite(seen).all()), f"Under random controls: {', '.join(ranges)}."),
            SelfTestFinding("episodes", True, f"{counted}; {reward_range}." if simulator.rewarded else f"{counted}."),
            SelfTestFinding("speed", True, f"{len(rewards) / took:.0f} steps a second.", {"seconds": took}),
        )

    def manoeuvres(self, *, duration: float, rng: np.random.Generator) -> list[Manoeuvre]:
        """Return none, since excitation of an environment depends on its state; a short ``duration`` is an error."""
        samples_each(self.simulator, duration)
        return []

    def _record_excitation(self, duration: float, job: RecordingJob) -> RecordingResult:
        """Excite the simulator for ``duration`` s of its own time; there are no journals for the job's folder."""
        return record_simulator(self.simulator, duration, job)


FEWEST_TRIED = 200
"""Minimum number of steps that are tried."""
TIMED_STEPS, TIMED_SECONDS = 200, 0.2
"""The number of steps, or the time in s, after which a timing ends."""
