"""Fitted models as linear models at one operating point: poles, step and frequency responses."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from evaluation.steps import Steps
from sysid_evo.data import Dataset
from sysid_evo.errors import InvalidData
from sysid_evo.models import DynamicsModel
from sysid_evo.models.dynamics import started
from sysid_evo.types import Array

SMALL, LARGE, WHOLE = 0.02, 0.1, 1.0
"""Steps of the difference quotients, in standard deviations of the data."""
ROUGH = 0.25
"""A model is not smooth if the two quotients differ by more than this share of the largest."""
MOST = 300
"""Largest carry that is linearised; the cost grows with its square."""
SAMPLES = 64
"""Steps of the data from which the scale of the memory of a model is taken."""
FASTEST = 0.05
"""Poles with a smaller magnitude are over within a third of a sample: delays and memory."""


@dataclass(frozen=True)
class OperatingPoint:
    """Mean ``state`` (nx,) and ``control`` (nu,) of the data in motion, and some of its ``steps`` for the scale."""

    state: Array
    control: Array
    steps: Steps

    @classmethod
    def of(cls, dataset: Dataset) -> OperatingPoint:
        """Return the mean of the samples in motion, or of all samples if there are none in motion."""
        steps, moving = Steps.of(dataset.system, dataset), np.concatenate([one[:-1] for one in dataset.moving])
        steps = steps[moving] if moving.any() else steps
        state = dataset.system.neutral_state + steps.off_neutral.mean(axis=0)
        return cls(state, steps.control.mean(axis=0), steps)

    @property
    def spread(self) -> Array:
        """Standard deviation of states and controls, (nx + nu,); 1 for a constant channel."""
        return _scale(np.concatenate([self.steps.off_neutral, self.steps.control], axis=1))


@dataclass(frozen=True)
class LinearResponse:
    """x' = A x + B u around an operating point: ``a`` (n, n), ``b`` (n, nu), for the carry of n numbers, states first.

    ``nx`` is the number of states, which are the outputs; ``dt`` the sampling time in s.
    """

    a: Array
    b: Array
    nx: int
    dt: float

    @cached_property
    def poles(self) -> tuple[complex, ...]:
        """The poles z that last longer than a third of a sample, the slowest first, one of each conjugate pair."""
        found = [complex(z) for z in np.linalg.eigvals(self.a) if z.imag >= 0.0 and abs(z) >= FASTEST]
        return tuple(sorted(found, key=lambda z: -abs(z)))

    def continuous(self, z: complex) -> complex:
        """Return the pole s = ln(z) / dt in rad/s of the continuous system that has the discrete pole ``z``."""
        return complex(np.log(complex(z)) / self.dt)

    def to_step(self, count: int) -> Array:
        """Return the states (count + 1, nx, nu) after a unit step of each control at the first sample."""
        found = np.zeros((count + 1, *self.b.shape))
        with np.errstate(all="ignore"):
            for k in range(count):
                found[k + 1] = self.a @ found[k] + self.b
        return found[:, : self.nx]

    def to_frequency(self, frequencies: Array) -> Array:
        """Return the complex gain (W, nx, nu) from each control to each state at W frequencies in rad/s."""
        z = np.exp(1j * frequencies * self.dt)
        shifted = z[:, None, None] * np.eye(len(self.a)) - self.a
        return np.asarray(np.linalg.solve(shifted, self.b[None])[:, : self.nx])


def linearised(model: DynamicsModel, point: OperatingPoint) -> LinearResponse:
    """Return ``model`` linearised at ``point``, its whole carry, by central differences.

    Memory is that of a model that has long been at this point, without noise. Raises `InvalidData` where the model is
    not smooth: quotients over 0.02 and 0.1 standard deviations of the data differ, or a control acts only beyond these.
    """
    carry = started(model, point.state[None], controls=point.control[None])
    n, nx = carry.shape[1], model.system.nx
    if n > MOST:
        raise InvalidData(f"its memory has {n} numbers, more than {MOST}")
    some = point.steps.thinned(SAMPLES)
    with np.errstate(all="ignore"):
        begun = started(model, some.before, controls=some.control)
        size = _scale(np.concatenate([begun, model.step(begun, some.control)]))
        size = np.concatenate([point.spread[:nx], size[nx:], point.spread[nx:]])
        small, large, whole = (_slopes(model, carry, point.control, step * size) for step in (SMALL, LARGE, WHOLE))
        relative = (large - small) * size / size[:n, None]
        largest = np.abs(small * size / size[:n, None]).max(initial=0.0)
    if not np.isfinite(small).all() or not np.isfinite(largest):
        raise InvalidData("its next state is not a number")
    if not np.abs(relative).max(initial=0.0) <= ROUGH * largest:
        raise InvalidData("it is not smooth at this point")
    idle = ~small[:, n:].any(axis=0) & whole[:, n:].any(axis=0)
    if idle.any():
        name = model.system.control_names[int(idle.argmax())]
        raise InvalidData(f"small changes of {name} have no effect in it")
    return LinearResponse(small[:, :n], small[:, n:], nx, model.system.dt)


def _slopes(model: DynamicsModel, carry: Array, control: Array, steps: Array) -> Array:
    """Return the derivatives (n, n + nu) of the next carry by the carry (1, n) and the control (nu,)."""
    n, nx = carry.shape[1], model.system.nx
    moves = np.concatenate([np.diag(steps), -np.diag(steps)])
    after = model.step(carry + moves[:, :n], control + moves[:, n:])
    change = after[: len(steps)] - after[len(steps) :]
    change[:, :nx] = model.system.difference(after[: len(steps), :nx], after[len(steps) :, :nx])
    return np.asarray((change / (2.0 * steps[:, None])).T)


def least_squares(point: OperatingPoint) -> LinearResponse | None:
    """Return the least-squares fit of the next state to state and control; None for too few steps."""
    steps, system = point.steps, point.steps.system
    regressors = np.concatenate([steps.off_neutral, steps.control, np.ones((len(steps), 1))], axis=1)
    if len(steps) < 3 * regressors.shape[1]:
        return None
    changes = system.difference(steps.after, steps.before)
    slopes = np.linalg.lstsq(regressors, changes, rcond=None)[0].T
    a, b = np.eye(system.nx) + slopes[:, : system.nx], slopes[:, system.nx : -1]
    return LinearResponse(a, b, system.nx, system.dt)


def _scale(values: Array) -> Array:
    """Return the standard deviation of each column, 1 for one that does not vary."""
    found = values.std(axis=0)
    return np.where((found > 0.0) & np.isfinite(found), found, 1.0)
