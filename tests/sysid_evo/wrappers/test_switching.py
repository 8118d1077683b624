"""Several models that take turns in a trial."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from sysid_evo.controllers import RecurrentNetwork
from sysid_evo.dynamics import DynamicsModel
from sysid_evo.engine.compiled.single_step import kernel_step
from sysid_evo.errors import IncompatibleSystem, InvalidArgument
from sysid_evo.registry import make_model
from sysid_evo.system import Channel, System
from sysid_evo.tasks import PointToPoint
from sysid_evo.testing import example_dataset
from sysid_evo.testing.closed_loop import expect_engines_agree
from sysid_evo.wrappers import DelayedEstimate, Switching
from tests.sysid_evo.made_up import Climber, SluggishCar

from .test_noise import started

LINE = System((Channel("height", "m"),), (Channel("climb", "m", -1.0, 1.0),), 0.1)


@cache
def models() -> tuple[DynamicsModel, ...]:
    kinds = ({"state_lags": 2}, {"ridge": 10.0}, {"ridge": 100.0})
    return tuple(make_model("linear", **kind).fit(example_dataset(), rng=0) for kind in kinds)


class Sinker(Climber):
    """Goes down where `Climber` goes up."""

    def step(self, carry: np.ndarray, control: np.ndarray, noise: np.ndarray | None = None) -> np.ndarray:
        return carry - control


@pytest.mark.parametrize("every", [None, 3.0, 1.0])
def test_compiled_form_steps_as_step_does(every: float | None, rng: np.random.Generator) -> None:
    switching = Switching(models(), every)
    kernel = switching.kernel()
    assert kernel is not None
    compiled = stepped = started(switching, 70, rng)
    assert stepped.shape[1] == switching.n_carry
    for _ in range(6):
        control = rng.integers(-1, 2, (70, 2)).astype(float)
        drawn = rng.standard_normal((70, switching.n_noise))
        compiled = kernel_step(kernel, compiled, control, drawn, precision="float64")
        stepped = switching.step(stepped, control, drawn)
        np.testing.assert_allclose(compiled, stepped, rtol=1e-7, atol=1e-9)


def test_engines_run_the_same_trials() -> None:
    parameters = np.random.default_rng(1).normal(0.0, 2.0, (13, 78))
    expect_engines_agree(Switching(models(), 4.0), RecurrentNetwork(), parameters, PointToPoint(horizon=60))


def test_one_model_alone_steps_as_without_the_wrapper(rng: np.random.Generator) -> None:
    alone = SluggishCar(example_dataset().system)
    switching = Switching([alone], every=2.0)
    carry = started(switching, 5, rng)
    plain = carry[:, 4:]
    for _ in range(10):
        control, noise = rng.integers(-1, 2, (5, 2)).astype(float), rng.standard_normal((5, 4))
        carry, plain = switching.step(carry, control, noise), alone.step(plain, control, noise[:, :2])
        np.testing.assert_array_equal(carry[:, 4:], plain)


def test_every_trial_has_one_model_each_as_often_as_the_others(rng: np.random.Generator) -> None:
    switching = Switching([Climber(LINE), Sinker(LINE), Climber(LINE, n_noise=1)])
    carry = started(switching, 6000, rng)
    which = carry[:, 1]
    np.testing.assert_allclose(np.bincount(which.astype(int)) / 6000, 1 / 3, atol=0.02)
    for _ in range(4):
        carry = switching.step(carry, np.ones((6000, 1)), np.zeros((6000, 1)))
    np.testing.assert_array_equal(carry[:, 1], which)
    np.testing.assert_array_equal(carry[:, 0], np.where(which == 1, -4.0, 4.0))


def test_another_model_takes_over_as_often_as_is_said_and_from_the_same_state(rng: np.random.Generator) -> None:
    switching = Switching([Climber(LINE), Sinker(LINE)], every=5.0)
    carry, changes = started(switching, 2000, rng), 0
    for _ in range(50):
        after = switching.step(carry, np.ones((2000, 1)), rng.standard_normal((2000, 2)))
        np.testing.assert_array_equal(after[:, 0] - carry[:, 0], np.where(after[:, 1] == 0, 1.0, -1.0))
        changes += int((after[:, 1] != carry[:, 1]).sum())
        carry = after
    assert 0.09 < changes / 50 / 2000 < 0.11, "every fifth sample one is drawn, half of the times the other one"


def test_models_of_different_systems_or_observed_late_are_refused() -> None:
    with pytest.raises(IncompatibleSystem, match="systems differ"):
        Switching([Climber(LINE), models()[0]])
    with pytest.raises(InvalidArgument, match="late"):
        Switching([DelayedEstimate(Climber(LINE), 0.1)])
    with pytest.raises(InvalidArgument, match="at least one"):
        Switching([])
    with pytest.raises(InvalidArgument, match="every"):
        Switching([Climber(LINE)], every=0.5)
