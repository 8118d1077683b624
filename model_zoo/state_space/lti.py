"""Family lti: a linear system of python-control, sampled at the rate of the recording, with an observer."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, ClassVar, Literal, Self

import numpy as np
from scipy.linalg import solve_discrete_are

from model_zoo.scaling import deviation, positive
from model_zoo.state_space.model import StateSpaceModel
from sysid_evo import Dataset, register_model
from sysid_evo.errors import IncompatibleSystem, InvalidArgument
from sysid_evo.models.parameters import Limit
from sysid_evo.progress import Progress
from sysid_evo.registry.objects import kept_object
from sysid_evo.system import System
from sysid_evo.types import Array
from sysid_evo.validation.simulation_error import error_windows, simulation_error

RATIOS = (1e-4, 1e-2, 1.0, 100.0)
"""Variances of the process noise that are tried, as multiples of the effect of the recorded controls."""
NOISE = 0.05
"""Assumed deviation of the measurement noise, in deviations of each output."""
FORGOTTEN = 0.01
"""Share of an initial error that may remain after the history of the observer."""
LONGEST_HISTORY = 100
DIRECT = 1e8
"""Condition number of the output matrix up to which the states are computed from the outputs of one sample."""


@register_model("lti")
class LtiSystem(StateSpaceModel):
    """A linear time-invariant system of python-control, a state space or a transfer function, as it is.

    x' = A x + B (u - u0), y = C x + y0: its outputs are the states of the recording and its inputs the controls, found
    by their names, ``outputs`` and ``inputs``, or in order if none of these occurs in the recording. ``model`` is the
    system, or the arguments of ``control.ss`` as a list, ``[A, B, C, D]`` and the sampling time of a discrete one. A
    continuous system is sampled with zero-order hold at the rate of the recording. ``operating_point`` is ``zero``,
    ``mean`` (of the recorded states and controls), or given by ``operating_states`` and ``operating_controls``.

    If the outputs of one sample do not determine the states, a Kalman observer estimates them from the samples before.
    Its process noise acts as the controls do, with the variance in `RATIOS` of the lowest simulation error.
    """

    knowledge = "grey"
    model_class = ""
    fast_fit = True
    requires = ("control",)
    limits: ClassVar[dict[str, Limit]] = {}

    model: Any = None
    outputs: list[str] | None = None
    inputs: list[str] | None = None
    operating_point: Literal["zero", "mean"] = "zero"
    operating_states: list[float] | None = None
    operating_controls: list[float] | None = None
    max_steps: int | None = 100_000

    def check_system(self, system: System) -> None:
        _, b, c = sampled(kept_object(self.model), system.dt)
        if (len(c), b.shape[1]) != (system.nx, system.nu):
            raise IncompatibleSystem(
                f"lti: expected {system.nx} outputs, the states {', '.join(system.state_names)}, and {system.nu} "
                f"inputs, the controls {', '.join(system.control_names)}; got {len(c)} and {b.shape[1]}"
            )
        for name, found, names in self._labels(system):
            if found and set(found) & set(names) and sorted(found) != sorted(names):
                raise IncompatibleSystem(
                    f"lti: expected the {name} {', '.join(names)}, as in the recording; got {', '.join(found)}"
                )
        for name, given, n in (
            ("operating_states", self.operating_states, system.nx),
            ("operating_controls", self.operating_controls, system.nu),
        ):
            if given is not None and len(given) != n:
                raise InvalidArgument(f"lti: {name}: expected {n} numbers, got {len(given)}")

    def _labels(self, system: System) -> tuple[tuple[str, list[str] | None, Sequence[str]], ...]:
        return (("outputs", self.outputs, system.state_names), ("inputs", self.inputs, system.control_names))

    def _in_order(self, system: System) -> tuple[Array, Array, Array]:
        """Return A, B and C at the rate of ``system``, with its controls and states in their order."""
        a, b, c = sampled(kept_object(self.model), system.dt)
        rows, columns = (
            [found.index(one) for one in names] if found and set(found) & set(names) else list(range(len(names)))
            for _, found, names in self._labels(system)
        )
        return a, b[:, columns], c[rows]

    def fit(self, dataset: Dataset, *, rng: np.random.Generator, progress: Progress | None = None) -> Self:
        data = dataset.transitions()
        a, b, c = self._in_order(dataset.system)
        mean = self.operating_point == "mean"
        x0, u0 = data.state.mean(axis=0) * mean, data.control.mean(axis=0) * mean
        x0 = x0 if self.operating_states is None else np.array(self.operating_states, dtype=np.float64)
        u0 = u0 if self.operating_controls is None else np.array(self.operating_controls, dtype=np.float64)
        size = positive(np.abs(responses(a, b, dataset, u0)).max(axis=0))  # hidden states are clipped far beyond it
        a, b, c = a * size / size[:, None], b / size[:, None], c * size
        self.outer_ = [np.concatenate([a, b, -(b @ u0)[:, None]], axis=1)]
        self.inner_, self.kinds_ = [np.empty((0, len(a) + b.shape[1] + 1))], [np.empty(0, dtype=np.int64)]
        self.output_, self.offset_ = c, x0
        inverse = np.linalg.pinv(c)
        self.first_ = np.concatenate([inverse, -(inverse @ x0)[:, None]], axis=1)
        self.ratio_, self.n_lags_ = 0.0, 0
        if len(a) == len(c) and np.linalg.cond(c) < DIRECT:
            self._set_gain(a @ inverse, 0)
            return self
        longest = min(LONGEST_HISTORY, min(len(run) for run in dataset.episodes) // 3)
        errors = []
        for ratio in RATIOS:
            gain = kalman_gain(a, b, c, data.control.var(axis=0), ratio, (NOISE * deviation(data.state)) ** 2)
            self._set_gain(gain, history_of(a - gain @ c, longest))
            errors.append((simulation_error(self, error_windows(dataset, self.n_lags)), ratio, gain, self.n_lags))
        _, self.ratio_, gain, history = min(errors, key=lambda one: one[0])
        self._set_gain(gain, history)
        return self

    def _set_gain(self, gain: Array, history: int) -> None:
        self.gain_, self.n_lags_ = gain, history
        self._set_rest()

    @property
    def fit_note(self) -> str:
        n, ny = len(self.rest_), self.system.nx
        note = f"used as it is, with {n} states"
        for name, found, names in self._labels(self.system):
            if found and not set(found) & set(names):
                note += f", its {name} {', '.join(found)} taken as {', '.join(names)}"
        if self.n_lags_:
            note += (
                f", estimated from {ny} outputs by a Kalman observer over {self.n_lags_} samples (process noise "
                f"{self.ratio_:g} times the effect of the recorded controls)"
            )
        return "; ".join(filter(None, (super().fit_note, note)))


def sampled(thing: Any, dt: float) -> tuple[Array, Array, Array]:
    """Return A, B and C of a system of python-control at the sampling time ``dt``. Raises `InvalidArgument`."""
    import control

    if thing is None:
        raise InvalidArgument(
            "lti: expected a system of python-control, such as control.ss(A, B, C, D), or a list [A, B, C, D]"
        )
    try:
        system = control.ss(*thing) if isinstance(thing, list) else control.ss(thing)
    except (control.ControlMIMONotImplemented, ImportError, TypeError, ValueError) as error:
        raise InvalidArgument(f"lti: control.ss makes no state space of it: {error}") from error
    if system.isctime():
        system = control.sample_system(system, dt, method="zoh")
    elif system.dt is not True and not math.isclose(system.dt, dt, rel_tol=1e-6):
        raise InvalidArgument(f"lti: expected a continuous system or dt={dt:g} s, as recorded; got dt={system.dt:g} s")
    if np.any(system.D):
        raise InvalidArgument(
            "lti: expected D = 0: a recorded state cannot depend on the control that follows it; got "
            f"D = {np.asarray(system.D).tolist()}"
        )
    a, b, c = (np.array(part, dtype=np.float64) for part in (system.A, system.B, system.C))
    return a, b, c


def responses(a: Array, b: Array, dataset: Dataset, u0: Array) -> Array:
    """Return the states (N, n) of the system from zero under the recorded controls, one episode after the other."""
    found = [np.zeros(len(a))]
    for run in dataset.episodes:
        x = np.zeros(len(a))
        for u in run.controls:
            x = a @ x + b @ (u - u0)
            found.append(x)
    return np.array(found)


def kalman_gain(a: Array, b: Array, c: Array, controls: Array, ratio: float, noise: Array) -> Array:
    """Return the stationary gain (n, ny) of the predictor x' = A x + K (y - C x).

    The process noise is ``ratio`` times the effect of ``controls`` (nu,), variances; ``noise`` (ny,) is the variance of
    the measurements. Raises `InvalidArgument` if an unstable state does not act on any output.
    """
    process = ratio * (b * controls) @ b.T
    process += 1e-9 * max(float(np.trace(process)), 1e-12) * np.eye(len(a))
    try:
        p = solve_discrete_are(a.T, c.T, process, np.diag(noise))
    except (np.linalg.LinAlgError, ValueError) as error:
        raise InvalidArgument(f"lti: there is no observer for this system: {error}; is it observable?") from error
    return np.asarray(np.linalg.solve(c @ p @ c.T + np.diag(noise), c @ p @ a.T).T, dtype=np.float64)


def history_of(error: Array, longest: int) -> int:
    """Return how many samples the error x' = ``error`` x takes to decay to `FORGOTTEN`, at most ``longest``."""
    radius = float(np.abs(np.linalg.eigvals(error)).max(initial=0.0))
    return longest if radius >= 1.0 else min(longest, math.ceil(math.log(FORGOTTEN) / math.log(max(radius, 1e-3))))
