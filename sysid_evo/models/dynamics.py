"""The base class of all dynamics, their simulation, a Runge-Kutta step."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from sysid_evo.carry import clip_state, latest
from sysid_evo.errors import InvalidArgument, ShapeError
from sysid_evo.kernels import DynamicsKernel, Precision
from sysid_evo.processors import one_blas_thread
from sysid_evo.system import System
from sysid_evo.types import Array, IntArray, check_shape


class Dynamics(ABC):
    """Base class of everything that steps by ``system.dt``.

    The *carry* (B, n_carry) is the state, ``carry[:, :nx]``, followed by all other memory.

    - ``n_lags``: samples of history before the present one that `start` needs; ``n_recent``: earlier ones that it uses
      if it gets them, too.
    - ``n_noise``, ``n_draws``: standard normal numbers that the caller passes to every `step` and to `start`; random
      numbers are never drawn inside.
    - ``observed_at``: index in the carry of the state that controllers and tasks observe: 0, unless a wrapper adds an
      estimate.
    - ``outside_at``: index in the carry of the count of steps outside the training data; None without one.
    """

    observed_at: int = 0
    outside_at: int | None = None
    if TYPE_CHECKING:  # properties in a family, plain attributes in `PlainDynamics`

        @property
        def system(self) -> System: ...
        @property
        def n_carry(self) -> int: ...
        @property
        def n_lags(self) -> int: ...
        @property
        def n_noise(self) -> int: ...
        @property
        def n_draws(self) -> int: ...
        @property
        def n_recent(self) -> int: ...

    else:
        n_lags = n_noise = n_draws = n_recent = 0

    @property
    def state_bounds(self) -> Array | None:
        """Lowest and highest value of each state, (2, nx), to which simulations are clipped; None for no clip."""
        return None

    @abstractmethod
    def start(self, states: Array, controls: Array, draws: Array | None = None) -> Array:
        """Return the carry (B, n_carry) after a history.

        ``states`` (B, n_lags + 1, nx) ends at the present, ``controls`` (B, n_lags, nu) at the
        sample before it, ``draws`` is (B, n_draws).
        """

    @abstractmethod
    def step(self, carry: Array, control: Array, noise: Array | None = None) -> Array:
        """Return the next carry (B, n_carry) under ``control`` (B, nu), with ``noise`` (B, n_noise).

        Pure: the same arguments give the same result, and rows are independent.
        """

    def kernel(self) -> DynamicsKernel | None:
        """Return the compiled form of `step`, if it has one."""
        return None


class PlainDynamics(Dynamics):
    """A dynamics whose system and sizes are plain attributes, set by its class or its constructor."""

    system: System
    n_carry: int
    n_lags: int = 0
    n_noise: int = 0
    n_draws: int = 0


def started(dynamics: Dynamics, states: Array, draws: Array | None = None, *, controls: Array | None = None) -> Array:
    """Return the carries (B, n_carry) after a constant history of ``states`` (B, nx) and ``controls`` (B, nu).

    Controls are neutral by default, and ``draws`` (B, n_draws) zeros.
    """
    count, lags = len(states), dynamics.n_lags
    held = np.tile(dynamics.system.neutral_control, (count, 1)) if controls is None else controls
    drawn = np.zeros((count, dynamics.n_draws)) if draws is None else draws
    return dynamics.start(np.repeat(states[:, None], lags + 1, axis=1), np.repeat(held[:, None], lags, axis=1), drawn)


def of_each_row(dynamics: Dynamics, method: str, carry: Array, values: Array) -> Array:
    """Return ``values`` of ``method`` for ``carry`` (B, n_carry) as an array (B, nx), or raise `ShapeError`."""
    checked = check_shape(f"{type(dynamics).__name__}.{method}", values, (*carry.shape[:-1], dynamics.system.nx))
    return values if isinstance(values, np.ndarray) else checked


def training_bounds(states: Array, multiple: float) -> Array:
    """Return the centre of ``states`` (N, nx) plus and minus ``multiple`` half ranges, (2, nx)."""
    low, high = states.min(axis=0), states.max(axis=0)
    centre, half = (low + high) / 2.0, np.maximum((high - low) / 2.0, np.finfo(float).tiny)
    return np.stack([centre - multiple * half, centre + multiple * half])


FAR = 16.0
"""Distance of a state from zero, in half widths of its state bounds, beyond which it needs double precision.

On a damped oscillation the rounding error of single precision after 3 s was 1e-5 standard deviations at a distance of
6 (30 standard deviations), and 1e-3 at 200 (1,000); unstable systems amplify it.
"""


def far_from_zero(state_bounds: Array | None) -> IntArray:
    """Return the indices of states whose bounds, ``state_bounds`` (2, nx), are over `FAR` half widths from zero.

    The relative precision of a float32 is 6e-8: 0.25 m at 4e6 m. Every step rounds, and the errors add up.
    States without bounds, and states that do not change, are not included.
    """
    low, high = np.zeros((2, 0)) if state_bounds is None else state_bounds
    half, nearest = (high - low) / 2.0, np.maximum(low, -high)
    return np.flatnonzero((half > 0.0) & (nearest > FAR * half))


def enough(precision: Precision, state_bounds: Array | None) -> Precision:
    """Return ``precision``, or float64 if states within ``state_bounds`` require it, see `far_from_zero`."""
    return "float64" if len(far_from_zero(state_bounds)) else precision


def rk4(rate: Callable[[Any], Any], state: Any, dt: float) -> Any:
    """Return the state (..., nx) after ``dt`` seconds of d state / dt = ``rate(state)``."""
    k1 = rate(state)
    k2 = rate(state + 0.5 * dt * k1)
    k3 = rate(state + 0.5 * dt * k2)
    k4 = rate(state + dt * k3)
    return state + dt / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)


def chained(step: Callable[[Any, Any], Any], carry: Any, controls: Any) -> Iterator[Any]:
    """Yield the carry after each step under ``controls`` (..., H, nu)."""
    for k in range(controls.shape[-2]):
        carry = step(carry, controls[..., k, :])
        yield carry


def one_run(
    system: System, states: npt.ArrayLike, past_controls: npt.ArrayLike | None, controls: npt.ArrayLike
) -> tuple[Array, Array, Array]:
    """Return one run as a batch of one: states (1, L + 1, nx), past controls (1, L, nu), controls (1, H, nu).

    ``states`` is the state (nx,) or a history (L + 1, nx), ``controls`` (H, nu), or (H,) for one control.
    """
    if np.ndim(states) == 1 and past_controls is not None and np.size(past_controls) > 0:
        raise InvalidArgument(no_times(system))  # one state has no controls before it
    history = np.atleast_2d(np.asarray(states, dtype=np.float64))
    if history.ndim != 2 or history.shape[1] != system.nx:
        raise ShapeError(
            f"states: expected one state ({system.nx},) or a history (any, {system.nx}), got {np.shape(states)}"
        )
    ahead = _columns("controls", controls, system.nu)
    neutral = np.tile(system.neutral_control, (len(history) - 1, 1))
    past = neutral if past_controls is None else _columns("past_controls", past_controls, system.nu)
    if len(past) != len(history) - 1:
        raise ShapeError(
            f"past_controls: expected {len(history) - 1}, one fewer than the states of the history, got {len(past)}"
        )
    return history[None], past[None], ahead[None]


def no_times(system: System) -> str:
    """Return a message that shows what to write instead of pysindy's ``simulate(x0, t, u)``."""
    return (
        f"simulate: expected simulate(x0, u) with one row of u for each step of {system.dt:g} s, as trained: it "
        "takes no times t and returns the states after each step, without x0. pysindy's simulate(x0, t, u) is "
        "simulate(x0, u[:-1]) here"
    )


def _columns(name: str, values: npt.ArrayLike, nu: int) -> Array:
    """Return controls as (H, nu); (H,) is accepted for one control."""
    array = np.asarray(values, dtype=np.float64)
    array = array[:, None] if array.ndim == 1 and nu == 1 else array
    if array.ndim != 2 or array.shape[1] != nu:
        raise ShapeError(f"{name}: expected shape (any, {nu}), got {np.shape(values)}")
    return array


@one_blas_thread()
def many_runs(
    model: Dynamics,
    states: npt.ArrayLike,
    past_controls: npt.ArrayLike | None,
    controls: npt.ArrayLike,
    samples: int | None,
    rng: np.random.Generator,
) -> Array:
    """Return the states (B, H, nx) of many runs, see `DynamicsModel.simulate`; with samples (samples, B, H, nx).

    A history (B, L + 1, nx) shorter than the model uses is padded, see `latest`. Raises `ShapeError`.
    """
    system = model.system
    states = check_shape("states", states, (None, None, system.nx))
    if states.shape[1] == 0:
        raise ShapeError(f"states: expected one measured state of each run or more, got {states.shape}")
    controls = check_shape("controls", controls, (len(states), None, system.nu))
    if past_controls is None:
        past_controls = np.tile(system.neutral_control, (len(states), states.shape[1] - 1, 1))
    past_controls = check_shape("past_controls", past_controls, (len(states), states.shape[1] - 1, system.nu))
    states, past_controls = latest(states, past_controls, model.n_lags + model.n_recent, system.neutral_control)
    if samples is not None:
        states, past_controls, controls = (np.tile(a, (samples, 1, 1)) for a in (states, past_controls, controls))
    batch, horizon = controls.shape[:2]

    def step(carry: Array, control: Array) -> Array:
        noise = rng.standard_normal((batch, model.n_noise)) if model.n_noise else None
        return clip_state(model.step(carry, control, noise), model.state_bounds)[0]

    draws = rng.standard_normal((batch, model.n_draws)) if model.n_draws else None
    out = np.empty((batch, horizon, system.nx))
    with np.errstate(all="ignore"):
        for k, carry in enumerate(chained(step, model.start(states, past_controls, draws), controls)):
            out[:, k] = carry[:, : system.nx]
    return out if samples is None else out.reshape(samples, batch // samples, horizon, system.nx)
