"""The contract of a robot: a system, and a connection to command it and to measure its pose."""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import ClassVar

import numpy as np

from hardware.connection import Connection
from hardware.control_loop import check_loop
from hardware.recording.manoeuvres import Manoeuvre, excitation_manoeuvres
from hardware.recording.record import RecordingJob, RecordingResult, record_through_loop
from hardware.run_report import PATIENCE, StopRequest
from hardware.self_test import SelfTestFinding, self_test
from sysid_evo.engine import DynamicsRunner, Runner
from sysid_evo.errors import InvalidArgument
from sysid_evo.extras import check_installed
from sysid_evo.models import Dynamics
from sysid_evo.models.dynamics import started
from sysid_evo.processors import resolve
from sysid_evo.progress import Progress, reporting
from sysid_evo.registry import Spec, make_robot
from sysid_evo.system import System


class Robot(ABC):
    """Base class of all registered robots: a ``system``, and sessions with it.

    ``name`` is shown in reports, ``system`` has its states, controls and sampling time, ``dynamics`` are its physics at
    that rate, None for a physical robot. A constructor takes keyword arguments, the keys of a robot's file, and checks
    them; it opens no port, starts no process and reads no device, so that a robot can be made without hardware.
    `connect` does all that.

    ``requires`` are the modules that it imports only when it connects. A ``stepped`` robot advances only when it is
    stepped: it has no clock and no tracker, records itself, and is not physical. It must answer each call within
    ``answers_within`` s. ``default_task`` is the spec of its default task, empty if it has none.
    """

    requires: ClassVar[tuple[str, ...]] = ()
    stepped: ClassVar[bool] = False
    answers_within: ClassVar[float] = PATIENCE
    default_task: str = ""
    name: str
    system: System
    dynamics: Dynamics | None

    @property
    def physical(self) -> bool:
        """Whether it is a real robot, which moves in real time."""
        return self.dynamics is None and not self.stepped

    def runner(self) -> Runner | None:
        """Return the runner of a comparison; None for a physical robot, which is driven by a separate command."""
        return None if self.dynamics is None else DynamicsRunner(self.dynamics)

    def step_seconds(self) -> float:
        """Return the measured seconds of a step of one trial in NumPy; 0 if its steps are compiled."""
        if self.dynamics is None or (self.dynamics.kernel() is not None and resolve() != "reference"):
            return 0.0
        alone = self._step_seconds(1)
        trials = int(np.clip(MAX_TIMING / alone, 1, TIMED_TRIALS))
        return self._step_seconds(trials) / trials

    def _step_seconds(self, trials: int) -> float:
        """Return the seconds of a step of the equations for a batch of that many trials."""
        dynamics, system = self.dynamics, self.system
        assert dynamics is not None
        carry = started(dynamics, np.tile(system.neutral_state, (trials, 1)))
        control, noise = np.tile(system.neutral_control, (trials, 1)), np.zeros((trials, dynamics.n_noise))
        return fastest(lambda: dynamics.step(carry, control, noise))

    def check(self) -> None:
        """Raise the errors of `connect` that can be detected without opening anything.

        A missing port is a `LinkLost`, a missing package a `MissingExtra`.
        """
        check_installed(f"robot {self.name!r}", self.requires)

    @abstractmethod
    def connect(self, *, seed: int | None = None) -> Connection:
        """Open a session; ``seed`` fixes the random draws of an emulated robot and has no effect on a physical one."""

    def self_test(
        self, *, seconds: float, seed: int | None = None, stop: StopRequest | None = None
    ) -> tuple[SelfTestFinding, ...]:
        """Return whether it is ready to be driven, after ``seconds`` without motion; see `self_test`."""
        return self_test(self, seconds=seconds, seed=seed, stop=stop)

    def manoeuvres(self, *, duration: float, rng: np.random.Generator) -> list[Manoeuvre]:
        """Return the manoeuvres of a recording of ``duration`` s.

        Raises `IncompatibleSystem` if the control loop cannot drive it, `InvalidArgument` if the time is too short.
        """
        check_loop(self.system)
        return excitation_manoeuvres(self.system, duration=duration, rng=rng)

    def record(
        self,
        *,
        seed: int,
        duration: float,
        folder: Path | None = None,
        stop: StopRequest | None = None,
        progress: Progress | bool | None = None,
    ) -> RecordingResult:
        """Excite it for ``duration`` s, with ``seed``, and record the response; ``progress`` True shows a bar."""
        with reporting(progress, "record") as report:
            return self._record_excitation(duration, RecordingJob(seed, folder, stop or StopRequest(), report))

    def _record_excitation(self, duration: float, job: RecordingJob) -> RecordingResult:
        """Record an excitation of ``duration`` s: its `manoeuvres`, unless a class has another excitation."""
        return self._record_run(self.manoeuvres(duration=duration, rng=np.random.default_rng(job.seed)), job)

    def _record_run(self, manoeuvres: Sequence[Manoeuvre], job: RecordingJob) -> RecordingResult:
        """Record these manoeuvres: through the control loop, unless a class has sessions of another kind."""
        return record_through_loop(self, manoeuvres, job)


TIMED_TRIALS = 300
"""Number of trials that are stepped together in a timing: about those of a generation."""
MAX_TIMING = 2.0
"""Longest time (s) of a timing, if that many trials take as long as one after the other."""


def fastest(step: Callable[[], object]) -> float:
    """Return the shortest time of ``step`` in s, over one call or as many as fit into 20 ms."""
    least, until = math.inf, time.perf_counter() + 0.02
    while True:
        began = time.perf_counter()
        step()
        ended = time.perf_counter()
        least = min(least, ended - began)
        if ended > until:
            return least


def find_robot(spec: str | Spec) -> Robot:
    """Return the robot with this ``spec``, as `sysid_evo.registry.make_robot` does, checked to be a `Robot`.

    Raises the errors of `make_robot`, and `InvalidArgument` if a plugin registered something else.
    """
    made = make_robot(spec)
    if not isinstance(made, Robot):
        raise InvalidArgument(
            f"robot {str(spec)!r}: expected a hardware.robot.Robot, got a {type(made).__name__}; "
            "derive the registered class from Robot, or let the registered function return one"
        )
    return made
