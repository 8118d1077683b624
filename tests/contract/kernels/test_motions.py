"""Motions: the compiled forms of the planar and the rigid body, and NumPy for one of a plugin without any."""

from dataclasses import replace

import numpy as np
import pytest

from sysid_evo.angles import wrap
from sysid_evo.controllers import RecurrentNetwork
from sysid_evo.data import Dataset
from sysid_evo.engine import rollout
from sysid_evo.engine.compiled.open_loop import kernel_step
from sysid_evo.evolution.model_evolution import ModelEvolution
from sysid_evo.kernels import LANES, DynamicsKernel, KernelSource, Layout, view
from sysid_evo.models import DynamicsModel
from sysid_evo.models.base import make_model
from sysid_evo.models.kernels import network_predictor, stepping_kernel, turning_frame
from sysid_evo.motion import PlanarBody
from sysid_evo.rigid_body import RigidBody
from sysid_evo.tasks import PointToPoint
from sysid_evo.testing import example_dataset
from tests.fixtures.motions import clockwise

HEAD = Layout("nx", "dt")
MIXED = ("temperature", "yaw_rate", "lateral_speed", "forward_speed")
IN_SPACE = ("up_y", "temperature", *list(RigidBody().roles().values())[:7], "up_z")
SEEDS = np.array([4, 9], dtype=np.uint64)


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
    np.testing.assert_allclose(run.states[1:], np.clip(expected, *model.state_bounds), rtol=1e-12)
    other = PlanarBody().integrate(before, model.acceleration(before, run.controls), 0.05, model.system.state_names)
    assert np.abs(expected - other).max() > 1e-3, "the two motions must differ here"


def test_what_integrates_by_a_motion_has_no_kernel_without_its_compiled_form(car):
    predictor = network_predictor([[(np.zeros((5, 3)), np.zeros(3))]], 3, 2)
    system = clockwise(car)
    assert turning_frame(predictor, system) is None
    assert stepping_kernel(predictor, system, output="acceleration") is None
    assert stepping_kernel(predictor, system, output="next_state") is not None
    assert PointToPoint().bind(system).kernel() is None


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
    small = {"hidden": [6], "one_step_updates": 200, "updates": 20, "horizon": 4}
    model = make_model(family, **small, state_lags=0, control_lags=0)
    scores = [model.fit(data).score(data) for data in (plain, Dataset(clockwise(plain.system), episodes))]
    assert scores[1] == pytest.approx(scores[0], abs=0.3)
    assert scores[1] > -0.9


def all_three(carry, control, noise, parameters, scratch):
    """Integrate the second nx rows of the carry, turn the third nx rows, and move the pose after them."""
    nx, dt, own = int(parameters[HEAD.nx]), parameters[HEAD.dt], view(parameters, HEAD.size)
    after, rate, pose = view(carry, nx * LANES), view(carry, 2 * nx * LANES), view(carry, 3 * nx * LANES)
    integrate(carry, after, nx, dt, own)  # bound below, as are the other two
    turn_frame(carry, rate, own)
    move_pose(pose, carry, after, dt, own)


@pytest.mark.parametrize(
    ("motion", "names"),
    [(PlanarBody(), MIXED), (PlanarBody(lateral=None), MIXED), (RigidBody(), IN_SPACE)],
    ids=["planar", "without lateral", "rigid"],
)
def test_the_compiled_form_integrates_turns_and_moves_as_the_form_on_arrays(motion, names, rng):
    nx, dt = len(names), 0.05
    state, acceleration = rng.standard_normal((2, 12, nx))
    state[0], acceleration[0] = 0.0, 0.0
    pose = rng.uniform(-2.0, 2.0, (12, motion.n_pose))
    if motion.n_pose == 7:
        pose[:, 3:] /= np.linalg.norm(pose[:, 3:], axis=1, keepdims=True)
    form = motion.kernel(names)
    bindings = {"integrate": form.integrate, "turn_frame": form.turn, "move_pose": form.move}
    kernel = DynamicsKernel(KernelSource(all_three, bindings), HEAD.pack(form.parameters, nx=nx, dt=dt))
    carry = np.concatenate([state, acceleration, acceleration, pose], axis=1)
    found = kernel_step(kernel, carry, np.zeros((12, 1)), precision="float64")
    after = motion.integrate(state, acceleration, dt, names)
    np.testing.assert_allclose(found[:, nx : 2 * nx], after, atol=1e-7)
    turned = acceleration + motion.frame_rotation(state, names)
    np.testing.assert_allclose(found[:, 2 * nx : 3 * nx], turned, atol=1e-7)
    moved = found[:, 3 * nx :] - motion.move(pose, state, after, dt, names)
    if motion.n_pose == 3:
        moved[:, 2] = wrap(moved[:, 2])
    np.testing.assert_allclose(moved, 0.0, atol=1e-7)
