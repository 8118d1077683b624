"""A motion without a compiled form: its systems run in NumPy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from sysid_evo.data import Dataset
from sysid_evo.engine import rollout
from sysid_evo.errors import InvalidArgument
from sysid_evo.kernels import LANES, DynamicsKernel, Predictor
from sysid_evo.models import DynamicsModel
from sysid_evo.models.kernels.stepping import stepping_kernel
from sysid_evo.motion import Motion
from sysid_evo.system import System
from sysid_evo.types import Array
from tests.sysid_evo.engine.compiled_ladder import CompiledConstant, CompiledLadder, seeds_from

pytestmark = pytest.mark.filterwarnings("ignore::sysid_evo.errors.DataWarning")  # the data are one step


@dataclass(frozen=True)
class Slipping(Motion):
    """A body on a pole that keeps half of every height it gains."""

    kind = "slipping"
    n_pose = 0
    pose_names = ()
    pose_units = ()

    speed: str = "height"

    def roles(self) -> dict[str, str]:
        return {"speed": self.speed}

    def acceleration(self, before: Array, after: Array, dt: float, names: Sequence[str]) -> Array:
        return 2.0 * (after - before) / dt

    def integrate(self, state: Array, acceleration: Array, dt: float, names: Sequence[str]) -> Array:
        return state + 0.5 * acceleration * dt

    def turning(self, state: Array, names: Sequence[str]) -> Array:
        return np.zeros_like(state)

    def move(self, pose: Array, before: Array, after: Array, dt: float, names: Sequence[str]) -> Array:
        return pose


def push(x, u, p, y, scratch):
    for lane in range(LANES):
        y[lane] = 10.0 * u[lane]


class Pushed(DynamicsModel):
    """The acceleration is ten times the control, known exactly, with a kernel where the motion has one."""

    def fit(self, dataset: Dataset, **keywords: Any) -> Pushed:
        return self

    def acceleration(self, carry: Array, control: Array) -> Array:
        return 10.0 * control

    def kernel(self) -> DynamicsKernel | None:
        return stepping_kernel(Predictor(push, np.zeros(1), 0), self.system, output="acceleration")


def on(system: System) -> Pushed:
    data = Dataset.from_arrays(system, [np.array([[0.0], [100.0]])], [np.zeros((1, 1))])
    return Pushed().fit(data, rng=np.random.default_rng(0))


def test_auto_takes_the_reference_form_and_agrees_with_a_simulation(ladder: System) -> None:
    slipping = System(ladder.states, ladder.controls, ladder.dt, Slipping())
    model, parameters = on(slipping), np.array([[0.25], [0.75]])
    given = (model, CompiledConstant(), parameters, CompiledLadder(horizon=40, top=12.5), seeds_from(0, 8))
    found = rollout(*given, record=True)
    assert found.engine == "reference"
    np.testing.assert_array_equal(found.fitness, [[40, 37], [34, 13]])  # half of 0.25 or 0.75 gained in each step
    for run in found.trajectories:
        again = model.simulate(run.states[None, :1], run.controls[None, :0], run.controls[None])
        np.testing.assert_allclose(again[0], run.states[1:], rtol=1e-12)


def test_the_same_model_without_that_motion_is_compiled_and_goes_twice_as_far(ladder: System) -> None:
    given = (CompiledConstant(), np.array([[0.25]]), CompiledLadder(horizon=40, top=12.5), seeds_from(0, 8))
    run = rollout(on(ladder), *given)
    assert run.engine == "compiled float32"
    np.testing.assert_array_equal(run.fitness, [[40, 19]])


def test_a_compiled_form_that_does_not_exist_is_refused_when_it_is_asked_for(ladder: System) -> None:
    slipping = System(ladder.states, ladder.controls, ladder.dt, Slipping())
    with pytest.raises(InvalidArgument, match="cannot run this: there is no kernel of the dynamics"):
        rollout(on(slipping), CompiledConstant(), np.array([[0.25]]), CompiledLadder(), seeds_from(0), engine="float32")
