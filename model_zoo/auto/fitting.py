"""Fits of candidates, one after the other or in several processes; a failure is an outcome with its reason."""

from __future__ import annotations

import importlib.util
import warnings
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Any

import numpy as np

from sysid_evo.data import Dataset
from sysid_evo.models import DynamicsModel
from sysid_evo.models.base import make_model
from sysid_evo.processors import available_processors
from sysid_evo.progress import Progress
from sysid_evo.registry import load_plugins_again, loaded_plugins, models
from sysid_evo.registry.objects import objects_named, receive_objects
from sysid_evo.types import Array
from sysid_evo.validation.simulation_error import HeldOutTest

SECONDS_PER_PROCESS = 10.0
"""Seconds of work that justify starting one more process."""
IDLE_TIMEOUT = 60
"""Seconds after which idle processes end."""
LARGE_LIBRARIES = ("numba", "pysindy")
"""Libraries of candidates that take 60 and 170 MB.

Loaded after the first task of a process they look like a leak to joblib (300 MB), which ends the process with a
warning.
"""
PARTS = 10
"""Progress steps reported for a second of work."""


@dataclass(frozen=True)
class FitTask:
    """One fit: the model, its data and seed, and the held-out test of the fitted model, if any.

    ``key`` identifies the outcome, ``cost`` is the expected time in s.
    """

    key: tuple[int, int]
    name: str
    parameters: dict[str, Any]
    dataset: Dataset
    seed: int
    cost: float
    trial: HeldOutTest | None = None


@dataclass(frozen=True)
class FitOutcome:
    """Outcome of a `FitTask`: the fitted model and its held-out simulation, or the reason for the failure."""

    model: DynamicsModel | None = None
    simulated: Array | None = None
    diverged: float = 0.0
    reason: str = ""


class FitInterrupted(BaseException):
    """Carries an exception of a `Progress` past handlers that treat every exception as a failed candidate."""

    def __init__(self, cause: BaseException) -> None:
        super().__init__()
        self.cause = cause


def fitted(task: FitTask, progress: Progress | None = None) -> FitOutcome:
    """Return the outcome of ``task``. Raises only `FitInterrupted` and exceptions that end a program."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # warnings of a single candidate do not concern the user of the mean
            model = make_model(task.name, **task.parameters)
            model.fit(task.dataset, rng=np.random.default_rng(task.seed), progress=progress)
            if task.trial is None:
                return FitOutcome(model)
            simulated = task.trial.run(model)
            return FitOutcome(model, simulated, task.trial.diverged(model, simulated))
    except Exception as error:  # a plugin may fail in any way; the other candidates continue
        return FitOutcome(reason=f"{type(error).__name__}: {error}".splitlines()[0])


class FitWork:
    """Computes tasks and reports progress, in parts of ``seconds`` of expected work."""

    def __init__(self, progress: Progress | None, seconds: float) -> None:
        self._progress = progress
        self._total, self._done = max(1, round(PARTS * seconds)), 0.0

    def outcomes(self, tasks: Sequence[FitTask]) -> dict[tuple[int, int], FitOutcome]:
        """Return the outcome of each task by its key, independent of the number of processes."""
        seconds = sum(task.cost for task in tasks)
        processes = min(available_processors(), int(seconds / SECONDS_PER_PROCESS), len(tasks))
        ordered = sorted(tasks, key=lambda task: -task.cost)
        # another process cannot load a family from a file that is not installed
        ours = __name__.partition(".")[0]
        elsewhere = [t for t in ordered if processes > 1 and models.module(t.name).partition(".")[0] == ours]
        found: dict[tuple[int, int], FitOutcome] = {}
        try:
            for task in ordered:
                if task not in elsewhere:
                    found[task.key] = fitted(task, self._part(task))
                    self._advance(task.cost)
            with closing(_in_processes(elsewhere, processes)) as ended:
                for task, outcome in ended:
                    found[task.key] = outcome
                    self._advance(task.cost)
        except FitInterrupted as stopped:
            raise stopped.cause from None
        return found

    def report_alive(self) -> None:
        """Report that the work continues."""
        self._advance(0.0)

    def _advance(self, seconds: float) -> None:
        self._done += PARTS * seconds
        self._report(self._done)

    def _part(self, task: FitTask) -> Progress:
        def progress(done: int, total: int, note: str = "") -> None:  # noqa: ARG001  # the note of a fit is not shown
            self._report(self._done + PARTS * task.cost * done / max(1, total))

        return progress

    def _report(self, done: float) -> None:
        if self._progress is None:
            return
        try:
            self._progress(min(int(done), self._total), self._total)
        except BaseException as error:  # passed through handlers that treat every exception as a failed fit
            raise FitInterrupted(error) from None


def _in_processes(tasks: Sequence[FitTask], processes: int) -> Generator[tuple[FitTask, FitOutcome], None, None]:
    """Yield the outcomes of ``tasks`` as they come; closing it early stops the rest."""
    if not tasks:
        return
    from joblib import Parallel, delayed

    call: Callable[..., Any] = delayed(_numbered)
    pool = Parallel(
        processes,
        backend="loky",
        return_as="generator_unordered",
        batch_size=1,
        max_nbytes=None,
        idle_worker_timeout=IDLE_TIMEOUT,
        initializer=load,
        initargs=(LARGE_LIBRARIES, loaded_plugins(), objects_named(repr([t.parameters for t in tasks]).encode())),
    )
    outcomes = pool(call(number, task) for number, task in enumerate(tasks))
    try:
        for number, outcome in outcomes:
            yield tasks[number], outcome
    finally:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # cancelling is intended here
            outcomes.close()


def load(libraries: Sequence[str], plugins: Sequence[str], objects: Mapping[str, Any]) -> None:
    """Import those of ``libraries`` that are installed, and take over plugins and objects of the parent process."""
    for name in libraries:
        if importlib.util.find_spec(name) is not None:
            importlib.import_module(name)
    load_plugins_again(plugins)
    receive_objects(objects)


def _numbered(number: int, task: FitTask) -> tuple[int, FitOutcome]:
    return number, fitted(task)
