"""A free run under recorded controls: the one loop, how one run is said plainly, and how far off it is."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from sysid_evo.arrays import Array, check_shape
from sysid_evo.dynamics.stepping import clip_state
from sysid_evo.errors import InvalidData, ShapeError
from sysid_evo.system import System

if TYPE_CHECKING:
    from sysid_evo.data import Dataset, Windows
    from sysid_evo.dynamics import DynamicsModel

SECOND, FEWEST_STEPS = 1.0, 10
STRIDE = 4
MOST_WINDOWS = 10_000
"""Windows that judge a model: more of them take longer and say the same."""


def chained(step: Callable[[Any, Any], Any], carry: Any, controls: Any) -> Iterator[Any]:
    """Yield the carry after each step under ``controls`` (..., H, nu)."""
    for k in range(controls.shape[-2]):
        carry = step(carry, controls[..., k, :])
        yield carry


def one_run(
    system: System, lags: int, states: npt.ArrayLike, past_controls: npt.ArrayLike | None, controls: npt.ArrayLike
) -> tuple[Array, Array, Array]:
    """Return one run as a batch of one: states (1, L + 1, nx), past controls (1, L, nu), controls (1, H, nu).

    ``states`` is the state (nx,) or a history (L + 1, nx), ``controls`` (H, nu), or (H,) for one
    control. A history shorter than ``lags`` is padded: the first state repeated, neutral controls.
    """
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
    missing = max(0, lags + 1 - len(history))
    history = np.concatenate([np.repeat(history[:1], missing, axis=0), history])
    past = np.concatenate([np.tile(system.neutral_control, (missing, 1)), past])
    return history[None], past[None], ahead[None]


def _columns(name: str, values: npt.ArrayLike, nu: int) -> Array:
    """Return controls as (H, nu); (H,) is understood for one control."""
    array = np.asarray(values, dtype=np.float64)
    array = array[:, None] if array.ndim == 1 and nu == 1 else array
    if array.ndim != 2 or array.shape[1] != nu:
        raise ShapeError(f"{name}: expected shape (any, {nu}), got {np.shape(values)}")
    return array


def many_runs(
    model: DynamicsModel,
    states: npt.ArrayLike,
    past_controls: npt.ArrayLike | None,
    controls: npt.ArrayLike,
    samples: int | None,
    rng: np.random.Generator,
) -> Array:
    """Return the states (B, H, nx) of many runs, see `DynamicsModel.simulate`; with samples (samples, B, H, nx).

    Raises `ShapeError`, or `InvalidData` if the history (B, L + 1, nx) is shorter than the model needs.
    """
    system, lags = model.system, model.n_lags
    states = check_shape("states", states, (None, None, system.nx))
    controls = check_shape("controls", controls, (len(states), None, system.nu))
    if past_controls is None:
        past_controls = np.tile(system.neutral_control, (len(states), states.shape[1] - 1, 1))
    past_controls = check_shape("past_controls", past_controls, (len(states), states.shape[1] - 1, system.nu))
    if states.shape[1] < lags + 1:
        raise InvalidData(f"{type(model).__name__} needs {lags + 1} measured states to start, got {states.shape[1]}")
    states, past_controls = states[:, -1 - lags :], past_controls[:, past_controls.shape[1] - lags :]
    if samples is not None:
        states, past_controls, controls = (np.tile(a, (samples, 1, 1)) for a in (states, past_controls, controls))
    batch, horizon = controls.shape[:2]

    def step(carry: Array, control: Array) -> Array:
        noise = rng.standard_normal((batch, model.n_noise)) if model.n_noise else None
        return clip_state(model.step(carry, control, noise), model.envelope)[0]

    draws = rng.standard_normal((batch, model.n_draws)) if model.n_draws else None
    out = np.empty((batch, horizon, system.nx))
    with np.errstate(all="ignore"):
        for k, carry in enumerate(chained(step, model.start(states, past_controls, draws), controls)):
            out[:, k] = carry[:, : system.nx]
    return out if samples is None else out.reshape(samples, batch // samples, horizon, system.nx)


def judging_windows(
    dataset: Dataset, history: int, *, stride: int = STRIDE, seconds: float = SECOND, fewest: int = FEWEST_STEPS
) -> Windows:
    """Return windows of one second and at least ten steps, or the longest the data have, wherever the body moves.

    One starts every ``stride`` samples, of long data at larger strides, so that there are `MOST_WINDOWS` or fewer.
    """
    longest = max(len(episode) for episode in dataset.episodes) - history
    horizon = min(max(fewest, round(seconds / dataset.system.dt)), longest)
    if horizon < 1:
        raise InvalidData(f"data set: no episode is longer than {history} steps, the history asked for")
    least = -(-dataset.n_steps // MOST_WINDOWS)
    windows = dataset.windows(horizon, stride=max(stride, least), history=history, moving=True)
    return windows if len(windows) else dataset.windows(horizon, stride=least, history=history)


def simulation_error(model: DynamicsModel, windows: Windows) -> float:
    """Return the mean over channels and steps of RMSE / standard deviation of the truth, in free run.

    Steps count alike, so that neither the first nor the last alone decides. 0 is perfect, about 1 is no
    better than the mean of the truth; infinite if a state is not finite.
    """
    simulated = model.simulate(windows.past_states, windows.past_controls, windows.controls)
    return relative_error(model.system, simulated, windows)


def relative_error(system: System, simulated: Array, windows: Windows) -> float:
    """Return the mean over channels and steps of RMSE / spread of ``simulated`` (N, H, nx); inf if not finite."""
    off, spread = system.difference(simulated, windows.states), system.spread(windows.states)
    spread = np.where(spread > 0, spread, 1.0)
    with np.errstate(all="ignore"):
        error = float(np.mean(np.sqrt(np.mean(off**2, axis=0)) / spread))
    return error if np.isfinite(error) else float("inf")
