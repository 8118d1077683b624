"""Rollouts on the simulated device are those of the compiled form, in either precision."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from sysid_evo.engine import rollout
from sysid_evo.engine.compiled.dialect import Precision
from sysid_evo.engine.compiled.run import Kernels
from sysid_evo.engine.cuda import run
from sysid_evo.engine.rollouts import Rollouts
from sysid_evo.randomness import trial_seeds

from ..cases import CASES, Case

SEEDS = trial_seeds(5, 3)
ATOL = {"float64": 1e-9, "float32": 2e-4}


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


@pytest.mark.parametrize("name", list(CASES))
def test_a_case_is_that_of_the_compiled_form_and_of_the_reference(name: str) -> None:
    case = CASES[name]()
    given = (case.dynamics, case.controller, case.parameters, case.task, SEEDS)
    for precision in ("float64", "float32"):
        found = on_device(case, precision)
        assert found.engine == f"cuda {precision}"
        expect_equal(found, rollout(*given, engine=precision, record=True), ATOL[precision])
        if precision == "float64":
            expect_equal(found, rollout(*given, engine="reference", record=True), 1e-7)
            moved = max(np.ptp(trajectory.states, axis=0).max() for trajectory in found.trajectories)
            assert moved > 0.01, "a case that stands still proves nothing"
