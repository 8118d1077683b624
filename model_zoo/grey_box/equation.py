"""The equation that is integrated, in NumPy and compiled: law, actuator lag, delay, hidden states and their estimate.

Arrays are component first here, so that many parameter vectors run in many windows at once: a state is (n, B) and
parameters are (n_parameters, 1), or (n, P, B) and (n_parameters, P, 1).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from model_zoo.grey_box.parameters import HiddenState, Parameter, ParameterBounds
from sysid_evo.carry import CarryLayout
from sysid_evo.errors import InvalidArgument
from sysid_evo.kernels import DynamicsKernel
from sysid_evo.laws import array_form
from sysid_evo.models.dynamics import rk4
from sysid_evo.models.kernels import Predictor, added, runge_kutta_predictor, stepping_kernel, turning_frame
from sysid_evo.system import Channel, System
from sysid_evo.types import Array, check_shape

SHORTEST_LAG = 0.5
"""Of a step of the integration: a faster actuator is none."""
LONGEST_LAG = 1.0  # s


@dataclass(frozen=True)
class GreyBoxEquation:
    """The law ``rate(state, control, p)`` on a system, with what is switched on around it.

    The law's states are those of the system at the places ``states`` and then ``hidden`` ones, its controls those at
    ``controls``. ``known`` are places of states and of those that are their rates; the law gives the rates of the
    others. With ``lagged`` every control acts through a first-order lag of its own; ``delay`` is how many earlier
    samples of the controls are remembered, for a delay between 0 and that.
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
        return ParameterBounds.of(self.parameters)

    @cached_property
    def extended(self) -> System:
        """The system with hidden states and the states of the actuators behind the measured ones."""
        actuators = [self.system.controls[i] for i in self.controls] if self.lagged else []
        more = [hidden.channel for hidden in self.hidden]
        more += [
            Channel(f"{control.name} that acts", control.unit, control.low, control.high, neutral=control.neutral)
            for control in actuators
        ]
        return replace(self.system, states=(*self.system.states, *more))

    @property
    def layout(self) -> CarryLayout:
        """The carry: extended state, then the earlier controls that a delay wants."""
        return CarryLayout(self.extended.nx, self.system.nu, 0, self.delay)

    @property
    def hidden_rows(self) -> slice:
        """Where the hidden states stand in the carry."""
        return slice(self.system.nx, self.system.nx + len(self.hidden))

    @property
    def actuator_rows(self) -> slice:
        """Where the actuators stand in the carry."""
        return slice(self.system.nx + len(self.hidden), self.extended.nx)

    @cached_property
    def law_rows(self) -> tuple[int, ...]:
        """Where the law's states stand in the carry."""
        return (*self.states, *range(self.system.nx, self.system.nx + len(self.hidden)))

    @cached_property
    def rate_rows(self) -> tuple[int, ...]:
        """Where the states whose rates the law gives stand in the carry."""
        positions = [position for position, _ in self.known]
        return tuple(row for row in self.law_rows if row not in positions)

    def shorter(self, delay: float) -> GreyBoxEquation:
        """Return the structure that remembers no more samples than this delay wants."""
        return replace(self, delay=max(1, math.ceil(delay - 1e-9))) if self.delay else self

    def check(self) -> None:
        """Raise `InvalidArgument` unless the law gives one finite rate for each state of which none is known."""
        extended = self.extended.neutral_state[list(self.law_rows)]
        neutral = self.system.neutral_control[list(self.controls)]
        guess = np.array([parameter.guess for parameter in self.own])
        name = getattr(self.law, "__qualname__", "rate")
        try:
            with np.errstate(all="ignore"):
                found = array_form(self.law)(tuple(extended[:, None]), tuple(neutral[:, None]), tuple(guess))
            values = [np.broadcast_to(np.asarray(value, dtype=float), (1,)) for value in found]
        except (TypeError, ValueError) as error:
            raise InvalidArgument(
                f"{name}(state, control, p): expected a tuple of rates from {len(extended)} states, {len(neutral)} "
                f"controls and {len(guess)} parameters; it says: {error}"
            ) from error
        if len(values) != len(self.rate_rows):
            names = [self.extended.state_names[i] for i in self.rate_rows]
            raise InvalidArgument(
                f"{name}(state, control, p): expected {len(names)} rates, of {', '.join(names)}; got {len(values)}. "
                "Of states that are the rate of another one, tell so in speeds"
            )
        if not np.isfinite(values).all():
            raise InvalidArgument(f"{name}(state, control, p): the rates at rest with the first guess are {values}")

    def acting(self, p: Array, controls: list[Array]) -> Array:
        """Return the law's controls (n, ...) from the present and earlier ones (nu, ...), newest first: delayed."""
        places = list(self.controls)
        if not self.delay:
            return controls[0][places]
        shares = delay_shares(p[-1], self.delay)
        return np.asarray(sum(share * control[places] for share, control in zip(shares, controls, strict=True)))

    def rates(self, x: Array, commanded: Array, p: Array) -> Array:
        """Return d/dt of the extended state ``x`` (n, ...) under commands (n_controls, ...) that have arrived."""
        found = np.zeros_like(x)
        control = x[self.actuator_rows] if self.lagged else commanded
        rates = array_form(self.law)(tuple(x[i] for i in self.law_rows), tuple(control), tuple(p[: len(self.own)]))
        for row, rate in zip(self.rate_rows, rates, strict=True):
            found[row] = rate
        for position, speed in self.known:
            found[position] = x[speed]
        if self.lagged:
            lags = p[len(self.own) : len(self.own) + len(self.controls)]
            found[self.actuator_rows] = (commanded - control) / lags
        if self.system.motion is not None:
            found += np.moveaxis(self.extended.frame_rotation(np.moveaxis(x, 0, -1)), -1, 0)
        return found

    def step(
        self, p: Array, carry: Array, control: Array, extra: Callable[[Array], Array] | None = None
    ) -> tuple[Array, Array]:
        """Return the next extended state (n, ...) and the earlier controls from a carry (n_carry, ...).

        ``extra`` is what is added to the rates of the measured states (nx, ...) in an extended state.
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

        after = carry[:nx]
        for _ in range(self.substeps):
            after = rk4(rate, after, self.system.dt / self.substeps)
        if self.extended.limited:
            low, high = (side.reshape(-1, *[1] * (after.ndim - 1)) for side in self.extended.limits)
            after = np.clip(after, low, high)
        if not self.delay:
            return after, past
        return after, np.concatenate([np.broadcast_to(control, (nu, *past.shape[1:])), past[:-nu]])

    def start(self, p: Array, states: Array, controls: Array, hidden: Array) -> Array:
        """Return the carry (n_carry, ..., B) after a history (B, L + 1, nx), (B, L, nu) with ``hidden`` (n, ..., B).

        The actuators follow the commands of the history, of which the oldest one has held for long.
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
    """Return (n, B) with as many axes as ``rank``, those of parameters between."""
    return values.reshape(len(values), *[1] * (rank - 2), -1)


def delay_shares(delay: Array, longest: int) -> list[Array]:
    """Return the shares of the controls of 0, 1, ... ``longest`` samples ago that act under a ``delay`` in samples.

    A control that arrives within the sample acts for the rest of it: a weighted mean of two neighbours.
    """
    return [np.maximum(1.0 - np.abs(delay - lag), 0.0) for lag in range(longest + 1)]


ROUNDS = 3
"""Of Gauss and Newton, in which hidden states are estimated."""

STEP = 1e-4
"""Of the spread of a hidden state: the step of a difference quotient."""


def estimate_hidden(
    structure: GreyBoxEquation, p: Array, states: Array, controls: Array, *, mean: Array, spread: Array, noise: Array
) -> Array:
    """Return the most likely hidden states (n, B) at the end of a history (B, L + 1, nx), (B, L, nu).

    Those at its beginning are normal with ``mean`` and ``spread`` (n,) before anything is seen; a free run from there
    is off what is measured by ``noise`` (nx,). Each row is found for itself.
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


def structure_kernel(
    structure: GreyBoxEquation, p: Array, *, dead_band_size: Array | None = None, extra: Predictor | None = None
) -> DynamicsKernel | None:
    """Return the kernel of a structure with parameters (n,); None if the motion has no compiled form.

    With ``dead_band_size`` (n,), an extended state that rests stays at rest; ``extra`` is added to the rates
    of the measured ones.
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
    own = Predictor(law, kernel_parameters(structure, p[None])[0], 0)
    rate = turning_frame(own if extra is None else added(own, extra, structure.system.nx), system)
    if rate is None:
        return None
    after = runge_kutta_predictor(rate, system, substeps=structure.substeps, n_carry=structure.layout.size)
    return stepping_kernel(after, system, output="next_state", lags=(0, structure.delay), dead_band_size=dead_band_size)


def kernel_parameters(structure: GreyBoxEquation, p: Array) -> Array:
    """Return what `LawOverLanes` reads (P, m), from parameters (P, n): 1 / lag, and shares of the delay."""
    n, lags = len(structure.own), len(structure.controls) if structure.lagged else 0
    parts = [p[:, :n], 1.0 / p[:, n : n + lags]]
    if structure.delay:
        parts.append(np.stack(delay_shares(p[:, -1], structure.delay), axis=1))
    own = np.concatenate(parts, axis=1)
    return own if own.shape[1] else np.zeros((len(p), 1))


@dataclass(frozen=True)
class LawOverLanes:
    """A predictor of d/dt of the extended state of a `GreyBoxEquation`: its law, a function of plain numbers, over
    lanes.

    Its parameters are those of the law, 1 / lag of every actuator, and the share of each sample of the delay.
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
        """Return the text of the block function around the law called ``inner``."""
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
