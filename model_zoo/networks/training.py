"""Training on simulations: windows, schedule, Adam, resuming.

Every window starts from its own measured state (multiple shooting with the measurements as nodes). The error of each
step is weighted by its present size to the power -2.5, so that the first steps count most: they determine the later
ones.
"""

from __future__ import annotations

import hashlib
import json
import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import TracebackType
from typing import Any, Self, TypeAlias

import numpy as np

from model_zoo.networks.network import Array32
from sysid_evo.data import Dataset
from sysid_evo.errors import CheckpointWarning, InvalidData
from sysid_evo.models import DynamicsModel
from sysid_evo.progress import Checkpoint, CheckpointState
from sysid_evo.types import Array, IntArray

SHARPNESS = 2.5
"""Exponent of the step weights: 1 gives all steps equal weight, higher values favour the accurate first ones."""

SINGLE_STEPS = 0.75
"""Share of single-step updates in fine-tuning."""

FLOOR = 0.002
"""Squared relative error below which the weight of a step does not rise (the noise of the measurement)."""


@dataclass(frozen=True)
class TrainingWindows:
    """Windows of ``horizon`` steps, by the position (N,) of their present among samples of state and control (T, n).

    The samples are those of all episodes in sequence. Batches have time as first axis. ``single`` are the positions of
    windows of one step: those of all episodes if the horizon was shortened, else ``starts``.
    """

    samples: Array32
    starts: IntArray
    horizon: int
    single: IntArray

    @classmethod
    def of(cls, dataset: Dataset, horizon: int, history: int) -> TrainingWindows:
        """Cut windows at every moving sample, of ``horizon`` steps or of the `training_horizon`.

        Raises `InvalidData` if no episode has a step after ``history``.
        """
        windows = dataset.windows(1, history=history, moving=True)
        if not len(windows):
            raise InvalidData(f"networks: no episode has a moving sample after the {history} that are the history")
        lengths = np.array([len(episode) for episode in dataset.episodes])
        usable = training_horizon(dataset, horizon, history)
        fits = windows.start + usable <= lengths[windows.episode]
        found = cls.at(dataset, windows.episode[fits], windows.start[fits], usable)
        if usable == horizon:
            # single steps of short episodes, which end in a fall, make models worse where controllers balance
            return found
        return replace(found, single=cls.at(dataset, windows.episode, windows.start, 1).starts)

    @classmethod
    def at(cls, dataset: Dataset, episode: IntArray, start: IntArray, horizon: int) -> TrainingWindows:
        """Return the windows that begin at these samples of these episodes, (N,) each."""
        parts = []
        for one in dataset.episodes:
            ended = np.concatenate([one.controls, np.zeros((1, one.controls.shape[1]))])
            parts.append(np.concatenate([one.states, ended], axis=1))
        first = np.cumsum([0, *(len(part) for part in parts)])
        starts = first[episode] + start
        return cls(np.concatenate(parts).astype(np.float32), starts, horizon, starts)

    def __len__(self) -> int:
        return len(self.starts)


FITTING = 0.25
"""Least share of the moving samples at which a window of the training horizon begins."""


def training_horizon(dataset: Dataset, horizon: int, history: int) -> int:
    """Return ``horizon``, or the longest one that fits at a quarter of the moving samples if that is shorter."""
    windows = dataset.windows(1, history=history, moving=True)
    lengths = np.array([len(episode) for episode in dataset.episodes])
    room = np.sort(lengths[windows.episode] - windows.start)[::-1]
    return min(horizon, int(room[math.ceil(FITTING * len(room)) - 1])) if len(room) else horizon


class Batches:
    """Batches of the windows of all members, taken from one array of all samples."""

    def __init__(self, windows: Sequence[TrainingWindows], history: int) -> None:
        first = np.cumsum([0, *(len(one.samples) for one in windows)])
        self.samples = np.concatenate([one.samples for one in windows])
        self.starts = [one.starts + begin for one, begin in zip(windows, first, strict=False)]
        self.single = [one.single + begin for one, begin in zip(windows, first, strict=False)]
        self.history = history

    def drawn(self, rng: np.random.Generator, size: int, horizon: int) -> Array32:
        """Return the samples of ``size`` random windows of each member, see `of`."""
        starts = self.single if horizon == 1 else self.starts
        return self._at([own[rng.integers(0, len(own), size)] for own in starts], horizon)

    def of(self, rows: Sequence[IntArray], horizon: int) -> Array32:
        """Return the samples (L + 1 + H, M, B, n) of the windows ``rows`` (B,) of each member."""
        return self._at([start[row] for start, row in zip(self.starts, rows, strict=True)], horizon)

    def _at(self, places: Sequence[IntArray], horizon: int) -> Array32:
        starts = np.stack(places)
        steps = np.arange(-self.history, horizon + 1)
        found: Array32 = np.take(self.samples, starts + steps[:, None, None], axis=0, mode="clip")
        return found


@dataclass(frozen=True)
class TrainingSchedule:
    """Number and size of the updates of a training.

    First ``one_step_updates`` on single steps with batches of 512, then ``updates`` on simulations of ``horizon`` steps
    with ``batch`` windows. ``input_noise`` is added to measured states, in units of their one-step change. A running
    mean of the weights (``averaging``) is scored every ``check_every`` updates, and the best one is kept.
    """

    one_step_updates: int
    updates: int
    horizon: int
    batch: int = 96
    learning_rate: float = 6e-3
    weight_decay: float = 1e-5
    input_noise: float = 0.05
    averaging: float = 0.99
    check_every: int = 100

    @classmethod
    def further(cls, updates: int, horizon: int, input_noise: float) -> TrainingSchedule:
        """Return the schedule for fine-tuning by ``updates`` updates on other data."""
        single = round(SINGLE_STEPS * updates)
        return cls(single, updates - single, horizon, input_noise=input_noise)

    @classmethod
    def of_torch(cls, updates: int, horizon: int, learning_rate: float) -> TrainingSchedule:
        """Return the schedule of the families in PyTorch: two thirds of the updates are on single steps."""
        single = round(2 / 3 * updates)
        return cls(single, updates - single, horizon, learning_rate=learning_rate)

    @property
    def total(self) -> int:
        return self.one_step_updates + self.updates


def step_weights(error: Array32) -> Array32:
    """Return the weights (H,) of the steps of a simulation, with sum 1, for their present square errors (H, M)."""
    weight = (error.mean(axis=1) + FLOOR) ** -SHARPNESS
    return np.asarray(weight / weight.sum())


def schedule(plan: TrainingSchedule, update: int, longest: int) -> tuple[int, int, float]:
    """Return the horizon, the number of windows and the learning rate of one update."""
    if update < plan.one_step_updates:
        share = update / plan.one_step_updates
        return 1, 512, plan.learning_rate * (0.2 + 0.8 * math.cos(0.5 * math.pi * share))
    index = update - plan.one_step_updates
    share = index / plan.updates
    rate = plan.learning_rate * (0.02 + 0.49 * (1.0 + math.cos(math.pi * share))) * min(1.0, (index + 1) / 20)
    return min(plan.horizon, longest), plan.batch, rate


Report: TypeAlias = Callable[[int], None]
"""Called with the number of updates done since the last call."""

MOMENTUM, SPREAD, TINY = 0.9, 0.99, 1e-8
"""Adam's two decay rates and the term against division by zero (Kingma, Ba 2015)."""


@dataclass
class TrainingState:
    """The changing state of one training; arrays are (M, P), one row for each member.

    ``first`` and ``second`` are Adam's moments of the gradient after ``steps`` (1,) steps, ``mean`` is the running mean
    of the ``parameters``, ``best`` the best of these means and ``lowest`` its errors (M,).
    """

    parameters: Array32
    first: Array32
    second: Array32
    mean: Array32
    best: Array32
    lowest: Array
    steps: Array

    @classmethod
    def at(cls, parameters: Array32) -> Self:
        """Return the state before the first update of ``parameters``."""
        zero = np.zeros_like(parameters)
        lowest = np.full(len(parameters), np.inf)
        return cls(parameters, zero, zero.copy(), parameters.copy(), parameters.copy(), lowest, np.zeros(1))

    def descend(self, gradient: Array32, rate: float) -> None:
        """Do one step of Adam with the ``gradient``, its norm limited to the root of M; none if it is not finite."""
        norm = math.sqrt(float(np.vdot(gradient, gradient)))
        if not math.isfinite(norm):
            return
        gradient = gradient * min(1.0, math.sqrt(len(gradient)) / (norm + 1e-6))
        self.steps += 1
        count = int(self.steps[0])
        self.first += (1.0 - MOMENTUM) * (gradient - self.first)
        self.second += (1.0 - SPREAD) * (gradient**2 - self.second)
        deviation = np.sqrt(self.second / (1.0 - SPREAD**count))
        deviation += TINY
        self.parameters -= rate / (1.0 - MOMENTUM**count) * self.first / deviation

    def average(self, keep: float) -> None:
        """Update the running mean of the parameters, with the share ``keep`` of the old mean."""
        self.mean += (1.0 - keep) * (self.parameters - self.mean)

    def keep(self, errors: Array) -> None:
        """Store the means of the members whose ``errors`` (M,) are the lowest so far."""
        better = errors < self.lowest
        self.lowest[better], self.best[better] = errors[better], self.mean[better]

    def copies(self) -> dict[str, Array]:
        """Return copies of all arrays by name, as float64, which holds single precision exactly."""
        return {name: np.array(value, dtype=np.float64) for name, value in vars(self).items()}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Continue from the ``state`` of the same training. Raises `LookupError` or `ValueError` for another one."""
        for name, value in vars(self).items():
            if np.shape(state[name]) != value.shape:
                raise ValueError(f"expected the shape {value.shape}, got {np.shape(state[name])}")
        for name, value in vars(self).items():
            value[...] = state[name]


class ResumableTrainings:
    """The consecutive trainings of one fit, and their random numbers.

    With a ``checkpoint``, a repeated fit with the same data and ``rng`` skips the trainings that had finished and
    continues the one that had not. Use it in a ``with`` statement: on an exception, Ctrl-C included, the state at the
    last report is saved.
    """

    def __init__(
        self,
        rng: np.random.Generator,
        *,
        report: Report | None = None,
        checkpoint: Checkpoint | None = None,
        identity: str = "",
    ) -> None:
        self.rng, self.checkpoint, self.identity = rng, checkpoint, identity
        self._report = report
        self._begun = 0
        self._ended: dict[str, Any] = {"ended": 0}
        self._now: dict[str, Any] = {}
        found = None if checkpoint is None else checkpoint.load(identity)
        self._found: CheckpointState = {"ended": 0} if found is None else found

    @classmethod
    def of(cls, model: DynamicsModel, dataset: Dataset, rng: np.random.Generator, report: Report | None) -> Self:
        """Return the trainings of a fit of ``model``, with its checkpoint if one is set."""
        settings = [type(model).__qualname__, repr(model.get_params(deep=False)), dataset.fingerprint, _text(rng)]
        identity = hashlib.sha256(json.dumps([*settings, np.__version__]).encode()).hexdigest()
        return cls(rng, report=report, checkpoint=model.checkpoint, identity=identity)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is not None and self._now:
            self._save()

    def report(self, updates: int) -> None:
        """Report that this many more updates are done."""
        if self._report is not None:
            self._report(updates)

    def ended(self) -> Array32 | None:
        """Start the next training; return its parameters if it had finished before, otherwise None."""
        number, found = self._begun, self._found
        self._begun += 1
        if number >= int(found["ended"]):
            return None
        own = {name: value for name, value in found.items() if name.startswith(f"{number}/")}
        self._ended |= {**own, "ended": number + 1}
        _set(self.rng, str(own[f"{number}/rng"]))
        return np.asarray(own[f"{number}/parameters"], dtype=np.float32)

    def resume(self, state: TrainingState) -> int:
        """Set ``state`` to that of the interrupted training; return the number of updates done."""
        found = self._found
        if "updates" not in found or self._begun != int(found["ended"]) + 1:
            return 0
        before = state.copies()
        try:
            state.restore({name.removeprefix("now/"): value for name, value in found.items()})
            _set(self.rng, str(found["rng"]))
        except (LookupError, TypeError, ValueError) as error:
            warnings.warn(f"the checkpoint is ignored in this training: {error}", CheckpointWarning, stacklevel=2)
            state.restore(before)
            return 0
        return int(found["updates"])

    def reached(self, updates: int, state: TrainingState) -> None:
        """Store the state after this many updates; save it if it is time."""
        if self.checkpoint is None:
            return
        self._now = {f"now/{name}": value for name, value in state.copies().items()}
        self._now |= {"updates": updates, "rng": _text(self.rng)}
        if self.checkpoint.due():
            self._save()

    def end(self, parameters: Array32) -> None:
        """Store the parameters of the finished training."""
        if self.checkpoint is None:
            return
        number, self._now = self._begun - 1, {}
        own = {f"{number}/parameters": parameters.astype(np.float64), f"{number}/rng": _text(self.rng)}
        self._ended |= {**own, "ended": number + 1}
        self._save()

    def _save(self) -> None:
        if self.checkpoint is not None:
            self.checkpoint.save(self.identity, {**self._ended, **self._now})


def _text(rng: np.random.Generator) -> str:
    return json.dumps(rng.bit_generator.state, default=lambda array: array.tolist())


def _set(rng: np.random.Generator, text: str) -> None:
    rng.bit_generator.state = json.loads(text)
