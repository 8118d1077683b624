"""Rollouts on the simulated device are those of the compiled form, in either precision."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from sysid_evo.engine import rollout
from sysid_evo.engine.compiled.dialect import Precision
from sysid_evo.engine.compiled.run import Kernels
from sysid_evo.engine.cuda import run
from sysid_evo.engine.cuda.trials import prepare
from sysid_evo.engine.kernels import neighbours
from sysid_evo.engine.rollouts import Rollouts
from sysid_evo.randomness import trial_seeds
from sysid_evo.registry import make_model

from ..cases import CASES, HEAVY, Case, dataset, driven, seldom

SEEDS = trial_seeds(5, 3)
ATOL = {"float64": 1e-9, "float32": 5e-4}
BATCHES = run.batches


def given_to(case: Case) -> tuple[Any, ...]:
    """Return what `rollout` is given."""
    return case.dynamics, case.controller, case.parameters, case.task, SEEDS


def on_device(case: Case, precision: Precision, *, record: bool = True, candidates: slice = slice(None)) -> Rollouts:
    """Run a case on the device in a precision of choice."""
    task = case.task.bind(case.dynamics.system)
    controller = case.controller.bind_to(task)
    of_dynamics, of_controller, of_task = case.dynamics.kernel(), controller.kernel(), task.kernel()
    assert of_dynamics is not None
    assert of_controller is not None
    assert of_task is not None
    kernels = Kernels(of_dynamics, of_controller, of_task)
    given = (kernels, case.dynamics, controller, case.parameters[candidates], task, SEEDS)
    return Rollouts(**run.run(*given, record=record, precision=precision))


def expect_equal(found: Rollouts, expected: Rollouts, atol: float) -> None:
    """Fail unless two rollouts are the same but for rounding."""
    np.testing.assert_array_equal(found.survived, expected.survived)
    np.testing.assert_array_equal(found.clipped, expected.clipped)
    for name in ("fitness", "behaviour", "doubt"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), atol=atol, rtol=atol, err_msg=name)
    ours: Any = found.task_state
    theirs: Any = expected.task_state
    np.testing.assert_array_equal(ours.alive, theirs.alive)
    np.testing.assert_allclose(ours.pose, theirs.pose, atol=atol)
    for a, b in zip(found.trajectories, expected.trajectories, strict=True):
        assert a.name == b.name
        np.testing.assert_allclose(a.states, b.states, atol=atol, rtol=atol)
        np.testing.assert_allclose(a.controls, b.controls, atol=atol, rtol=atol)


@pytest.mark.parametrize("name", [seldom(name, HEAVY) for name in CASES])
def test_a_case_is_that_of_the_reference(name: str) -> None:
    case = CASES[name]()
    expected = rollout(*given_to(case), engine="reference", record=True)
    moved = max(np.ptp(trajectory.states, axis=0).max() for trajectory in expected.trajectories)
    assert moved > 1e-3, "a case that stands still proves nothing"
    expect_equal(on_device(case, "float64"), expected, case.loose * 1e-7)


@pytest.mark.parametrize("name", [seldom(name, CASES.keys() - {"parametrised"}) for name in CASES])
def test_a_case_is_that_of_the_compiled_form_in_either_precision(name: str) -> None:
    case = CASES[name]()
    for precision in ("float64", "float32"):
        found = on_device(case, precision)
        assert found.engine == f"cuda {precision}"
        expect_equal(found, rollout(*given_to(case), engine=precision, record=True), ATOL[precision])


def test_a_device_with_little_memory_runs_batch_after_batch(monkeypatch: pytest.MonkeyPatch) -> None:
    case = CASES["feed_forward"]()
    whole, sizes = on_device(case, "float64", record=False), []
    each = 8.0 * 3 * (4 + 1 + 7 + 10)
    monkeypatch.setattr(run, "free_memory", lambda: 1.5 * each / run.PART)
    monkeypatch.setattr(run, "batches", lambda *given: sizes.extend(found := BATCHES(*given)) or found)
    expect_equal(on_device(case, "float64", record=False), whole, 0.0)
    assert sizes == [slice(0, 1), slice(1, 2)]


def test_candidates_too_large_for_shared_memory_are_read_where_they_are(monkeypatch: pytest.MonkeyPatch) -> None:
    case = CASES["feed_forward"]()
    whole = on_device(case, "float64")
    monkeypatch.setattr(run, "SHARED_BYTES", 0)
    expect_equal(on_device(case, "float64"), whole, 0.0)


@pytest.mark.parametrize("rollouts, width", [(1, 1), (2, 2), (3, 2), (4, 4), (1_000, 4)])
def test_few_rollouts_are_spread_over_the_device_in_narrow_blocks(rollouts: int, width: int) -> None:
    case = CASES["feed_forward"]()
    task = case.task.bind(case.dynamics.system)
    controller = case.controller.bind_to(task)
    kernels: Any = Kernels(case.dynamics.kernel(), controller.kernel(), task.kernel())  # type: ignore[arg-type]
    given = prepare(kernels, case.dynamics, controller, task, SEEDS, "float32", record=False)
    assert run.launch_of(kernels, given, rollouts, "float32").width == width


def test_a_rollout_is_run_with_the_precision_of_its_kernel() -> None:
    case = CASES["feed_forward"]()
    assert rollout(*given_to(case), engine="cuda").engine == "cuda float32"


def test_a_table_of_many_points_is_searched_to_the_same_neighbour(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(neighbours, "MANY", 10)
    case = driven(make_model("nearest_neighbour").fit(dataset(), rng=np.random.default_rng(0)))
    kernel = case.dynamics.kernel()
    assert kernel is not None
    bound: Any = kernel.source
    assert bound.bindings["predict"].function is neighbours.neighbours_of_many
    expect_equal(on_device(case, "float64"), rollout(*given_to(case), engine="reference", record=True), 1e-7)
