"""Motions are an open set: one from a plugin is integrated as it says itself, in every form, or not compiled."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from sysid_evo import system as systems
from sysid_evo.controllers import RecurrentNetwork
from sysid_evo.data import Dataset
from sysid_evo.engine import rollout
from sysid_evo.errors import IncompatibleSystem, InvalidSystem
from sysid_evo.evolution.model_evolution import ModelEvolution
from sysid_evo.models import DynamicsModel
from sysid_evo.models.base import make_model
from sysid_evo.models.kernels import network_predictor, stepping_kernel, turning_frame
from sysid_evo.motion import Motion, PlanarBody, motion_from_dict
from sysid_evo.registry import motions
from sysid_evo.system import System
from sysid_evo.tasks import PointToPoint
from sysid_evo.testing import example_dataset

SEEDS = np.array([4, 9], dtype=np.uint64)


@dataclass(frozen=True)
class Clockwise(Motion):
    """A planar body whose yaw rate counts clockwise: its frame turns the other way."""

    kind = "clockwise"
    n_pose = 3
    pose_names = ("x", "y", "heading")
    pose_units = ("m", "m", "rad")

    forward: str = "forward_speed"
    lateral: str = "lateral_speed"
    yaw_rate: str = "yaw_rate"

    def roles(self):
        return {"forward": self.forward, "lateral": self.lateral, "yaw_rate": self.yaw_rate}

    def _mirrored(self, state, names):
        sign = np.where(np.array(names) == self.yaw_rate, -1.0, 1.0)
        return state * sign

    def acceleration(self, before, after, dt, names):
        plain = PlanarBody().acceleration(self._mirrored(before, names), self._mirrored(after, names), dt, names)
        return self._mirrored(plain, names)

    def integrate(self, state, acceleration, dt, names):
        plain = PlanarBody().integrate(self._mirrored(state, names), self._mirrored(acceleration, names), dt, names)
        return self._mirrored(plain, names)

    def turning(self, state, names):
        return self._mirrored(PlanarBody().turning(self._mirrored(state, names), names), names)

    def move(self, pose, before, after, dt, names):
        return PlanarBody().move(pose, self._mirrored(before, names), self._mirrored(after, names), dt, names)


def clockwise(system):
    return System(system.states, system.controls, system.dt, Clockwise(), system.name)


@pytest.fixture(scope="module")
def recording():
    made = example_dataset()
    return Dataset(clockwise(made.system), made.episodes)


@pytest.mark.parametrize("family", ["nearest_neighbour", "linear"])
def test_auto_never_differs_from_the_reference_where_a_motion_has_no_compiled_form(family, recording):
    model = make_model(family).fit(recording, rng=np.random.default_rng(0))
    weights = np.random.default_rng(1).standard_normal((5, 78))
    given = (model, RecurrentNetwork(), weights, PointToPoint(horizon=40), SEEDS)
    auto, exact = (rollout(*given, engine=engine, record=True) for engine in ("auto", "reference"))
    assert auto.engine == "reference"
    np.testing.assert_array_equal(auto.fitness, exact.fitness)
    for a, b in zip(auto.trajectories, exact.trajectories, strict=True):
        np.testing.assert_array_equal(a.states, b.states)
        np.testing.assert_array_equal(a.pose, b.pose)


def test_a_rollout_and_a_simulation_integrate_by_the_motion_of_the_system(recording):
    model = make_model("nearest_neighbour").fit(recording, rng=np.random.default_rng(0))
    weights = np.random.default_rng(1).standard_normal((1, 78))
    (run,) = rollout(model, RecurrentNetwork(), weights, PointToPoint(horizon=40), SEEDS[:1], record=True).trajectories
    again = model.simulate(run.states[None, :1], run.controls[None, :0], run.controls[None])
    np.testing.assert_allclose(again[0], run.states[1:], rtol=1e-12)
    before = run.states[:-1]
    expected = model.system.integrate(before, model.acceleration(before, run.controls))
    np.testing.assert_allclose(run.states[1:], np.clip(expected, *model.envelope), rtol=1e-12)
    other = PlanarBody().integrate(before, model.acceleration(before, run.controls), 0.05, model.system.state_names)
    assert np.abs(expected - other).max() > 1e-3, "the two motions must differ here"


def test_what_integrates_by_a_motion_has_no_kernel_without_its_compiled_form(car):
    predictor = network_predictor([[(np.zeros((5, 3)), np.zeros(3))]], 3, 2)
    system = clockwise(car)
    assert turning_frame(predictor, system) is None
    assert stepping_kernel(predictor, system, output="acceleration") is None
    assert stepping_kernel(predictor, system, output="next_state") is not None
    assert PointToPoint().bind(system).kernel() is None


def test_one_remark_says_that_a_motion_has_no_compiled_form(car, caplog):
    systems._remark_slow.cache_clear()
    with caplog.at_level(logging.WARNING):
        for _ in range(3):
            assert clockwise(car).motion_kernel() is None
    assert [record.getMessage() for record in caplog.records] == [
        "motion clockwise has no compiled form: what needs it runs in NumPy, some ten times slower"
    ]


def test_a_family_that_is_evolved_compiled_is_evolved_in_numpy_without_a_compiled_motion(recording):
    class Constant(DynamicsModel):
        def fit(self, dataset, **keywords):
            search = ModelEvolution(generations=2, windows=5, horizon=2, parents=4, children=4)
            self.push_ = search.run(
                lambda p, carry, control: self.system.integrate(carry, np.broadcast_to(p[:, None], carry.shape)),
                dataset, initial=np.zeros(3), spread=0.1, rng=np.random.default_rng(0), kernel=lambda p: None,
            )  # fmt: skip
            return self

        def acceleration(self, carry, control):
            return np.broadcast_to(self.push_, carry.shape)

    assert np.isfinite(Constant().fit(recording, rng=np.random.default_rng(0)).push_).all()


@pytest.mark.parametrize("family", ["neural_ode", "mlp_ensemble"])
def test_a_motion_that_does_not_say_its_derivative_is_trained_by_differences(family):
    """The same car with its yaw rate counted clockwise is learned as well as with the derivative of a planar body."""
    plain = example_dataset()
    sign = np.where(np.array(plain.system.state_names) == "yaw_rate", -1.0, 1.0)
    episodes = [replace(episode, states=episode.states * sign) for episode in plain.episodes]
    small: dict[str, Any] = {"hidden": [6], "one_step_updates": 200, "updates": 20, "horizon": 4}
    model = make_model(family, **small, state_lags=0, control_lags=0)
    scores = [model.fit(data).score(data) for data in (plain, Dataset(clockwise(plain.system), episodes))]
    assert scores[1] == pytest.approx(scores[0], abs=0.3)
    assert scores[1] > -0.9


def test_a_system_with_a_registered_motion_is_stored_and_read(car, register):
    register(motions, "clockwise", Clockwise)
    system = clockwise(car)
    assert System.from_dict(system.to_dict()) == system


def test_an_unknown_motion_is_refused_with_the_known_ones_and_the_option_that_loads_a_plugin():
    with pytest.raises(InvalidSystem, match=r"expected one of planar_body, got 'hovercraft'.*--plugin FILE"):
        motion_from_dict({"kind": "hovercraft"})
    with pytest.raises(InvalidSystem, match="motion planar_body: cannot be made from wheels"):
        motion_from_dict({"kind": "planar_body", "wheels": 4})


def test_no_class_inherits_the_compiled_form_of_a_planar_body():
    with pytest.raises(TypeError, match="Skid: no class may be derived from PlanarBody; derive it from Motion"):

        class Skid(PlanarBody):  # type: ignore[misc]  # that is what is refused
            pass


def test_the_continuous_form_is_the_limit_of_the_sampled_one(car, rng):
    state, dt = rng.standard_normal((6, 3)), 1e-7
    for system in (car, clockwise(car)):
        assert system.motion is not None
        coasting = system.motion.integrate(state, np.zeros_like(state), dt, system.state_names)
        np.testing.assert_allclose((coasting - state) / dt, system.turning(state), atol=1e-6)


def test_a_pose_seen_from_another_is_where_a_body_there_would_put_it(car):
    origin = np.array([1.0, 2.0, np.pi / 2])
    np.testing.assert_allclose(car.seen_from(origin, np.array([1.0, 3.0, np.pi])), [1.0, 0.0, np.pi / 2], atol=1e-12)
    with pytest.raises(IncompatibleSystem, match="clockwise does not say how one pose is seen from another"):
        clockwise(car).seen_from(origin, origin)


def test_velocities_undo_the_movement_of_the_pose(car):
    state, pose, dt = np.array([1.2, -0.3, 0.8]), np.array([0.4, 0.1, 2.0]), 1e-6
    assert car.motion is not None
    rate = (car.move(pose, state, state, dt) - pose) / dt
    told = car.motion.velocities(pose, rate)
    np.testing.assert_allclose([told[name] for name in car.state_names], state, atol=1e-5)
