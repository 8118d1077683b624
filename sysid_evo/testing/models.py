"""The contracts of a model family and of an adapter, and checks of any `Dynamics`."""

from __future__ import annotations

import copy
import re
import sys
import tempfile
import warnings
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from sklearn.base import clone

from sysid_evo.carry import clip_state
from sysid_evo.data.dataset import Dataset
from sysid_evo.engine.compiled.open_loop import kernel_step
from sysid_evo.errors import NotFitted
from sysid_evo.models.adapters import Adapter, as_spec, family_name, plain_parameters
from sysid_evo.models.base import DynamicsModel, make_model
from sysid_evo.models.dynamics import Dynamics, started
from sysid_evo.models.learned import check_learned
from sysid_evo.models.storage import load_model, save_model
from sysid_evo.progress import Progress
from sysid_evo.registry.objects import keep_object
from sysid_evo.registry.registry import adapters, models
from sysid_evo.testing.contract import (
    Contract,
    copied,
    expect,
    expect_error,
    expect_kernel,
    expect_pure,
    mismatched_rows,
    normal,
    same,
)
from sysid_evo.testing.examples import example_dataset
from sysid_evo.types import Array, IntArray

CHAINED_STEPS = 10
COMPILED_TOLERANCE = {"float64": 1e-7, "float32": 1e-3}
"""Tolerance relative to a number plus the largest of its column."""


def check_model(name: str, dataset: Dataset | None = None, **parameters: object) -> None:
    """Fit the registered family ``name`` and raise `ContractViolation` with all broken rules."""
    MODEL.check(name, dataset, **parameters)


def _prepared(name: str, dataset: Dataset | None = None, **parameters: object) -> tuple[DynamicsModel, Dataset]:
    """Return an unfitted model of the family ``name`` and the data set, by default `example_dataset`.

    ``parameters`` go to the constructor; other parameters come from the ``quick`` preset. Raises `IncompatibleSystem`
    if the family refuses the system of ``dataset``.
    """
    dataset = example_dataset() if dataset is None else dataset
    family: Any = models.get(name)
    model = make_model(name, **{**family.presets.get("quick", {}), **parameters})
    model.check_system(dataset.system)
    return model, dataset


def an_unfitted_model_raises_an_error(model: DynamicsModel, dataset: Dataset) -> None:
    """A model that is not fitted raises NotFitted"""
    nx, nu = dataset.system.nx, dataset.system.nu
    zeros = np.zeros((1, 1, nx)), np.zeros((1, 0, nu)), np.zeros((1, 1, nu))
    expect_error(NotFitted, "simulate before fit", model.simulate, *zeros)


def fit_returns_the_model_itself(model: DynamicsModel, dataset: Dataset) -> None:
    """fit does not change the recording and returns the model itself"""
    fingerprint = dataset.fingerprint
    expect(model.fit(dataset, rng=np.random.default_rng(1)) is model, "fit must return self")
    expect(dataset.with_episodes(dataset.episodes).fingerprint == fingerprint, "fit overwrites the recording")


def fit_reports_progress_and_can_be_stopped(model: DynamicsModel, dataset: Dataset) -> None:
    """fit reports progress, and an exception from progress stops it and leaves the model unchanged"""
    reported: list[tuple[int, int]] = []
    rng = np.random.default_rng

    def stopping(after: int) -> Progress:
        calls = iter(range(after + 1))

        def progress(*_: object, **__: object) -> None:
            if next(calls, None) == after:
                raise _Stopped

        return progress

    clone(model).fit(dataset, rng=rng(1), progress=lambda done, total: reported.append((done, total)))
    whole = (
        len(reported) >= 2
        and reported[-1][0] == reported[-1][1]
        and all(0 <= done <= total for done, total in reported)
    )
    expect(whole, f"expected progress from 0 to the total, got {reported[:3]} ... {reported[-3:]}")
    unfitted, fitted = clone(model), copy.copy(model)
    inputs = _some_inputs(model, dataset)
    expected = step(model, inputs)
    for start, after in ((unfitted, 0), (unfitted, len(reported) // 2), (fitted, len(reported) // 2)):
        before = set(vars(start))
        not_stopped = "an exception from progress does not stop the fit"
        expect_error(_Stopped, not_stopped, start.fit, dataset, rng=rng(1), progress=stopping(after))
        expect(set(vars(start)) == before, f"a stopped fit leaves {sorted(set(vars(start)) ^ before)} behind")
    expect(same(step(fitted, inputs), expected), "a fitted model steps differently after a second fit was stopped")


class _Stopped(Exception):
    """Raised from progress by the check of interruption."""


def a_step_has_the_right_shape_and_type(model: DynamicsModel, dataset: Dataset) -> None:
    """step returns a carry of the same shape (B, n_carry), finite and in float64"""
    expect_shape_and_type(model, _some_inputs(model, dataset))


def the_carry_begins_with_the_state(model: DynamicsModel, dataset: Dataset) -> None:
    """The first nx numbers of the carry are the state"""
    windows = dataset.windows(1, history=model.n_lags)
    carry = model.start(windows.past_states, windows.past_controls, normal(model.n_draws, len(windows)))
    begins = same(carry[:, : dataset.system.nx], windows.start_states)
    expect(begins, "carry[:, :nx] after start is not the last measured state")


def rows_are_independent(model: DynamicsModel, dataset: Dataset) -> None:
    """The result of a row does not depend on the other rows of its batch"""
    expect_independent_rows(model, _some_inputs(model, dataset))


def a_step_is_pure(model: DynamicsModel, dataset: Dataset) -> None:
    """step changes neither its arguments nor its later results"""
    expect_pure_step(model, _some_inputs(model, dataset))


def simulation_equals_chained_steps(model: DynamicsModel, dataset: Dataset) -> None:
    """A simulation equals its steps one after the other"""
    windows = dataset.windows(5, stride=20, history=model.n_lags)
    simulated = model.simulate(
        windows.past_states, windows.past_controls, windows.controls, rng=np.random.default_rng(2)
    )
    rng = np.random.default_rng(2)
    carry = model.start(windows.past_states, windows.past_controls, normal(model.n_draws, len(windows), rng))
    for k in range(5):
        carry = model.step(carry, windows.controls[:, k], normal(model.n_noise, len(windows), rng))
        if model.state_bounds is not None:
            state = np.clip(carry[:, : dataset.system.nx], *model.state_bounds)
            carry = np.concatenate([state, carry[:, dataset.system.nx :]], axis=1)
        if not np.isfinite(carry).all():
            return  # another check reports it
        expect(np.allclose(carry[:, : dataset.system.nx], simulated[:, k]), f"they differ at step {k + 1}")


def the_same_seed_fits_the_same_model(model: DynamicsModel, dataset: Dataset) -> None:
    """The same data and seed give the same model"""
    again = clone(model).fit(dataset, rng=np.random.default_rng(1))
    inputs = _some_inputs(model, dataset)
    expect(same(step(model, inputs), step(again, inputs)), "two fits with the same seed step differently")


def a_long_recording_is_thinned(model: DynamicsModel, dataset: Dataset) -> None:
    """fit uses part of a recording longer than max_steps; a warning and fit_note report how much"""
    if "max_steps" not in model.get_params(deep=False):
        return
    short = clone(model).set_params(max_steps=dataset.n_steps // 2)
    with warnings.catch_warnings(record=True) as given:
        warnings.simplefilter("always")
        short.fit(dataset, rng=np.random.default_rng(1))
    part = f"of {dataset.n_steps:,} steps"
    reported = part in short.fit_note and any(part in str(one.message) for one in given)
    expect(reported, f"fit_note is {short.fit_note!r} after a fit with max_steps={short.max_steps}")


def parameters_survive_clone(model: DynamicsModel, _: Dataset) -> None:
    """get_params and clone return the constructor's arguments; a clone is not fitted"""
    copy = clone(model)
    expect(copy.get_params() == model.get_params(), f"expected {model.get_params()}, got {copy.get_params()}")
    expect(not hasattr(copy, "system_"), "a clone must not be fitted")


def saving_and_loading_keeps_every_step(model: DynamicsModel, dataset: Dataset) -> None:
    """A model that is saved and loaded steps bit for bit the same"""
    inputs = _some_inputs(model, dataset)
    with tempfile.TemporaryDirectory() as folder:
        save_model(model, Path(folder) / "model")
        loaded = load_model(Path(folder) / "model")
    expect(same(step(loaded, inputs), step(model, inputs)), "it steps differently after loading")
    before, after = model.get_params(), loaded.get_params()
    expect(after == before, f"its parameters were {before} and are now {after}")


def learned_arrays_declares_what_was_learned(model: DynamicsModel, _: Dataset) -> None:
    """Learned arrays match learned_arrays; a family that declares arrays declares all of them"""
    undeclared = check_learned(model)
    complete = not undeclared or "learned_arrays" not in vars(type(model))
    expect(complete, f"learned_arrays does not declare {', '.join(undeclared)}")


def the_compiled_form_steps_as_step_does(model: DynamicsModel, dataset: Dataset) -> None:
    """The compiled form gives the results of step"""
    resting = started(model, dataset.system.neutral_state[None], normal(model.n_draws, 1))
    expect_same_compiled(model, _some_inputs(model, dataset).followed_by(resting, dataset.system.neutral_control[None]))


CHECKS = (
    an_unfitted_model_raises_an_error,
    fit_returns_the_model_itself,
    fit_reports_progress_and_can_be_stopped,
    a_step_has_the_right_shape_and_type,
    the_carry_begins_with_the_state,
    rows_are_independent,
    a_step_is_pure,
    simulation_equals_chained_steps,
    the_compiled_form_steps_as_step_does,
    the_same_seed_fits_the_same_model,
    a_long_recording_is_thinned,
    parameters_survive_clone,
    saving_and_loading_keeps_every_step,
    learned_arrays_declares_what_was_learned,
)
MODEL = Contract(models, _prepared, CHECKS, decisive=fit_returns_the_model_itself)


def check_adapter(name: str, **parameters: object) -> None:
    """Raise `ContractViolation` with all rules that the registered adapter ``name`` breaks."""
    ADAPTER.check(name, **parameters)


def _adapter(name: str, **parameters: object) -> tuple[Adapter]:
    return (adapters.make(name, **parameters),)


def _example(adapter: Adapter) -> Any:
    """Return a new object of the expression ``example``, after an import of the modules that it names."""
    known = dict(vars(sys.modules[type(adapter).__module__]))
    for module in re.findall(r"([a-z_]\w*(?:\.[a-z_]\w*)*)\.\w+\(", adapter.example):
        import_module(module)
        known[module.partition(".")[0]] = sys.modules[module.partition(".")[0]]
    return eval(adapter.example, known)


def it_recognises_its_example(adapter: Adapter) -> None:
    """It recognises the object that its example makes"""
    expect(adapter.recognises(_example(adapter)) is True, f"it does not recognise {adapter.example}")


def it_recognises_nothing_else(adapter: Adapter) -> None:
    """It recognises no text, number, array, list or model"""
    for other in ("narx", 1.0, np.zeros(3), [0.0], None, make_model("linear")):
        expect(not adapter.recognises(other), f"it recognises a {type(other).__name__}")


def no_other_adapter_recognises_it(adapter: Adapter) -> None:
    """No other adapter recognises its example"""
    thing = _example(adapter)
    others = (name for name, kind in adapters.load_all() if kind is not type(adapter) and kind().recognises(thing))
    expect((other := next(others, None)) is None, f"adapter {other!r} also recognises {adapter.example}")


def it_makes_an_unfitted_model(adapter: Adapter) -> None:
    """It makes an unfitted model of a registered family"""
    model = adapter.model(_example(adapter))
    expect(isinstance(model, DynamicsModel), f"expected a DynamicsModel, got a {type(model).__name__}")
    expect(not hasattr(model, "system_"), f"expected an unfitted model, got a fitted {family_name(model)}")


def its_model_can_be_written(adapter: Adapter) -> None:
    """The spec of its model makes the same model"""
    model = adapter.model(_example(adapter))
    again = make_model(str(as_spec(model)))
    expect(plain_parameters(again) == plain_parameters(model), f"{as_spec(model)} makes another model")


def a_copy_has_the_same_text(adapter: Adapter) -> None:
    """A copy of an object gives the same spec"""
    thing = _example(adapter)
    first, second = (str(as_spec(adapter.model(one))) for one in (thing, copy.deepcopy(thing)))
    expect(first == second, f"{first} and {second}")


def the_object_is_unchanged(adapter: Adapter) -> None:
    """It does not change the object"""
    thing = _example(adapter)
    before = keep_object(thing, adapter.content(thing))
    adapter.model(thing)
    expect(keep_object(thing, adapter.content(thing)) == before, "the object has changed")


ADAPTER = Contract(
    adapters,
    _adapter,
    (
        it_recognises_its_example,
        it_recognises_nothing_else,
        no_other_adapter_recognises_it,
        it_makes_an_unfitted_model,
        its_model_can_be_written,
        a_copy_has_the_same_text,
        the_object_is_unchanged,
    ),
)


def _some_inputs(model: DynamicsModel, dataset: Dataset) -> StepInputs:
    windows = dataset.windows(1, stride=7, history=model.n_lags)
    carry = model.start(windows.past_states, windows.past_controls, normal(model.n_draws, len(windows)))
    return StepInputs(carry, windows.controls[:, 0], normal(model.n_noise, len(windows)))


@dataclass(frozen=True)
class StepInputs:
    """Arguments of a step: carries (B, n_carry), controls (B, nu) and noise (B, n_noise) or None."""

    carry: Array
    control: Array
    noise: Array | None

    def rows(self, rows: IntArray | slice) -> StepInputs:
        """Return some of the rows."""
        return StepInputs(self.carry[rows], self.control[rows], None if self.noise is None else self.noise[rows])

    def followed_by(self, carry: Array, control: Array) -> StepInputs:
        """Return these inputs with further rows, which get the noise of the first rows."""
        noise = None if self.noise is None else np.concatenate([self.noise, self.noise[: len(carry)]])
        return StepInputs(np.concatenate([self.carry, carry]), np.concatenate([self.control, control]), noise)


def step(dynamics: Dynamics, inputs: StepInputs) -> Array:
    """Return the next carry (B, n_carry), with copies of ``inputs`` as arguments."""
    return dynamics.step(*copied((inputs.carry, inputs.control, inputs.noise)))


def expect_shape_and_type(dynamics: Dynamics, inputs: StepInputs) -> None:
    """Raise `ContractViolation` unless a step gives finite carries of the same shape, in float64."""
    carry, after = inputs.carry, step(dynamics, inputs)
    given = carry.shape[1]
    expect(given == dynamics.n_carry, f"start returns a carry of {given} numbers, n_carry is {dynamics.n_carry}")
    sound = after.shape == carry.shape and after.dtype == np.float64
    expect(sound, f"expected {carry.shape} float64, got {after.shape} {after.dtype}")
    expect(np.isfinite(after).all(), "a step from a training state is not finite")


def expect_independent_rows(dynamics: Dynamics, inputs: StepInputs) -> None:
    """Raise `ContractViolation` if the result of a row depends on the other rows of its batch."""
    together = step(dynamics, inputs)
    alone = np.concatenate([step(dynamics, inputs.rows(slice(i, i + 1))) for i in range(len(inputs.carry))])
    back = np.arange(len(inputs.carry))[::-1]
    backwards = step(dynamics, inputs.rows(back))[back]
    equal = np.allclose(together, alone, rtol=1e-9, atol=1e-12, equal_nan=True)
    equal = equal and np.allclose(together, backwards, rtol=1e-9, equal_nan=True)
    expect(equal, "a row's result changes with the other rows of its batch")


def expect_pure_step(dynamics: Dynamics, inputs: StepInputs) -> None:
    """Raise `ContractViolation` if a step changes its arguments or its later results."""
    expect_pure("step", dynamics.step, inputs.carry, inputs.control, inputs.noise)


def expect_same_compiled(dynamics: Dynamics, inputs: StepInputs) -> None:
    """Raise `ContractViolation` if the compiled form and `step` differ, `NotApplicable` as in `expect_kernel`."""
    kernel = expect_kernel(dynamics.kernel())
    carry, control, noise = inputs.carry, inputs.control, inputs.noise
    stepped = step(dynamics, inputs)
    compiled = kernel_step(kernel, carry, control, noise, precision="float64")
    off = mismatched_rows(compiled, stepped, COMPILED_TOLERANCE["float64"])
    expect(not off.any(), f"{off.sum()} of {len(off)} rows differ after one step in float64")
    compiled = stepped = carry
    for _ in range(CHAINED_STEPS):
        compiled = kernel_step(kernel, compiled, control, noise, precision=kernel.precision)
        compiled, _ = clip_state(compiled, dynamics.state_bounds)
        stepped, _ = clip_state(dynamics.step(stepped, control, noise), dynamics.state_bounds)
    off = mismatched_rows(compiled, stepped, COMPILED_TOLERANCE[kernel.precision])
    few = off.mean() <= 0.1  # rows with two equally near neighbours may differ
    expect(few, f"{off.sum()} of {len(off)} rows differ after {CHAINED_STEPS} steps in {kernel.precision}")
