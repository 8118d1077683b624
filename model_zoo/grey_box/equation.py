"""The integrated equation, in NumPy and compiled: law, actuator lag, delay, hidden states and their estimate.

Components are the first axis of arrays, so that many parameter vectors run in many windows at once: a state is (n, B)
and parameters are (n_parameters, 1), or (n, P, B) and (n_parameters, P, 1).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cache, cached_property
from typing import Any, ClassVar

import numpy as np

from model_zoo.grey_box.parameters import HiddenState, Parameter, ParameterBounds
from sysid_evo.carry import CarryLayout
from sysid_evo.engine.compiled.compiler import compiled
from sysid_evo.errors import InvalidArgument
from sysid_evo.kernels import DynamicsKernel, Signature
from sysid_evo.laws import array_form
from sysid_evo.models.dynamics import rk4
from sysid_evo.models.kernels import Predictor, added, runge_kutta_predictor, stepping_kernel, turning_frame
from sysid_evo.processors import resolve
from sysid_evo.system import Channel, System
from sysid_evo.types import Array, check_shape

SHORTEST_LAG = 0.5
"""Shortest actuator lag, in integration steps."""
LONGEST_LAG = 1.0  # s


@dataclass(frozen=True)
class GreyBoxEquation:
    """The law ``rate(state, control, p)`` on a system, with actuator lag, delay and hidden states.

    The law's states are the system's states at the positions ``states``, then the ``hidden`` ones; its controls are
    those at ``controls``. ``known`` are pairs of positions: a state and the state that is its rate; the law gives the
    other rates. With ``lagged`` every control has a first-order lag of its own; ``delay`` is the largest delay of the
    controls in samples.
    """

    system: System
    law: Callable[..., Any]
    states: tuple[int, ...]
    controls: tuple[int, ...]
    own: tuple[Parameter, ...]
    hidden: tuple[HiddenState, ...] = ()
    lagged: bool = False
    delay: int = 0
    substeps: int = 1
    known: tuple[tuple[int, int], ...] = ()
    array_law: Callable[..., Any] | None = None
    """The law for arrays that are broadcast; None for `array_form` of the law."""
    own_frame: bool = False
    """Whether the law includes the rotation of the frame, which is otherwise added."""
    discrete: bool = False
    """Whether the law gives next states instead of rates."""

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """The law's parameters, then the lag of each actuator, then the delay."""
        found, dt = list(self.own), self.system.dt
        if self.lagged:
            for name in (self.system.control_names[i] for i in self.controls):
                shortest = SHORTEST_LAG * dt / self.substeps
                longest = max(LONGEST_LAG, 4.0 * dt)
                found.append(Parameter(f"lag of {name}", min(2.0 * dt, longest), shortest, longest, "s"))
        if self.delay:
            found.append(Parameter("delay of commands", min(1.0, self.delay), 0.0, float(self.delay), "samples"))
        return tuple(found)

    @cached_property
    def box(self) -> ParameterBounds:
        """The bounds of all parameters."""
        return ParameterBounds(self.parameters)

    @cached_property
    def extended(self) -> System:
        """The system with hidden states and actuator states after the measured ones."""
        actuators = [self.system.controls[i] for i in self.controls] if self.lagged else []
        more = [hidden.channel for hidden in self.hidden]
        more += [
            Channel(f"{control.name} that acts", control.unit, control.low, control.high, neutral=control.neutral)
            for control in actuators
        ]
        return replace(self.system, states=(*self.system.states, *more))

    @property
    def layout(self) -> CarryLayout:
        """The carry: extended state, then the earlier controls needed for the delay."""
        return CarryLayout(self.extended.nx, self.system.nu, 0, self.delay)

    @property
    def hidden_rows(self) -> slice:
        """Positions of the hidden states in the carry."""
        return slice(self.system.nx, self.system.nx + len(self.hidden))

    @property
    def actuator_rows(self) -> slice:
        """Positions of the actuator states in the carry."""
        return slice(self.system.nx + len(self.hidden), self.extended.nx)

    @cached_property
    def law_rows(self) -> tuple[int, ...]:
        """Positions of the law's states in the carry."""
        return (*self.states, *range(self.system.nx, self.system.nx + len(self.hidden)))

    @cached_property
    def rate_rows(self) -> tuple[int, ...]:
        """Positions in the carry of the states whose rates the law gives."""
        positions = [position for position, _ in self.known]
        return tuple(row for row in self.law_rows if row not in positions)

    def shorter(self, delay: float) -> GreyBoxEquation:
        """Return the structure with only the earlier controls needed for this delay."""
        return replace(self, delay=max(1, math.ceil(delay - 1e-9))) if self.delay else self

    @property
    def on_arrays(self) -> Callable[..., Any]:
        """The law for tuples of arrays that are broadcast."""
        return self.array_law or array_form(self.law)

    def check(self) -> None:
        """Raise `InvalidArgument` unless the law gives one finite rate for each state without a known rate."""
        extended = self.extended.neutral_state[list(self.law_rows)]
        neutral = self.system.neutral_control[list(self.controls)]
        guess = np.array([parameter.guess for parameter in self.own])
        name = getattr(self.law, "__qualname__", "rate")
        try:
            with np.errstate(all="ignore"):
                found = self.on_arrays(tuple(extended[:, None]), tuple(neutral[:, None]), tuple(guess))
            values = [np.broadcast_to(np.asarray(value, dtype=float), (1,)) for value in found]
        except (TypeError, ValueError) as error:
            raise InvalidArgument(
                f"{name}(state, control, p): expected a tuple of rates from {len(extended)} states, {len(neutral)} "
                f"controls and {len(guess)} parameters; got {error}"
            ) from error
        if len(values) != len(self.rate_rows):
            names = [self.extended.state_names[i] for i in self.rate_rows]
            raise InvalidArgument(
                f"{name}(state, control, p): expected {len(names)} rates, of {', '.join(names)}; got {len(values)}. "
                "If a state is the rate of another one, name both in rate_of"
            )
        if not np.isfinite(values).all():
            raise InvalidArgument(f"{name}(state, control, p): expected finite rates at rest, got {values}")

    def acting(self, p: Array, controls: list[Array]) -> Array:
        """Return the delayed controls (n, ...) of the law from present and earlier ones (nu, ...), newest first."""
        places = list(self.controls)
        if not self.delay:
            return controls[0][places]
        shares = delay_shares(p[-1], self.delay)
        return np.asarray(sum(share * control[places] for share, control in zip(shares, controls, strict=True)))

    def rates(self, x: Array, commanded: Array, p: Array) -> Array:
        """Return d/dt of the extended state ``x`` (n, ...) under delayed commands (n_controls, ...).

        In place of the rates of a ``discrete`` law there are its next states.
        """
        found = np.zeros_like(x)
        control = x[self.actuator_rows] if self.lagged else commanded
        rates = self.on_arrays(tuple(x[i] for i in self.law_rows), tuple(control), tuple(p[: len(self.own)]))
        for row, rate in zip(self.rate_rows, rates, strict=True):
            found[row] = rate
        for position, speed in self.known:
            found[position] = x[speed]
        if self.lagged:
            lags = p[len(self.own) : len(self.own) + len(self.controls)]
            found[self.actuator_rows] = (commanded - control) / lags
        if self.system.motion is not None and not self.own_frame:
            found += np.moveaxis(self.extended.frame_rotation(np.moveaxis(x, 0, -1)), -1, 0)
        return found

    def step(
        self, p: Array, carry: Array, control: Array, extra: Callable[[Array], Array] | None = None
    ) -> tuple[Array, Array]:
        """Return the next extended state (n, ...) and the earlier controls from a carry (n_carry, ...).

        ``extra`` (nx, ...) of an extended state is added to the rates of the measured states.
        """
        nx, nu = self.extended.nx, self.system.nu
        past = carry[nx:]
        earlier = [past[lag * nu : (lag + 1) * nu] for lag in range(self.delay)]
        commanded = self.acting(p, [control, *earlier])

        def rate(x: Array) -> Array:
            found = self.rates(x, commanded, p)
            if extra is not None:
                found[: self.system.nx] += extra(x)
            return found

        after = rate(carry[:nx]) if self.discrete else carry[:nx]
        for _ in range(0 if self.discrete else self.substeps):
            after = rk4(rate, after, self.system.dt / self.substeps)
        if self.extended.limited:
            low, high = (side.reshape(-1, *[1] * (after.ndim - 1)) for side in self.extended.limits)
            after = np.clip(after, low, high)
        if not self.delay:
            return after, past
        return after, np.concatenate([np.broadcast_to(control, (nu, *past.shape[1:])), past[:-nu]])

    def start(self, p: Array, states: Array, controls: Array, hidden: Array) -> Array:
        """Return the carry (n_carry, ..., B) after a history (B, L + 1, nx), (B, L, nu) with ``hidden`` (n, ..., B).

        The actuators follow the commands of the history; the oldest one counts as held before.
        """
        rank = p.ndim
        newest_first = np.moveaxis(controls, 2, 0)[:, :, ::-1]  # (nu, B, L)
        length = newest_first.shape[2]
        neutral = np.tile(self.system.neutral_control[:, None], (1, len(states)))

        def command(back: int) -> Array:
            return _ranked(newest_first[:, :, min(back, length) - 1] if length else neutral, rank)

        parts = [_ranked(states[:, -1].T, rank), hidden]
        if self.lagged:
            share = -np.expm1(-self.system.dt / p[len(self.own) : len(self.own) + len(self.controls)])
            actual = command(length)[list(self.controls)]
            for back in range(length, 0, -1):
                commanded = self.acting(p, [command(back + lag) for lag in range(self.delay + 1)])
                actual = actual + share * (commanded - actual)
            parts.append(actual)
        parts += [command(1 + lag) for lag in range(self.delay)]
        batch = np.broadcast_shapes(p.shape[1:], *(part.shape[1:] for part in parts))
        return np.concatenate([np.broadcast_to(part, (len(part), *batch)) for part in parts])


def _ranked(values: Array, rank: int) -> Array:
    """Return (n, B) with ``rank`` axes, those of parameters in between."""
    return values.reshape(len(values), *[1] * (rank - 2), -1)


def delay_shares(delay: Array, longest: int) -> list[Array]:
    """Return the weights of the controls of 0, 1, ... ``longest`` samples ago for a ``delay`` in samples.

    A fraction of a sample is a weighted mean of two neighbours.
    """
    return [np.maximum(1.0 - np.abs(delay - lag), 0.0) for lag in range(longest + 1)]


ROUNDS = 3
"""Gauss-Newton iterations for hidden states."""

STEP = 1e-4
"""Step of a difference quotient, in spreads of a hidden state."""


def estimate_hidden(
    structure: GreyBoxEquation, p: Array, states: Array, controls: Array, *, mean: Array, spread: Array, noise: Array
) -> Array:
    """Return the most likely hidden states (n, B) at the end of a history (B, L + 1, nx), (B, L, nu).

    Their prior at its beginning is normal with ``mean`` and ``spread`` (n,); a simulation from there differs from the
    measurements by ``noise`` (nx,). Rows are independent.
    """
    n, batch, length = len(mean), len(states), controls.shape[1]
    low, high = structure.extended.limits[:, structure.hidden_rows, None]
    guess = np.zeros((n, batch))
    p3 = p[:, None, None]
    for _ in range(ROUNDS if length else 0):
        moved = np.tile(guess[:, None], (1, 1 + n, 1))
        moved[np.arange(n), 1 + np.arange(n)] += STEP
        hidden = mean[:, None, None] + spread[:, None, None] * moved
        carry = structure.start(p3, states[:, :1], controls[:, :1], hidden)
        off = np.empty((length, 1 + n, batch, structure.system.nx))
        for k in range(length):
            carry = np.concatenate(structure.step(p3, carry, controls[:, k].T[:, None]))
            reached = np.moveaxis(carry[: structure.system.nx], 0, -1)
            off[k] = structure.system.difference(reached, np.broadcast_to(states[:, k + 1], reached.shape)) / noise
        error = np.moveaxis(off[:, 0], 1, 0).reshape(batch, -1)
        by = np.moveaxis((off[:, 1:] - off[:, :1]) / STEP, (1, 2), (-1, 0)).reshape(batch, -1, n)
        error, by = np.nan_to_num(error), np.nan_to_num(by)
        normal = np.swapaxes(by, 1, 2) @ by + np.eye(n)
        gradient = np.einsum("bmi,bm->bi", by, error) + guess.T
        guess = np.clip(guess - np.linalg.solve(normal, gradient[..., None])[..., 0].T, -4.0, 4.0)
    began = np.clip(mean[:, None] + spread[:, None] * guess, low, high)
    return propagate_hidden(structure, p[:, None], states, controls, began)


def propagate_hidden(structure: GreyBoxEquation, p: Array, states: Array, controls: Array, hidden: Array) -> Array:
    """Return the hidden states (n, ..., B) after a history (B, L + 1, nx), (B, L, nu) from those at its beginning.

    All other states are the measured ones at every sample; the first command counts as held before.
    """
    rows, rank = structure.hidden_rows, p.ndim
    for k in range(controls.shape[1]):
        carry = structure.start(p, states[:, : k + 1], controls[:, : max(k, 1)], hidden)
        control = controls[:, k].T.reshape(structure.system.nu, *[1] * (rank - 2), -1)
        hidden = structure.step(p, carry, control)[0][rows]
    return hidden


def structure_kernel(structure: GreyBoxEquation, p: Array, *, extra: Predictor | None = None) -> DynamicsKernel | None:
    """Return the kernel of a structure with parameters (n,); None if the motion or an array law has no compiled form.

    ``extra`` is added to the rates of measured states.
    """
    system, rows = structure.extended, structure.actuator_rows
    law = LawOverLanes(
        structure.law,
        structure.law_rows,
        structure.rate_rows,
        structure.known,
        structure.controls,
        tuple(range(rows.start, rows.stop)),
        len(structure.own),
        system.nx,
        system.nu,
        structure.delay,
    )
    p = check_shape("parameters", p, (len(structure.parameters),))
    if structure.array_law is not None and resolve() != "reference" and not_compilable(law):
        return None
    own = Predictor(law, kernel_parameters(structure, p[None])[0], 0)
    own = own if extra is None else added(own, extra, structure.system.nx)
    after = own if structure.own_frame else turning_frame(own, system)
    if after is None:
        return None
    if not structure.discrete:
        after = runge_kutta_predictor(after, system, substeps=structure.substeps, n_carry=structure.layout.size)
    return stepping_kernel(after, system, output="next_state", lags=(0, structure.delay))


@cache
def not_compilable(law: LawOverLanes) -> str:
    """Return why a function written for NumPy has no compiled form; empty if it has one."""
    try:
        compiled(law, Signature.of(_predict), "float64")
    except Exception as error:  # Numba raises many kinds
        return next(iter(str(error).strip().splitlines()), type(error).__name__)
    return ""


def _predict(x: Array, u: Array, p: Array, y: Array, scratch: Array) -> None:
    """Have the arguments of a predictor."""


def kernel_parameters(structure: GreyBoxEquation, p: Array) -> Array:
    """Return the parameters (P, m) of `LawOverLanes` from (P, n): 1 / lag, and weights of the delay."""
    n, lags = len(structure.own), len(structure.controls) if structure.lagged else 0
    parts = [p[:, :n], 1.0 / p[:, n : n + lags]]
    if structure.delay:
        parts.append(np.stack(delay_shares(p[:, -1], structure.delay), axis=1))
    own = np.concatenate(parts, axis=1)
    return own if own.shape[1] else np.zeros((len(p), 1))


@dataclass(frozen=True)
class LawOverLanes:
    """A predictor of d/dt of the extended state of a `GreyBoxEquation`, its law applied lane by lane.

    Its parameters are those of the law, 1 / lag of every actuator, and the weight of each sample of the delay.
    """

    function: Callable[..., Any]
    law_rows: tuple[int, ...]
    rate_rows: tuple[int, ...]
    known: tuple[tuple[int, int], ...]
    controls: tuple[int, ...]
    actuator_rows: tuple[int, ...]
    n_own: int
    nx: int
    nu: int
    delay: int

    bindings: ClassVar[Mapping[str, Any]] = {}

    def write(self, inner: str, name: str) -> str:
        """Return the source of the block function around the law called ``inner``."""
        lines = [f"def {name}(x, u, p, y, scratch):", "    for lane in range(LANES):"]
        shares = self.n_own + len(self.actuator_rows)
        for i, control in enumerate(self.controls):
            terms = [f"u[{control} * LANES + lane]" + (f" * p[{shares}]" if self.delay else "")]
            for lag in range(self.delay):
                row = self.nx + lag * self.nu + control
                terms.append(f"x[{row} * LANES + lane] * p[{shares + 1 + lag}]")
            lines.append(f"        commanded_{i} = {' + '.join(terms)}")
        acting = [f"x[{row} * LANES + lane]" for row in self.actuator_rows]
        acting = acting or [f"commanded_{i}" for i in range(len(self.controls))]
        state = _tuple(f"x[{row} * LANES + lane]" for row in self.law_rows)
        own = _tuple(f"p[{i}]" for i in range(self.n_own))
        lines.append(f"        rate = {inner}({state}, {_tuple(acting)}, {own})")
        lines += [f"        y[{row} * LANES + lane] = rate[{i}]" for i, row in enumerate(self.rate_rows)]
        lines += [f"        y[{row} * LANES + lane] = x[{speed} * LANES + lane]" for row, speed in self.known]
        for i, row in enumerate(self.actuator_rows):
            here = f"[{row} * LANES + lane]"
            lines.append(f"        y{here} = (commanded_{i} - x{here}) * p[{self.n_own + i}]")
        return "\n".join(lines)


def _tuple(items: Any) -> str:
    return "(" + "".join(f"{item}, " for item in items) + ")"
