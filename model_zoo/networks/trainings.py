"""Trainings of networks that can be stopped, or killed, and gone on with, to the same parameters in every bit."""

from __future__ import annotations

import hashlib
import json
import math
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Self, TypeAlias

import numpy as np

from model_zoo.networks.layers import Single
from sysid_evo.arrays import Array
from sysid_evo.checkpoint import Checkpoint, State
from sysid_evo.data import Dataset
from sysid_evo.dynamics import DynamicsModel
from sysid_evo.errors import CheckpointWarning

Report: TypeAlias = Callable[[int], None]
"""Told how many more updates are done."""

MOMENTUM, SPREAD, TINY = 0.9, 0.99, 1e-8
"""Adam's two decay rates and what keeps it from dividing by zero (Kingma, Ba 2015)."""


@dataclass
class Standing:
    """All that changes while one training goes on, in place; arrays are (M, P), one row for each member.

    ``first`` and ``second`` are Adam's moments of the gradient after so many ``steps`` (1,), ``mean`` is the running
    mean of the ``parameters``, ``best`` the best of these means and ``lowest`` its errors (M,).
    """

    parameters: Single
    first: Single
    second: Single
    mean: Single
    best: Single
    lowest: Array
    steps: Array

    @classmethod
    def at(cls, parameters: Single) -> Self:
        """Return how things stand before the first update of ``parameters``."""
        zero = np.zeros_like(parameters)
        lowest = np.full(len(parameters), np.inf)
        return cls(parameters, zero, zero.copy(), parameters.copy(), parameters.copy(), lowest, np.zeros(1))

    def descend(self, gradient: Single, rate: float) -> None:
        """Do one step of Adam, down a ``gradient`` that is shortened to the root of M; none if it is not finite."""
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
        """Take the parameters into the running mean, of which the share ``keep`` stays."""
        self.mean += (1.0 - keep) * (self.parameters - self.mean)

    def keep(self, errors: Array) -> None:
        """Keep the means of those members whose ``errors`` (M,) are the lowest so far."""
        better = errors < self.lowest
        self.lowest[better], self.best[better] = errors[better], self.mean[better]

    def state(self) -> dict[str, Array]:
        """Return copies of all of it by name, as float64 arrays, which hold single precision exactly."""
        return {name: np.array(value, dtype=np.float64) for name, value in vars(self).items()}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from a ``state`` of the same training. Raises `LookupError` or `ValueError` for that of another."""
        for name, value in vars(self).items():
            if np.shape(state[name]) != value.shape:
                raise ValueError(f"expected the shape {value.shape}, got {np.shape(state[name])}")
        for name, value in vars(self).items():
            value[...] = state[name]


class Trainings:
    """The trainings of one fit, one after the other, and the source of their random numbers.

    With a ``checkpoint`` a fit that is made again, with the same data and the same ``rng``, does not repeat the
    trainings that had ended, and goes on within the one that had not. Use it in a ``with`` statement: what leaves it
    by an exception, Ctrl-C too, is kept as it stood after the last updates that were told.
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
        self._state: dict[str, Any] = {"ended": 0}
        self._saved = True
        found = None if checkpoint is None else checkpoint.load(identity)
        self._found: State = {"ended": 0} if found is None else found

    @classmethod
    def of(cls, model: DynamicsModel, dataset: Dataset, rng: np.random.Generator, report: Report | None) -> Self:
        """Return the trainings of a fit of ``model``, kept in its checkpoint if somebody set one."""
        asked = [type(model).__qualname__, repr(model.get_params(deep=False)), dataset.fingerprint, _text(rng)]
        identity = hashlib.sha256(json.dumps([*asked, np.__version__]).encode()).hexdigest()
        return cls(rng, report=report, checkpoint=model.checkpoint, identity=identity)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is not None:
            self._save()

    def report(self, updates: int) -> None:
        """Tell that so many more updates are done."""
        if self._report is not None:
            self._report(updates)

    def ended(self) -> Single | None:
        """Begin the next training; return its parameters if it had ended before, None if it has to be done."""
        number, found = self._begun, self._found
        self._begun += 1
        if number >= int(found["ended"]):
            return None
        own = {name: value for name, value in found.items() if name.startswith(f"{number}/")}
        self._state |= {**own, "ended": number + 1}
        _set(self.rng, str(own[f"{number}/rng"]))
        return np.asarray(own[f"{number}/parameters"], dtype=np.float32)

    def resume(self, standing: Standing) -> int:
        """Bring ``standing`` to where the training was stopped; return the updates that it has behind it."""
        found = self._found
        if "updates" not in found or self._begun != int(found["ended"]) + 1:
            return 0
        before = standing.state()
        try:
            standing.restore({name.removeprefix("now/"): value for name, value in found.items()})
            _set(self.rng, str(found["rng"]))
        except (LookupError, TypeError, ValueError) as error:
            warnings.warn(f"the checkpoint is ignored in this training: {error}", CheckpointWarning, stacklevel=2)
            standing.restore(before)
            return 0
        return int(found["updates"])

    def reached(self, updates: int, standing: Standing) -> None:
        """Keep how things stand after so many updates, if it is time to save."""
        if self.checkpoint is None:
            return
        now: dict[str, Any] = {f"now/{name}": value for name, value in standing.state().items()}
        ended = {name: value for name, value in self._state.items() if _of_ended(name)}
        self._state = {**ended, **now, "updates": updates, "rng": _text(self.rng)}
        self._saved = False
        if self.checkpoint.due():
            self._save()

    def end(self, parameters: Single) -> None:
        """Keep the parameters of the training, which is over."""
        if self.checkpoint is None:
            return
        number = self._begun - 1
        ended = {name: value for name, value in self._state.items() if _of_ended(name)}
        own = {f"{number}/parameters": parameters.astype(np.float64), f"{number}/rng": _text(self.rng)}
        self._state = {**ended, **own, "ended": number + 1}
        self._save(always=True)

    def _save(self, *, always: bool = False) -> None:
        if self.checkpoint is not None and (always or not self._saved):
            self.checkpoint.save(self.identity, self._state)
            self._saved = True


def _of_ended(name: str) -> bool:
    return name == "ended" or name.partition("/")[0].isdigit()


def _text(rng: np.random.Generator) -> str:
    """Return the state of a generator."""
    return json.dumps(rng.bit_generator.state, default=lambda array: array.tolist())


def _set(rng: np.random.Generator, text: str) -> None:
    rng.bit_generator.state = json.loads(text)
