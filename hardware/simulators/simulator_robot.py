"""A simulator as a robot: self-test, recording, no connection."""

from __future__ import annotations

import time
from typing import ClassVar

import numpy as np

from hardware.connection import Connection
from hardware.recording.manoeuvres import Manoeuvre
from hardware.recording.record import RecordingJob, RecordingResult
from hardware.robot import Robot
from hardware.run_report import StopRequest
from hardware.self_test import SelfTestFinding, describe_channel
from hardware.simulators.recording import record_simulator, samples_each
from hardware.simulators.simulator import LONGEST_SEED, ExternalSimulator, SimulatorRunner
from sysid_evo.data.units import spelled_range
from sysid_evo.errors import IncompatibleSystem


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
        rng, steps = np.random.default_rng(seed or 0), max(FEWEST, round(seconds / system.dt))
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


FEWEST = 200
"""Minimum number of steps that are tried."""
TIMED_STEPS, TIMED_SECONDS = 200, 0.2
"""The number of steps, or the time in s, after which a timing ends."""
