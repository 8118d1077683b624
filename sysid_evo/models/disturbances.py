"""Domain randomisation: noise, gains and delayed estimates around any dynamics; its compiled form."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sysid_evo.carry import clip_state, recent
from sysid_evo.errors import InvalidArgument
from sysid_evo.kernels import (
    CACHE_LINE,
    LANES,
    DynamicsKernel,
    KernelSource,
    Layout,
    load,
    splat,
    store,
    view,
)
from sysid_evo.models.dynamics import Dynamics, PlainDynamics, started
from sysid_evo.models.kernels.stepping import copy
from sysid_evo.registry.registry import noises
from sysid_evo.types import Array


@noises.register("domain_randomisation")
@dataclass(frozen=True)
class DomainRandomisation:
    """Disturbances that keep controllers from relying on a noise-free model; 0 disables each of them.

    It follows Jakobi's radical noise (paper, section 2.1): the amount of noise is drawn for every trial and state, from
    none to the values below, so that a controller can rely neither on the absence of noise nor on its presence.

    | parameter | meaning | unit |
    |---|---|---|
    | ``sensor`` | largest white noise of an observed state | standard deviations of the training states |
    | ``gain`` | the change of a state in a step is multiplied by exp(gain z) | 0.1: about 10 % |
    | ``process`` | largest white noise of a state in every step | standard deviations of the training states |

    z is standard normal, drawn for each state and trial. ``gain`` does not apply to periodic states.
    """

    sensor: float = 0.0
    gain: float = 0.0
    process: float = 0.0

    def __post_init__(self) -> None:
        for name in ("sensor", "gain", "process"):
            value = getattr(self, name)
            if not isinstance(value, (int, float)) or isinstance(value, bool) or not 0 <= value < np.inf:
                raise InvalidArgument(f"noise: expected {name} to be a number >= 0, got {value!r}")


WHOLE_TOLERANCE = 1e-9
"""A delay within this distance of a whole number of samples is rounded to it."""


class Disturbed(PlainDynamics):
    """``inner`` with ``noise`` and with observations that are delayed by ``delay`` s.

    With delay / dt = m + f, m whole and 0 <= f < 1, w and z standard normal, a step from state x_k under command u_k
    is::

        y = x_k + g (f(x_k, u_k) - x_k)                 g = exp(gain w)
        x_{k+1} = y + p z                               p = process spread U,       U in [0, 1]
        o_{k+1} = (1 - f) x_{k+1-m} + f x_{k-m}         clipped to the state bounds
        observed = o_{k+1} + s z                        s = sensor spread U

    g, p and s (nx,) are drawn at the start of a trial; ``spread`` (nx,) is `state_std` by default. Disabled effects use
    no random numbers.

    Controllers and tasks observe the last line. The state itself, the pose, walls and the state bounds are those of
    ``inner``: on a robot too the tracker measures the pose, and velocities are derived from it late and with noise. The
    first sample has no white noise.

    The carry is that of ``inner``, then, if enabled: g, p; the observation, earlier states, newest first; s.
    """

    def __init__(
        self,
        inner: Dynamics,
        noise: DomainRandomisation | None = None,
        *,
        delay: float = 0.0,
        spread: Array | None = None,
    ) -> None:
        if not 0.0 <= delay < math.inf:
            raise InvalidArgument(f"disturbances: expected a delay >= 0 s, got {delay}")
        if inner.observed_at != 0:
            raise InvalidArgument("disturbances: these dynamics are disturbed already; give noise and delay together")
        self.inner, self.system, self.outside_at = inner, inner.system, inner.outside_at
        self.noise = noise = DomainRandomisation() if noise is None else noise
        nx, nu, samples = inner.system.nx, inner.system.nu, delay / inner.system.dt
        self.whole = math.floor(samples + WHOLE_TOLERANCE)
        self.share = max(0.0, samples - self.whole)
        self.kept = self.whole + (self.share > 0.0)
        self.moves, self.senses = any((noise.gain, noise.process)), noise.sensor > 0.0
        self.observes = self.senses or delay > 0.0
        if spread is None and (self.senses or noise.process):
            spread = state_std(inner)
        self.size = np.ones(nx) if spread is None else spread
        sizes = [nx * self.moves, nx * self.moves, nx * self.observes, nx * self.kept, nx * self.senses]
        self.ends = inner.n_carry + np.cumsum(sizes)
        self.n_carry = int(self.ends[-1])
        self.observed_at = int(self.ends[1]) if self.observes else 0
        self.n_lags = max(inner.n_lags, self.kept)
        self.n_noise = inner.n_noise + (nx if noise.process else 0) + nx * self.senses
        self.n_draws = inner.n_draws + (3 * nx + nu + 2) * self.moves + 2 * nx * self.senses

    @property
    def state_bounds(self) -> Array | None:
        return self.inner.state_bounds

    def start(self, states: Array, controls: Array, draws: Array | None = None) -> Array:
        from scipy.special import ndtr

        noise, nx, first = self.noise, self.system.nx, self.inner.n_draws
        draws = np.zeros((len(states), self.n_draws)) if draws is None else draws
        tail: list[Array] = []
        if self.moves:
            # unused columns belong to removed kinds of noise, so that the others keep their random numbers
            gain, _, process = np.split(draws[:, first : first + 3 * nx], 3, axis=1)
            steady = np.ones(nx)
            steady[list(self.system.periods)] = 0.0
            tail += [np.exp(noise.gain * steady * gain), noise.process * self.size * ndtr(process)]
        if self.observes:
            tail += [self._observed(states[:, ::-1]), *(states[:, -2 - back] for back in range(self.kept))]
        if self.senses:
            tail.append(noise.sensor * self.size * ndtr(draws[:, -nx:]))
        return np.concatenate(
            [self.inner.start(*recent(states, controls, self.inner.n_lags), draws[:, :first]), *tail], axis=1
        )

    def step(self, carry: Array, control: Array, noise: Array | None = None) -> Array:
        nx, at = self.system.nx, self.inner.n_noise
        given = noise[:, :at] if noise is not None and at else None
        noise = np.zeros((len(carry), self.n_noise)) if noise is None else noise
        own, gain, process, observed, states, level = np.split(carry, [self.inner.n_carry, *self.ends[:-1]], axis=1)
        before = carry[:, :nx]
        inner = self.inner.step(own, control, given)
        after = inner[:, :nx]
        if self.moves:
            after = before + gain * (after - before)
        if self.noise.process:
            after = after + process * noise[:, at : at + nx]
        if self.observes:
            newest = after if self.state_bounds is None else np.clip(after, *self.state_bounds)
            history = np.concatenate([newest, before, states], axis=1).reshape(len(carry), -1, nx)
            observed, states = self._observed(history), history[:, 1 : 1 + self.kept].reshape(len(carry), -1)
        if self.senses:
            observed = observed + level * noise[:, -nx:]
        return np.concatenate([after, inner[:, nx:], gain, process, observed, states, level], axis=1)

    def kernel(self) -> DynamicsKernel | None:
        return self._compiled

    @cached_property
    def _compiled(self) -> DynamicsKernel | None:
        inner, bounds, nx = self.inner.kernel(), self.state_bounds, self.system.nx
        if inner is None:
            return None
        parameters = HEAD.pack(
            np.repeat([-np.inf, np.inf], nx) if bounds is None else np.ravel(bounds),
            nx=nx,
            kept=self.kept,
            whole=self.whole,
            share=self.share,
            moved_at=self.inner.n_carry if self.moves else -1,
            process_at=self.inner.n_noise if self.noise.process else -1,
            observed_at=self.observed_at if self.observes else -1,
            sensed_at=self.ends[3],
            sensor_at=self.n_noise - nx if self.senses else -1,
            own=inner.parameters,
        )
        source = KernelSource(disturbed, {"inner": inner.source})
        return DynamicsKernel(source, parameters, nx + inner.n_scratch, inner.precision)

    def _observed(self, states: Array) -> Array:
        """Return the delayed state (B, nx), without sensor errors, from ``states`` (B, any, nx), newest first."""
        later = states[:, self.whole]
        return (1.0 - self.share) * later + self.share * states[:, self.whole + 1] if self.share else later


TRIALS, STEPS, HELD, WARM_UP = 32, 120, 8, 40


def state_std(dynamics: Dynamics) -> Array:
    """Return the standard deviation (nx,) of each state in the training data of ``dynamics``, see `System.spread`.

    Dynamics without training data, such as an emulated robot, are simulated 32 times with random commands from a fixed
    seed, each held for 8 samples. For a constant state it is 1 of its unit.
    """
    nx = dynamics.system.nx
    pairs = getattr(dynamics, "training_sample_", None)
    states = _driven(dynamics) if pairs is None else pairs[:, :nx]
    spread = dynamics.system.spread(states)
    return np.where(np.isfinite(spread) & (spread > 0.0), spread, 1.0)


def _driven(dynamics: Dynamics) -> Array:
    """Return the states (N, nx) of simulations with random commands."""
    system, rng = dynamics.system, np.random.default_rng(0)
    draws = rng.standard_normal((TRIALS, dynamics.n_draws))
    carry = started(dynamics, np.tile(system.neutral_state, (TRIALS, 1)), draws)
    seen = []
    with np.errstate(all="ignore"):
        for k in range(STEPS):
            if k % HELD == 0:
                command = system.actuate(rng.uniform(-1.0, 1.0, (TRIALS, system.nu)))
            noise = rng.standard_normal((TRIALS, dynamics.n_noise)) if dynamics.n_noise else None
            carry, _ = clip_state(dynamics.step(carry, command, noise), dynamics.state_bounds)
            seen.append(carry[:, : system.nx])
    visited = np.concatenate(seen[WARM_UP:])
    return visited[np.isfinite(visited).all(axis=1)]


HEAD = Layout(
    "nx", "kept", "whole", "share", "moved_at", "process_at", "observed_at", "sensed_at", "sensor_at", "own",
    align=CACHE_LINE,
)  # fmt: skip
"""Rows are -1 if absent: in the carry, the first ones of gains, observations and sensor errors (``moved_at``,
``observed_at``, ``sensed_at``); in the noise, ``process_at`` and ``sensor_at``. The state bounds follow.
"""


def disturbed(carry, control, noise, parameters, scratch):
    """Step the inner dynamics, disturb the state, and write the observation."""
    nx = int(parameters[HEAD.nx])
    moved, seen, limits = parameters[HEAD.moved_at], parameters[HEAD.observed_at], view(parameters, HEAD.size)
    rows, before = nx * LANES, scratch
    if moved >= 0.0:
        copy(carry, before, rows)
    if seen >= 0.0:
        remember(carry, view(carry, (int(seen) + nx) * LANES), int(parameters[HEAD.kept]), rows)
    inner(carry, control, noise, view(parameters, int(parameters[HEAD.own])), view(scratch, rows))
    if moved >= 0.0:
        gain = view(carry, int(moved) * LANES)
        for row in range(nx):
            start = load(before, row * LANES)
            change = load(carry, row * LANES) - start
            store(carry, row * LANES, start + load(gain, row * LANES) * change)
    if parameters[HEAD.process_at] >= 0.0:
        process = view(carry, (int(moved) + nx) * LANES)
        shaken = view(noise, int(parameters[HEAD.process_at]) * LANES)
        for row in range(nx):
            pushed = load(process, row * LANES) * load(shaken, row * LANES)
            store(carry, row * LANES, load(carry, row * LANES) + pushed)
    if seen >= 0.0:
        observed, whole, share = view(carry, int(seen) * LANES), int(parameters[HEAD.whole]), parameters[HEAD.share]
        states = view(observed, rows)
        for row in range(nx):
            later = min(max(load(carry, row * LANES), limits[row]), limits[nx + row])
            if whole > 0:
                later = load(states, ((whole - 1) * nx + row) * LANES)
            if share > 0.0:
                later = later - splat(share) * (later - load(states, (whole * nx + row) * LANES))
            store(observed, row * LANES, later)
    if parameters[HEAD.sensor_at] >= 0.0:
        observed, level = view(carry, int(seen) * LANES), view(carry, int(parameters[HEAD.sensed_at]) * LANES)
        drawn = view(noise, int(parameters[HEAD.sensor_at]) * LANES)
        for row in range(nx):
            error = load(level, row * LANES) * load(drawn, row * LANES)
            store(observed, row * LANES, load(observed, row * LANES) + error)


def remember(newest, past, count, size):
    """Insert ``newest`` before ``count`` blocks of ``size`` numbers, and drop the last one."""
    for back in range(count - 1, 0, -1):
        copy(view(past, (back - 1) * size), view(past, back * size), size)
    if count > 0:
        copy(newest, past, size)
