"""The contract of a model family as a test suite: what plugin authors run, and what CI runs.

Each check is a function of a fitted model and the data it was fitted to; its docstring is the
sentence that must hold. A broken one raises `ContractViolation`.
"""

from __future__ import annotations

import copy
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import numpy as np
from sklearn.base import clone

from sysid_evo.arrays import Array, BoolArray
from sysid_evo.data import Dataset
from sysid_evo.dynamics import DynamicsModel, clip_state
from sysid_evo.errors import ContractViolation, NotFitted
from sysid_evo.motion import PlanarBody
from sysid_evo.progress import Progress
from sysid_evo.registry import make_model, models
from sysid_evo.store import load_model, save_model
from sysid_evo.system import Channel, System

Check: TypeAlias = Callable[[DynamicsModel, Dataset], None]

CHAINED_STEPS = 10
COMPILED_TOLERANCE = {"float64": 1e-7, "float32": 1e-3}
"""Of a number and of the largest in its column."""


@dataclass(frozen=True)
class CheckResult:
    """One check: its sentence, and why it failed (None if it holds)."""

    sentence: str
    failure: str | None


def check_model(name: str, dataset: Dataset | None = None, **parameters: object) -> None:
    """Fit the registered family ``name`` and raise `ContractViolation` listing every broken sentence."""
    broken = [result for result in run_checks(name, dataset, **parameters) if result.failure is not None]
    if broken:
        lines = "\n".join(f"- {result.sentence}: {result.failure}" for result in broken)
        raise ContractViolation(f"model {name!r} breaks {len(broken)} of the contract's sentences:\n{lines}")


def run_checks(name: str, dataset: Dataset | None = None, **parameters: object) -> Iterator[CheckResult]:
    """Yield the result of every check of the registered family ``name``, fitted to ``dataset``.

    Without a data set the checks use `example_dataset`. ``parameters`` go to the constructor; the
    family's ``quick`` preset holds for the others. If it cannot be fitted, that is the last result.
    Raises `IncompatibleSystem` if the family refuses the system of ``dataset``.
    """
    dataset = example_dataset() if dataset is None else dataset
    quick = dict(models.get(name).presets.get("quick", {}))  # type: ignore[attr-defined]  # a class, not any factory
    model = make_model(name, **{**quick, **parameters})
    model.check_system(dataset.system)
    yield _run(an_unfitted_model_says_so, model, dataset)
    fitted = _run(fit_returns_the_model_itself, model, dataset)
    yield fitted
    for check in CHECKS if fitted.failure is None else ():
        yield _run(check, model, dataset)


def example_dataset(seed: int = 0, episodes: int = 3, steps: int = 200) -> Dataset:
    """Return a small recording of a made-up car with drag, thrust and steering, and a little noise."""
    system = System(
        states=(Channel("forward_speed", "m/s"), Channel("lateral_speed", "m/s"), Channel("yaw_rate", "rad/s")),
        controls=(Channel("drive", levels=(-1.0, 0.0, 1.0)), Channel("steer", levels=(-1.0, 0.0, 1.0))),
        dt=0.05,
        motion=PlanarBody(),
        name="made-up car",
    )
    rng = np.random.default_rng(seed)
    states = np.zeros((episodes, steps + 1, system.nx))
    controls = np.repeat(rng.integers(-1, 2, (episodes, steps // 5 + 1, 2)), 5, axis=1)[:, :steps].astype(float)
    for k in range(steps):
        u, v, r = states[:, k].T
        drive, steer = controls[:, k].T
        acceleration = np.stack([3.0 * drive - 1.5 * u, -5.0 * v + 0.2 * u * r, 4.0 * u * steer - 3.0 * r], axis=1)
        noise = 0.01 * rng.standard_normal((episodes, system.nx))
        states[:, k + 1] = system.integrate(states[:, k], acceleration) + noise
    return Dataset.from_arrays(system, list(states), list(controls))


def an_unfitted_model_says_so(model: DynamicsModel, dataset: Dataset) -> None:
    """A model that is not fitted says so instead of failing somewhere inside"""
    try:
        model.simulate(
            np.zeros((1, 1, dataset.system.nx)),
            np.zeros((1, 0, dataset.system.nu)),
            np.zeros((1, 1, dataset.system.nu)),
        )
    except NotFitted:
        return
    raise ContractViolation("simulate before fit should raise NotFitted")


def fit_returns_the_model_itself(model: DynamicsModel, dataset: Dataset) -> None:
    """fit learns from a recording, leaves it as it is, and returns the model itself"""
    fingerprint = dataset.fingerprint
    if model.fit(dataset, rng=np.random.default_rng(1)) is not model:
        raise ContractViolation("fit must return self")
    if dataset.with_episodes(dataset.episodes).fingerprint != fingerprint:
        raise ContractViolation("fit overwrites the recording")


def fit_tells_and_can_be_stopped(model: DynamicsModel, dataset: Dataset) -> None:
    """fit says how far it is, and what progress raises stops it and leaves the model as it was"""
    told: list[tuple[int, int]] = []
    rng = np.random.default_rng

    def stopping(after: int) -> Progress:
        calls = iter(range(after + 1))

        def progress(*_: int, **__: int) -> None:
            if next(calls, None) == after:
                raise _Stopped

        return progress

    clone(model).fit(dataset, rng=rng(1), progress=lambda done, total: told.append((done, total)))
    if len(told) < 2 or told[-1][0] != told[-1][1] or any(not 0 <= done <= total for done, total in told):
        raise ContractViolation(f"expected progress from 0 to all of the steps, got {told[:3]} ... {told[-3:]}")
    unfitted, fitted = clone(model), copy.copy(model)
    carry, control, noise = _some_inputs(model, dataset)
    expected = model.step(carry, control, noise)
    for start, after in ((unfitted, 0), (unfitted, len(told) // 2), (fitted, len(told) // 2)):
        before = set(vars(start))
        try:
            start.fit(dataset, rng=rng(1), progress=stopping(after))
        except _Stopped:
            if set(vars(start)) != before:
                raise ContractViolation(f"a stopped fit leaves {sorted(set(vars(start)) ^ before)} behind") from None
        else:
            raise ContractViolation("an exception from progress does not stop the fit")
    if not np.array_equal(fitted.step(carry, control, noise), expected):
        raise ContractViolation("a fitted model steps differently after a second fit was stopped")


class _Stopped(Exception):
    """What the check of interruption raises from progress."""


def a_step_has_the_right_shape_and_type(model: DynamicsModel, dataset: Dataset) -> None:
    """A step turns a carry (B, n_carry) into a carry of the same shape, in float64"""
    carry, control, noise = _some_inputs(model, dataset)
    after = model.step(carry, control, noise)
    if carry.shape[1] != model.n_carry:
        raise ContractViolation(f"start gives a carry of {carry.shape[1]} numbers, n_carry says {model.n_carry}")
    if after.shape != carry.shape or after.dtype != np.float64:
        raise ContractViolation(f"expected {carry.shape} float64, got {after.shape} {after.dtype}")
    if not np.isfinite(after).all():
        raise ContractViolation("a step from a training state is not finite")


def the_carry_begins_with_the_state(model: DynamicsModel, dataset: Dataset) -> None:
    """The carry begins with the state"""
    windows = dataset.windows(1, history=model.n_lags)
    carry = model.start(windows.past_states, windows.past_controls, _normal(model.n_draws, len(windows)))
    if not np.array_equal(carry[:, : dataset.system.nx], windows.start_states):
        raise ContractViolation("carry[:, :nx] after start is not the last measured state")


def rows_are_independent(model: DynamicsModel, dataset: Dataset) -> None:
    """Every row of a batch is computed for itself"""
    carry, control, noise = _some_inputs(model, dataset)
    together = model.step(carry, control, noise)
    rows = [np.array([i]) for i in range(len(carry))]
    alone = np.concatenate([model.step(carry[i], control[i], None if noise is None else noise[i]) for i in rows])
    back = np.arange(len(carry))[::-1]
    backwards = model.step(carry[back], control[back], None if noise is None else noise[back])[back]
    if not (np.allclose(together, alone, rtol=1e-9, atol=1e-12) and np.allclose(together, backwards, rtol=1e-9)):
        raise ContractViolation("a row's result changes with the other rows of its batch")


def a_step_is_pure(model: DynamicsModel, dataset: Dataset) -> None:
    """A step changes neither its arguments nor its own later results"""
    carry, control, noise = _some_inputs(model, dataset)
    kept = carry.copy(), control.copy()
    first, second = model.step(carry, control, noise), model.step(carry, control, noise)
    if not (np.array_equal(carry, kept[0]) and np.array_equal(control, kept[1])):
        raise ContractViolation("step overwrites its arguments")
    if not np.array_equal(first, second):
        raise ContractViolation("the same step twice gives two results")


def free_run_equals_chained_steps(model: DynamicsModel, dataset: Dataset) -> None:
    """A free run equals its steps one after the other"""
    windows = dataset.windows(5, stride=20, history=model.n_lags)
    simulated = model.simulate(
        windows.past_states, windows.past_controls, windows.controls, rng=np.random.default_rng(2)
    )
    rng = np.random.default_rng(2)
    carry = model.start(windows.past_states, windows.past_controls, _normal(model.n_draws, len(windows), rng))
    for k in range(5):
        carry = model.step(carry, windows.controls[:, k], _normal(model.n_noise, len(windows), rng))
        if model.envelope is not None:
            state = np.clip(carry[:, : dataset.system.nx], *model.envelope)
            carry = np.concatenate([state, carry[:, dataset.system.nx :]], axis=1)
        if not np.allclose(carry[:, : dataset.system.nx], simulated[:, k]):
            raise ContractViolation(f"they differ at step {k + 1}")


def the_same_seed_fits_the_same_model(model: DynamicsModel, dataset: Dataset) -> None:
    """The same data and seed give the same model"""
    again = clone(model).fit(dataset, rng=np.random.default_rng(1))
    carry, control, noise = _some_inputs(model, dataset)
    if not np.array_equal(model.step(carry, control, noise), again.step(carry, control, noise)):
        raise ContractViolation("two fits with the same seed step differently")


def parameters_survive_clone(model: DynamicsModel, _: Dataset) -> None:
    """get_params and clone give back the constructor's arguments, unfitted"""
    copy = clone(model)
    if copy.get_params() != model.get_params():
        raise ContractViolation(f"expected {model.get_params()}, got {copy.get_params()}")
    if hasattr(copy, "system_"):
        raise ContractViolation("a clone must not be fitted")


def saving_and_loading_keeps_every_step(model: DynamicsModel, dataset: Dataset) -> None:
    """A stored model steps bit for bit as before"""
    carry, control, noise = _some_inputs(model, dataset)
    with tempfile.TemporaryDirectory() as folder:
        save_model(model, Path(folder) / "model")
        loaded = load_model(Path(folder) / "model")
    if not np.array_equal(loaded.step(carry, control, noise), model.step(carry, control, noise)):
        raise ContractViolation("it steps differently after loading")
    if loaded.get_params() != model.get_params():
        raise ContractViolation(f"its parameters were {model.get_params()} and are now {loaded.get_params()}")


def the_compiled_form_steps_as_step_does(model: DynamicsModel, dataset: Dataset) -> None:
    """The compiled form steps as step does"""
    kernel = model.kernel()
    if kernel is None:
        return
    from sysid_evo.engine.compiled.single_step import kernel_step

    carry, control, noise = _some_inputs(model, dataset)
    resting = np.concatenate([_at_rest(model, 1), _after_a_pulse(model)])
    idle = np.tile(dataset.system.neutral_control, (2, 1))
    carry, control = np.concatenate([carry, resting]), np.concatenate([control, idle])
    noise = None if noise is None else np.concatenate([noise, noise[:2]])
    stepped = model.step(carry, control, noise)
    compiled = kernel_step(kernel, carry, control, noise, precision="float64")
    off = _rows_off(compiled, stepped, COMPILED_TOLERANCE["float64"])
    if off.any():
        raise ContractViolation(f"{off.sum()} of {len(off)} rows differ after one step in float64")
    compiled = stepped = carry
    for _ in range(CHAINED_STEPS):
        compiled = kernel_step(kernel, compiled, control, noise, precision=kernel.precision)
        compiled, _ = clip_state(compiled, model.envelope)
        stepped, _ = clip_state(model.step(stepped, control, noise), model.envelope)
    off = _rows_off(compiled, stepped, COMPILED_TOLERANCE[kernel.precision])
    if off.mean() > 0.1:  # a few may: two neighbours as near as each other
        raise ContractViolation(
            f"{off.sum()} of {len(off)} rows differ after {CHAINED_STEPS} steps in {kernel.precision}"
        )


def a_model_at_rest_stays_at_rest(model: DynamicsModel, dataset: Dataset) -> None:
    """A model at rest with neutral control stays at rest, where rest_hold is on"""
    band = model.rest_band
    if band is None:
        return
    system = dataset.system
    carry = _at_rest(model, 2)
    carry[1, : system.nx] += 0.9 * band
    idle = np.tile(system.neutral_control, (2, 1))
    for _ in range(CHAINED_STEPS):
        carry = model.step(carry, idle, _normal(model.n_noise, 2))
        if not np.array_equal(carry[:, : system.nx], np.tile(system.neutral_state, (2, 1))):
            raise ContractViolation("it moves off by itself")


def a_pulse_that_has_yet_to_act_is_not_swallowed(model: DynamicsModel, dataset: Dataset) -> None:
    """A body at rest answers to a pulse that ended before it acts, where rest_hold is on"""
    carry, noise = _after_a_pulse(model), _normal(model.n_noise, 1)
    if not model.rest_hold or np.array_equal(carry, _at_rest(model, 1)):
        return
    idle = dataset.system.neutral_control[None]
    free = copy.copy(model).set_params(rest_hold=False)
    if not np.array_equal(model.step(carry, idle, noise), free.step(carry, idle, noise)):
        raise ContractViolation("it is held although an earlier control in its carry is not neutral")


CHECKS: tuple[Check, ...] = (
    fit_tells_and_can_be_stopped,
    a_step_has_the_right_shape_and_type,
    the_carry_begins_with_the_state,
    rows_are_independent,
    a_step_is_pure,
    free_run_equals_chained_steps,
    the_compiled_form_steps_as_step_does,
    a_model_at_rest_stays_at_rest,
    a_pulse_that_has_yet_to_act_is_not_swallowed,
    the_same_seed_fits_the_same_model,
    parameters_survive_clone,
    saving_and_loading_keeps_every_step,
)


def _some_inputs(model: DynamicsModel, dataset: Dataset) -> tuple[Array, Array, Array | None]:
    windows = dataset.windows(1, stride=7, history=model.n_lags)
    carry = model.start(windows.past_states, windows.past_controls, _normal(model.n_draws, len(windows)))
    return carry, windows.controls[:, 0], _normal(model.n_noise, len(windows))


def _at_rest(model: DynamicsModel, rows: int) -> Array:
    """Return the carry (rows, n_carry) of a body that has always rested."""
    system, lags = model.system, model.n_lags
    states, controls = (
        np.tile(system.neutral_state, (rows, lags + 1, 1)),
        np.tile(system.neutral_control, (rows, lags, 1)),
    )
    return model.start(states, controls, _normal(model.n_draws, rows))


def _after_a_pulse(model: DynamicsModel) -> Array:
    """Return the carry (1, n_carry) of a body at rest whose commands until now were not neutral."""
    system, lags = model.system, model.n_lags
    controls = np.tile(system.neutral_control + 1.0, (1, lags, 1))
    return model.start(np.tile(system.neutral_state, (1, lags + 1, 1)), controls, _normal(model.n_draws, 1))


def _rows_off(found: Array, expected: Array, tolerance: float) -> BoolArray:
    """Return which rows of (B, n) differ by more than ``tolerance`` times the number plus its column's largest."""
    size = np.abs(expected)
    return (np.abs(found - expected) > tolerance * (size + size.max(axis=0))).any(axis=1)


def _normal(count: int, rows: int, rng: np.random.Generator | None = None) -> Array | None:
    """Return standard normal numbers (rows, count), or None if the model takes none."""
    rng = np.random.default_rng(3) if rng is None else rng
    return rng.standard_normal((rows, count)) if count else None


def _run(check: Check, model: DynamicsModel, dataset: Dataset) -> CheckResult:
    sentence = (check.__doc__ or check.__name__).strip()
    try:
        check(model, dataset)
    except ContractViolation as error:
        return CheckResult(sentence, str(error))
    except Exception as error:  # a plugin may fail in any way: that is what is being found out
        return CheckResult(sentence, f"{type(error).__name__}: {error}")
    return CheckResult(sentence, None)
