"""Trainings with torch that can be stopped, or killed, and gone on with, to the same parameters in every bit."""

from __future__ import annotations

import hashlib
import json
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Self, TypeAlias

import numpy as np
import torch
from torch import Tensor

from sysid_evo.arrays import Array
from sysid_evo.checkpoint import Checkpoint, State
from sysid_evo.data import Dataset
from sysid_evo.dynamics import DynamicsModel
from sysid_evo.errors import CheckpointWarning

Report: TypeAlias = Callable[[int], None]
"""Told how many more updates are done."""

MOMENTS = "exp_avg", "exp_avg_sq", "step"
"""What Adam remembers of each parameter."""


@dataclass
class Standing:
    """All that changes while one training goes on; tensors are changed in place.

    ``mean`` and ``best`` are the running mean of the ``parameters`` and the best of these means, ``lowest`` its
    errors (M,).
    """

    parameters: list[Tensor]
    optimiser: torch.optim.Adam
    mean: list[Tensor]
    best: list[Tensor]
    lowest: Array
    generators: tuple[torch.Generator, ...]

    def state(self) -> dict[str, Array]:
        """Return copies of all of it by name, as float64 arrays, which hold single precision exactly."""
        found = {f"lists/{name}/{i}": _array(tensor) for name, i, tensor in self._tensors()}
        for i, parameter in enumerate(self.parameters):
            remembered = self.optimiser.state[parameter]
            found |= {f"adam/{name}/{i}": _array(remembered[name]) for name in MOMENTS if remembered}
        for i, generator in enumerate(self.generators):
            found[f"generator/{i}"] = generator.get_state().numpy().astype(np.float64)
        return {**found, "lowest": self.lowest.copy()}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from a ``state`` of the same training. Raises `LookupError` or `ValueError` for that of another."""
        self.optimiser.state.clear()
        with torch.no_grad():
            for name, i, tensor in self._tensors():
                tensor.copy_(_like(tensor, state[f"lists/{name}/{i}"]))
            for i, parameter in enumerate(self.parameters):
                if f"adam/step/{i}" in state:
                    kinds = (parameter, parameter, torch.zeros(()))
                    self.optimiser.state[parameter] = {
                        name: _like(kind, state[f"adam/{name}/{i}"]).clone()
                        for name, kind in zip(MOMENTS, kinds, strict=True)
                    }
        for i, generator in enumerate(self.generators):
            generator.set_state(torch.from_numpy(state[f"generator/{i}"].astype(np.uint8)))
        self.lowest[:] = state["lowest"]

    def _tensors(self) -> list[tuple[str, int, Tensor]]:
        lists = {"parameters": self.parameters, "mean": self.mean, "best": self.best}
        return [(name, i, tensor) for name, tensors in lists.items() for i, tensor in enumerate(tensors)]


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
        identity = hashlib.sha256(json.dumps([*asked, torch.__version__]).encode()).hexdigest()
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

    def ended(self) -> list[Tensor] | None:
        """Begin the next training; return its parameters if it had ended before, None if it has to be done."""
        number, found = self._begun, self._found
        self._begun += 1
        if number >= int(found["ended"]):
            return None
        own = {name: value for name, value in found.items() if name.startswith(f"{number}/")}
        self._state |= {**own, "ended": number + 1}
        _set(self.rng, str(own[f"{number}/rng"]))
        values = [own[f"{number}/{i}"] for i in range(len(own) - 1)]
        return [torch.from_numpy(np.asarray(value, dtype=np.float32)) for value in values]

    def resume(self, standing: Standing) -> int:
        """Bring ``standing`` to where the training was stopped; return the updates that it has behind it."""
        found = self._found
        if "updates" not in found or self._begun != int(found["ended"]) + 1:
            return 0
        before = standing.state()
        try:
            standing.restore({name.removeprefix("now/"): value for name, value in found.items()})
            _set(self.rng, str(found["rng"]))
        except (LookupError, TypeError, ValueError, RuntimeError) as error:  # the last is torch's own
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

    def end(self, parameters: Sequence[Tensor]) -> None:
        """Keep the parameters of the training, which is over."""
        if self.checkpoint is None:
            return
        number = self._begun - 1
        ended = {name: value for name, value in self._state.items() if _of_ended(name)}
        own = {f"{number}/{i}": _array(parameter) for i, parameter in enumerate(parameters)}
        self._state = {**ended, **own, f"{number}/rng": _text(self.rng), "ended": number + 1}
        self._save(always=True)

    def _save(self, *, always: bool = False) -> None:
        if self.checkpoint is not None and (always or not self._saved):
            self.checkpoint.save(self.identity, self._state)
            self._saved = True


def _of_ended(name: str) -> bool:
    return name == "ended" or name.partition("/")[0].isdigit()


def _array(tensor: Tensor) -> Array:
    return tensor.detach().numpy().astype(np.float64)


def _like(tensor: Tensor, array: Array) -> Tensor:
    """Return ``array`` as a tensor of single precision, if it has the shape of ``tensor``. Raises `ValueError`."""
    if np.shape(array) != tuple(tensor.shape):
        raise ValueError(f"expected the shape {tuple(tensor.shape)}, got {np.shape(array)}")
    return torch.from_numpy(np.array(array, dtype=np.float32))


def _text(rng: np.random.Generator) -> str:
    """Return the state of a generator."""
    return json.dumps(rng.bit_generator.state, default=lambda array: array.tolist())


def _set(rng: np.random.Generator, text: str) -> None:
    rng.bit_generator.state = json.loads(text)
