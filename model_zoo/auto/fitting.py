"""Fits of candidates, one after the other or in several processes: what fails is an outcome with its reason."""

from __future__ import annotations

import importlib.util
import warnings
from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Any

import numpy as np

from sysid_evo.data import Dataset
from sysid_evo.models import DynamicsModel
from sysid_evo.models.base import make_model
from sysid_evo.processors import available_processors
from sysid_evo.progress import Progress
from sysid_evo.registry import models
from sysid_evo.types import Array
from sysid_evo.validation.simulation_error import HeldOutTest

WORTH = 10.0
"""Seconds of work for which one more process is worth its start."""
IDLE = 60
"""Seconds after which processes end that have nothing to do."""
LARGE = ("numba", "pysindy")
"""Libraries of candidates that take 60 and 170 MB. A process that loads them after its first task looks to joblib as if
it leaked (300 MB): it is ended with a warning, and the next one loads them again."""
PARTS = 10
"""Parts in which a second of work is told."""


@dataclass(frozen=True)
class FitTask:
    """One fit: the model to make, what it learns from, the seed, and the trial in which it is judged, if it is.

    ``key`` is by whom its outcome is known, ``cost`` about how many seconds it takes.
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
    """What became of a `FitTask`: the fitted model, what it simulated in the trial, and why there is none."""

    model: DynamicsModel | None = None
    simulated: Array | None = None
    diverged: float = 0.0
    reason: str = ""


class FitInterrupted(BaseException):
    """Carries what a `Progress` raised past those who take every exception of a candidate for its failure."""

    def __init__(self, cause: BaseException) -> None:
        super().__init__()
        self.cause = cause


def fitted(task: FitTask, progress: Progress | None = None) -> FitOutcome:
    """Return what becomes of ``task``. Raises only `FitInterrupted`, and what stops a program."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what a candidate warns of is no concern of who asked for their mean
            model = make_model(task.name, **task.parameters)
            model.fit(task.dataset, rng=np.random.default_rng(task.seed), progress=progress)
            if task.trial is None:
                return FitOutcome(model)
            simulated = task.trial.run(model)
            return FitOutcome(model, simulated, task.trial.diverged(model, simulated))
    except Exception as error:  # a plugin may fail in any way; the other candidates go on
        return FitOutcome(reason=f"{type(error).__name__}: {error}".splitlines()[0])


class FitWork:
    """Computes tasks and tells how far it is, in parts of ``seconds`` of expected work."""

    def __init__(self, progress: Progress | None, seconds: float) -> None:
        self._progress = progress
        self._total, self._done = max(1, round(PARTS * seconds)), 0.0

    def outcomes(self, tasks: Sequence[FitTask]) -> dict[tuple[int, int], FitOutcome]:
        """Return the outcome of each task by its key: the same ones for any number of processes."""
        seconds = sum(task.cost for task in tasks)
        processes = min(available_processors(), int(seconds / WORTH), len(tasks))
        ordered = sorted(tasks, key=lambda task: -task.cost)
        # another process finds a family by its name, not where a file was loaded that is not installed
        ours = __name__.partition(".")[0]
        elsewhere = [t for t in ordered if processes > 1 and models.module(t.name).partition(".")[0] == ours]
        found: dict[tuple[int, int], FitOutcome] = {}
        try:
            for task in ordered:
                if task not in elsewhere:
                    found[task.key] = fitted(task, self._part(task))
                    self._advance(task.cost)
            with closing(_side_by_side(elsewhere, processes)) as ended:
                for task, outcome in ended:
                    found[task.key] = outcome
                    self._advance(task.cost)
        except FitInterrupted as stopped:
            raise stopped.cause from None
        return found

    def still(self) -> None:
        """Tell that the work goes on."""
        self._advance(0.0)

    def _advance(self, seconds: float) -> None:
        self._done += PARTS * seconds
        self._tell(self._done)

    def _part(self, task: FitTask) -> Progress:
        def progress(done: int, total: int, note: str = "") -> None:  # noqa: ARG001  # of a fit, numbers are told
            self._tell(self._done + PARTS * task.cost * done / max(1, total))

        return progress

    def _tell(self, done: float) -> None:
        if self._progress is None:
            return
        try:
            self._progress(min(int(done), self._total), self._total)
        except BaseException as error:  # handed on as it is, past those who take every exception for a failed fit
            raise FitInterrupted(error) from None


def _side_by_side(tasks: Sequence[FitTask], processes: int) -> Generator[tuple[FitTask, FitOutcome], None, None]:
    """Yield the outcomes of ``tasks`` as they come; closed before the last, it ends what is still computed."""
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
        idle_worker_timeout=IDLE,
        initializer=load,
        initargs=(LARGE,),
    )
    outcomes = pool(call(number, task) for number, task in enumerate(tasks))
    try:
        for number, outcome in outcomes:
            yield tasks[number], outcome
    finally:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # that something is cancelled is what is wanted
            outcomes.close()


def load(libraries: Sequence[str]) -> None:
    """Import those of ``libraries`` that are installed."""
    for name in libraries:
        if importlib.util.find_spec(name) is not None:
            importlib.import_module(name)


def _numbered(number: int, task: FitTask) -> tuple[int, FitOutcome]:
    return number, fitted(task)
