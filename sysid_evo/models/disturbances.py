"""Domain randomisation: noise, latency, gains, lost commands, late estimates around any dynamics."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from sysid_evo.carry import clip_state, recent
from sysid_evo.errors import InvalidArgument
from sysid_evo.kernels import DynamicsKernel
from sysid_evo.models.dynamics import Around, Dynamics, started
from sysid_evo.models.kernels.disturbances import delayed_kernel, perturbed_kernel, sensors_kernel
from sysid_evo.registry.registry import noises
from sysid_evo.system import System
from sysid_evo.types import Array


@noises.register("envelope")
@dataclass(frozen=True)
class RadicalEnvelope:
    """How far a robot may differ from its model; 0 means that it does not.

    It is Jakobi's radical envelope (paper, section 2.1): noise whose absence a controller must not rely on.
    The *base set* is what is reliable: channels named in ``base`` (states and controls) meet no noise. All
    others do, and how much is drawn anew for every trial, from none to all of what stands here. Most trials
    therefore meet some noise and some hardly any, so that a controller can rely neither on its absence
    nor on its presence.

    | parameter | what | unit |
    |---|---|---|
    | ``sensor`` | white noise on what is observed of a state, at most | standard deviations of the training states |
    | ``bias`` | constant error of what is observed, its standard deviation over trials | the same |
    | ``latency`` | a command acts so many samples late, drawn from 0 to this | samples of dt |
    | ``dropout`` | probability that a command is lost and the last one held, at most | share of samples |
    | ``gain`` | a state changes faster or slower: its change in a step times exp(gain z) | 0.1: about 10 % |
    | ``scale`` | a state answers more or less, end values too: measured from neutral, times exp(scale z) | 0.1: 10 % |
    | ``effect`` | what a control adds to neutral, times exp(effect z) | 0.1: about 10 % |
    | ``process`` | white noise on a state in every step, at most | standard deviations of the training states |

    z is standard normal, one for each channel and trial. ``gain`` and ``scale`` spare periodic states.
    A family with one network or table for each command does not notice ``effect``.
    """

    sensor: float = 0.0
    bias: float = 0.0
    latency: int = 0
    dropout: float = 0.0
    gain: float = 0.0
    scale: float = 0.0
    effect: float = 0.0
    process: float = 0.0
    base: Sequence[str] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "base", tuple(self.base) if isinstance(self.base, (list, tuple)) else (self.base,))
        for item in fields(self):
            value = getattr(self, item.name)
            if item.name == "base":
                continue
            whole = item.name == "latency"
            number = isinstance(value, int if whole else (int, float)) and not isinstance(value, bool)
            if not number or not 0 <= value < np.inf:
                raise InvalidArgument(
                    f"noise: expected {item.name} to be {'a whole number' if whole else 'a number'} >= 0, got {value!r}"
                )
        if self.dropout > 1.0:
            raise InvalidArgument(f"noise: dropout is a probability, at most 1, got {self.dropout}")

    def check_system(self, system: System) -> None:
        """Raise `InvalidArgument` if the base set names a channel that ``system`` does not have."""
        known = [channel.name for channel in (*system.states, *system.controls)]
        unknown = [name for name in self.base if name not in known]
        if unknown:
            raise InvalidArgument(
                f"noise: the base set names {', '.join(map(repr, unknown))}; the channels are {', '.join(known)}"
            )

    def free(self, system: System) -> tuple[Array, Array]:
        """Return 1.0 for each state (nx,) and each control (nu,) that meets noise, 0.0 for those of the base set."""
        states, controls = (
            np.array([0.0 if channel.name in self.base else 1.0 for channel in channels])
            for channels in (system.states, system.controls)
        )
        return states, controls

    @property
    def perturbs(self) -> bool:
        """Whether the dynamics itself, or what it is commanded, differs from the model."""
        return any((self.latency, self.dropout, self.gain, self.scale, self.effect, self.process))


def disturbed(dynamics: Dynamics, noise: RadicalEnvelope, delay: float = 0.0) -> Dynamics:
    """Return ``dynamics`` as a controller meets it: with ``noise``, and observed ``delay`` s late."""
    noise.check_system(dynamics.system)
    spread = state_spread(dynamics)
    if noise.perturbs:
        dynamics = Perturbed(dynamics, noise, spread)
    if delay:
        dynamics = DelayedEstimate(dynamics, delay)
    return NoisySensors(dynamics, noise, spread) if noise.sensor or noise.bias else dynamics


WHOLE_TOLERANCE = 1e-9
"""A delay this near to a whole number of samples is one."""


class DelayedEstimate(Around):
    """``inner``, of which controllers and tasks observe the state of ``delay`` s ago.

    With delay / dt = m + f, m whole and 0 <= f < 1, what is observed at sample k lies between two
    samples::

        o_k = (1 - f) x_{k-m} + f x_{k-m-1}

    The carry is that of ``inner``, then o_k, then the last m states (newest first). The state itself,
    the pose that a task makes of it, walls and the envelope are those of ``inner``: only what is
    observed is late. On the robot too the pose comes from the tracker and only velocities are estimated.
    """

    def __init__(self, inner: Dynamics, delay: float) -> None:
        if not 0.0 <= delay < math.inf:
            raise InvalidArgument(f"delayed estimate: expected a delay >= 0 s, got {delay}")
        if inner.observed_at != 0:
            raise InvalidArgument("delayed estimate: the dynamics has an estimate of its own already")
        samples = delay / inner.system.dt
        self.inner = inner
        self.delay = delay
        self.whole = math.floor(samples + WHOLE_TOLERANCE)
        self.share = max(0.0, samples - self.whole)
        self.system = inner.system
        self.observed_at = inner.n_carry
        self.n_carry = inner.n_carry + self.system.nx * (1 + self.whole)
        self.n_lags = max(inner.n_lags, self.whole + 1)
        self.n_noise = inner.n_noise
        self.n_draws = inner.n_draws
        self.doubt_at = inner.doubt_at

    def start(self, states: Array, controls: Array, draws: Array | None = None) -> Array:
        m = self.whole
        inner = self.inner.start(*recent(states, controls, self.inner.n_lags), draws)
        observed = self._between(states[:, -1 - m], states[:, -2 - m])
        past = [states[:, -2 - lag] for lag in range(m)]
        return np.concatenate([inner, observed, *past], axis=1)

    def step(self, carry: Array, control: Array, noise: Array | None = None) -> Array:
        nx, at, m = self.system.nx, self.observed_at, self.whole
        inner = self.inner.step(carry[:, :at], control, noise)
        newest = inner[:, :nx]
        if self.envelope is not None:
            newest = np.clip(newest, *self.envelope)
        states = np.concatenate([newest, carry[:, :nx], carry[:, at + nx :]], axis=1)
        observed = self._between(states[:, m * nx :][:, :nx], states[:, (m + 1) * nx :][:, :nx])
        return np.concatenate([inner, observed, states[:, nx : (m + 1) * nx]], axis=1)

    def kernel(self) -> DynamicsKernel | None:
        inner = self.inner.kernel()
        if inner is None:
            return None
        return delayed_kernel(
            inner, self.system.nx, self.inner.n_carry, whole=self.whole, share=self.share, envelope=self.envelope
        )

    def _between(self, later: Array, earlier: Array) -> Array:
        return (1.0 - self.share) * later + self.share * earlier


class NoisySensors(Around):
    """``inner``, of which controllers and tasks observe the state with a bias and white noise.

    ``noise`` says how much, in ``spread`` (nx,). What is observed at sample k of what ``inner`` shows, o_k,
    with z standard normal::

        o_k + b + m z_k,        b = bias spread z,        m = sensor spread U,        U in [0, 1]

    b and m stay for a trial. The carry is that of ``inner``, then what is observed, then b, then m. The state
    itself, the pose that a task makes of it, and walls are those of ``inner``: on the robot too the
    tracker sees the pose, and velocities come out of it with noise. The first sample has the bias only.
    """

    def __init__(self, inner: Dynamics, noise: RadicalEnvelope, spread: Array) -> None:
        nx = inner.system.nx
        self.inner, self.noise = inner, noise
        self.system, self.n_lags, self.doubt_at = inner.system, inner.n_lags, inner.doubt_at
        self.size = noise.free(inner.system)[0] * spread
        self.observed_at = inner.n_carry
        self.n_carry = inner.n_carry + 3 * nx
        self.n_noise = inner.n_noise + nx
        self.n_draws = inner.n_draws + 2 * nx

    def start(self, states: Array, controls: Array, draws: Array | None = None) -> Array:
        from scipy.special import ndtr

        draws = np.zeros((len(states), self.n_draws)) if draws is None else draws
        inner = self.inner.start(states, controls, draws[:, : self.inner.n_draws])
        bias, level = np.split(draws[:, self.inner.n_draws :], 2, axis=1)
        bias, level = self.noise.bias * self.size * bias, self.noise.sensor * self.size * ndtr(level)
        return np.concatenate([inner, self._shown(inner) + bias, bias, level], axis=1)

    def step(self, carry: Array, control: Array, noise: Array | None = None) -> Array:
        assert noise is not None
        at, own = self.inner.n_carry, self.inner.n_noise
        inner = self.inner.step(carry[:, :at], control, noise[:, :own] if own else None)
        _, bias, level = np.split(carry[:, at:], 3, axis=1)
        return np.concatenate([inner, self._shown(inner) + bias + level * noise[:, own:], bias, level], axis=1)

    def kernel(self) -> DynamicsKernel | None:
        inner = self.inner.kernel()
        if inner is None:
            return None
        return sensors_kernel(
            inner,
            self.system.nx,
            self.inner.n_carry,
            shown_at=self.inner.observed_at,
            n_noise=self.inner.n_noise,
            envelope=self.envelope,
        )

    def _shown(self, inner: Array) -> Array:
        """Return what ``inner`` shows of its state, (B, nx), within the envelope as a loop will clip it."""
        at, nx = self.inner.observed_at, self.system.nx
        shown = inner[:, at : at + nx]
        return shown if self.envelope is None else np.clip(shown, *self.envelope)


NEVER = -1e6
"""A threshold below which no standard normal number lies."""


class Perturbed(Around):
    """``inner`` = f with commands that come late or not at all, and with another strength and speed of answer.

    With the state x and command u measured from neutral, and factors g, s (nx,), e (nu,) of the trial::

        x_{k+1} = s (y + g (f(y, v) - y)) + m z_k,        y = x_k / s,        v = e r_{k-d}

    r_k is the last command that was not lost, d the latency and p the probability of loss in the trial; m the size
    of the process noise; ``noise`` says how they are drawn, sizes are in ``spread`` (nx,). The model so sees its own
    state y, and a robot with s = 1.1 does everything 10 % more. The carry is that of ``inner`` (with x for
    y), then g, s, m, e, d, the threshold of loss, and the last commands received (newest first).
    """

    def __init__(self, inner: Dynamics, noise: RadicalEnvelope, spread: Array) -> None:
        if inner.observed_at != 0:
            raise InvalidArgument("noise: the dynamics is observed late already; perturb it first")
        system = inner.system
        self.inner, self.noise = inner, noise
        self.system, self.doubt_at = system, inner.doubt_at
        self.free_states, self.free_controls = noise.free(system)
        self.steady = self.free_states.copy()
        self.steady[list(system.periods)] = 0.0
        self.size = noise.process * self.free_states * spread
        self.stored = max(noise.latency, 1 if noise.dropout else 0)
        self.n_own = 3 * system.nx + system.nu + 2
        self.n_carry = inner.n_carry + self.n_own + self.stored * system.nu
        self.n_lags = max(inner.n_lags, self.stored)
        self.process_at = inner.n_noise if noise.process else -1
        self.dropout_at = inner.n_noise + (system.nx if noise.process else 0) if noise.dropout else -1
        self.n_noise = inner.n_noise + (system.nx if noise.process else 0) + (1 if noise.dropout else 0)
        self.n_draws = inner.n_draws + self.n_own

    def start(self, states: Array, controls: Array, draws: Array | None = None) -> Array:
        from scipy.special import ndtr, ndtri

        nx, nu = self.system.nx, self.system.nu
        draws = np.zeros((len(states), self.n_draws)) if draws is None else draws
        z = draws[:, self.inner.n_draws :]
        gain = np.exp(self.noise.gain * self.steady * z[:, :nx])
        scale = np.exp(self.noise.scale * self.steady * z[:, nx : 2 * nx])
        process = self.size * ndtr(z[:, 2 * nx : 3 * nx])
        effect = np.exp(self.noise.effect * self.free_controls * z[:, 3 * nx : 3 * nx + nu])
        level = ndtr(z[:, -2:])
        delay = np.minimum(np.floor(level[:, :1] * (self.noise.latency + 1)), self.noise.latency)
        with np.errstate(divide="ignore"):
            threshold = np.maximum(ndtri(self.noise.dropout * level[:, 1:]), NEVER)
        rest = self.system.neutral_state
        own, own_controls = recent(states, controls, self.inner.n_lags)
        own = rest + (own - rest) / scale[:, None]
        inner = self.inner.start(own, own_controls, draws[:, : self.inner.n_draws])
        past = [controls[:, controls.shape[1] - 1 - back] for back in range(self.stored)]
        return np.concatenate(
            [states[:, -1], inner[:, nx:], gain, scale, process, effect, delay, threshold, *past], axis=1
        )

    def step(self, carry: Array, control: Array, noise: Array | None = None) -> Array:
        nx, nu, at = self.system.nx, self.system.nu, self.inner.n_carry
        own, past = carry[:, at : at + self.n_own], carry[:, at + self.n_own :]
        gain, scale, process = own[:, :nx], own[:, nx : 2 * nx], own[:, 2 * nx : 3 * nx]
        effect, delay, threshold = own[:, 3 * nx : 3 * nx + nu], own[:, -2:-1], own[:, -1:]
        received = control
        if self.dropout_at >= 0:
            assert noise is not None
            lost = noise[:, self.dropout_at : self.dropout_at + 1] < threshold
            received = np.where(lost & (self.free_controls > 0), past[:, :nu], control)
        applied = received
        for back in range(1, self.noise.latency + 1):
            late = (delay == back) & (self.free_controls > 0)
            applied = np.where(late, past[:, (back - 1) * nu : back * nu], applied)
        idle, rest = self.system.neutral_control, self.system.neutral_state
        applied = idle + effect * (applied - idle)
        before = rest + (carry[:, :nx] - rest) / scale
        given = noise[:, : self.inner.n_noise] if noise is not None and self.inner.n_noise else None
        inner = self.inner.step(np.concatenate([before, carry[:, nx:at]], axis=1), applied, given)
        after = rest + scale * (before + gain * (inner[:, :nx] - before) - rest)
        if self.process_at >= 0:
            assert noise is not None
            after = after + process * noise[:, self.process_at : self.process_at + nx]
        kept = np.concatenate([received, past], axis=1)[:, : self.stored * nu]
        return np.concatenate([after, inner[:, nx:], own, kept], axis=1)

    def kernel(self) -> DynamicsKernel | None:
        inner = self.inner.kernel()
        if inner is None:
            return None
        return perturbed_kernel(
            inner,
            self.system,
            self.inner.n_carry,
            free_controls=self.free_controls,
            latency=self.noise.latency,
            stored=self.stored,
            process_at=self.process_at,
            dropout_at=self.dropout_at,
        )


TRIALS, STEPS, HELD, WARM_UP = 32, 120, 8, 40


def state_spread(dynamics: Dynamics) -> Array:
    """Return the standard deviation (nx,) of each state in the training data of ``dynamics``, see `System.spread`.

    What was not fitted to any, as an emulated robot, is driven by random commands for that, from a fixed
    seed: 32 times, each command held for 8 samples. A state that never varies has 1, its own unit.
    """
    nx = dynamics.system.nx
    pairs = getattr(dynamics, "pairs_", None)
    states = _driven(dynamics) if pairs is None else pairs[:, :nx]
    spread = dynamics.system.spread(states)
    return np.where(np.isfinite(spread) & (spread > 0.0), spread, 1.0)


def _driven(dynamics: Dynamics) -> Array:
    """Return the states (N, nx) that random commands lead to."""
    system, rng = dynamics.system, np.random.default_rng(0)
    draws = rng.standard_normal((TRIALS, dynamics.n_draws))
    carry = started(dynamics, np.tile(system.neutral_state, (TRIALS, 1)), draws)
    seen = []
    with np.errstate(all="ignore"):
        for k in range(STEPS):
            if k % HELD == 0:
                command = system.actuate(rng.uniform(-1.0, 1.0, (TRIALS, system.nu)))
            noise = rng.standard_normal((TRIALS, dynamics.n_noise)) if dynamics.n_noise else None
            carry, _ = clip_state(dynamics.step(carry, command, noise), dynamics.envelope)
            seen.append(carry[:, : system.nx])
    visited = np.concatenate(seen[WARM_UP:])
    return visited[np.isfinite(visited).all(axis=1)]
