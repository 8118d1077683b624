"""Every family, wrapper, task, controller and emulated robot once: compiled against the reference."""

from dataclasses import dataclass

import numpy as np
import pytest

from hardware.simulators.gymnasium_robot import GymnasiumRobot
from sysid_evo import make_model, make_task, register_reward
from sysid_evo.controllers import RecurrentNetwork
from sysid_evo.controllers.controller import make_controller
from sysid_evo.engine import DynamicsRunner, rollout
from sysid_evo.errors import IncompatibleSystem
from sysid_evo.evolution import ControllerEvolution, evolve_controller
from sysid_evo.kernels import DynamicsKernel, ScalarStep
from sysid_evo.models import Disturbed, DomainRandomisation, OutsideCounter
from sysid_evo.predictive_control import ImaginedTrials, Predictive
from sysid_evo.randomness import trial_seeds
from sysid_evo.registry import make_robot, models, tasks
from sysid_evo.tasks import PointToPoint
from sysid_evo.tasks.reward import Reward
from sysid_evo.testing import MODEL
from sysid_evo.testing.examples import ExampleDynamics, continuous_car, example_dataset, pendulum, switched_car
from tests.fixtures.families import SMALL, hurry
from tests.fixtures.faults import Planted, equations, starts_with_twice_the_power
from tests.fixtures.lanes import step_between_guards
from tests.fixtures.rewards import WHERE, braked, upright, worth, worth_of_a_car, worth_of_one
from tests.fixtures.systems import SMALL_SYSTEMS, TANK, TASKS_WITH_ARGUMENTS

pytestmark = pytest.mark.filterwarnings("ignore::sysid_evo.errors.DataWarning")  # of how long a fit may take
SEEDS = trial_seeds(3, 3)
FORMS = pytest.mark.parametrize("engine", ["auto", pytest.param("float64", marks=pytest.mark.nightly)])
"""The precision that a rollout takes by itself; that in which only rounding is left."""
TOLERANCE = {"compiled float32": 2e-3, "compiled float64": 1e-6}
"""Of the largest in a state, after 40 steps."""
NETWORK = {"hidden": [4], "one_step_updates": 4, "updates": 2, "horizon": 3, "control_lags": 1, "state_lags": 0}
STATE_SPACE = {"members": 2, "order": 3, "screening_iterations": 3, "iterations": 3, "hidden": 4, "horizon": 100}
FAMILIES = {
    **{name: {} for name in models.names() if name not in ("adapted", "auto")},
    "linear": {"ridge": 200.0},
    "linear with lags": {"state_lags": 2, "control_lags": 1},
    "nearest_neighbour": {"control_lags": 1},
    "k_neighbours": {"neighbours": 8, "state_lags": 0, "control_lags": 1},
    "narx": {"terms": 6, "state_lags": 0, "control_lags": 1},
    "sindy": {"degree": 2, "state_lags": 0, "control_lags": 0},
    "sindy_discrete": {"degree": 2, "state_lags": 0, "control_lags": 1},
    "parametrised": {"generations": 5, "control_lags": 1},
    "backprop27": {"epochs": 20},
    "evolved3": {"generations": 5},
    "mlp_ensemble": {**NETWORK, "members": 2},
    "neural_ode": NETWORK,
    "hybrid_ode": NETWORK,
    "torch_ode": {"hidden": [4], "updates": 2, "horizon": 3},
    "torch_module": {"updates": 2, "horizon": 3},
    "gaussian_process": {"inducing": 30},
    "linear_state_space": {"order": 3, "iterations": 3, "folds": 1, "horizon": 100},
    "nonlinear_state_space": STATE_SPACE,
    "latent_ode": STATE_SPACE,
    "single_track": {"starts": 1, "windows": 15},
    "average": {"families": ["linear", "linear(ridge=9)"]},
    "regressor": {"max_iter": 20, "state_lags": 0, "control_lags": 1},
    "equations": SMALL["equations"],
    "lti": SMALL["lti"],
}
"""Every family with settings that are quick to fit; the two that are left out have tests of their own."""
EXACT = ("k_neighbours", "gaussian_process")
"""Families whose kernels ask for double precision."""
AT_NIGHT = ("backprop27", "torch_ode", "latent_ode", "average", "evolved3", "hybrid_ode", "sindy")
"""Compiled by day in tests of their own, or made of what other rows compile: one network, a derivative and a body."""
JUMPS = {"nearest_neighbour": 0.8}
"""The share of trajectories and steps that must agree where rounding decides between two neighbours."""


@dataclass(frozen=True)
class Given:
    """What runs in a row of the table; ``scale`` is that of random parameters."""

    dynamics: object
    controller: object
    task: object
    scale: float = 0.5

    def run(self, engine):
        bound = self.controller.bind_to(self.task.bind(self.dynamics.system))
        parameters = self.scale * np.random.default_rng(1).standard_normal((7, bound.n_parameters))
        parameters[0] = 0.0
        return rollout(self.dynamics, self.controller, parameters, self.task, SEEDS, engine=engine, record=True)


def agree(given, engine="auto", *, share=1.0):
    """Run a row compiled and in NumPy; assert that they agree in everything they return; return both."""
    fast, exact = given.run(engine), given.run("reference")
    assert fast.engine.startswith("compiled")
    tolerance = TOLERANCE[fast.engine]
    assert len({run.controls.tobytes() for run in exact.trajectories}) > 1, "equal controllers prove nothing"
    size = np.max([np.abs(run.states).max(axis=0) for run in exact.trajectories], axis=0) + 1e-3
    alike = [
        a.name == b.name
        and a.states.shape == b.states.shape
        and (np.abs(a.states - b.states) <= tolerance * size).all()
        and np.allclose(a.controls, b.controls, atol=tolerance)
        and (b.pose is None or np.allclose(a.pose, b.pose, atol=tolerance))
        for a, b in zip(fast.trajectories, exact.trajectories, strict=True)
    ]
    assert np.mean(alike) >= share
    for name in ("fitness", "survived", "clipped", "outside"):
        found, expected = getattr(fast, name), getattr(exact, name)
        assert found.shape == expected.shape
        assert np.isclose(found, expected, rtol=tolerance, atol=tolerance).mean() >= share, name
    assert (fast.task_state.alive == exact.task_state.alive).mean() >= share
    assert np.abs(fast.behaviour - exact.behaviour).mean() < 0.02  # single samples near neutral may differ
    assert (fast.behaviour[..., 0::2] + fast.behaviour[..., 1::2]).max() <= 1.0 + 1e-6
    bound = given.task.bind(given.dynamics.system)
    told, expected = (bound.measures(run.task_state) for run in (fast, exact))
    for name, values in expected.items():
        assert np.isclose(told[name], values, rtol=tolerance, atol=tolerance, equal_nan=True).mean() >= min(
            share, 0.9
        ), name
    return fast, exact


def steps_agree(dynamics, dataset, engine="auto", *, share=1.0, steps=4):
    """Assert that compiled single steps are those of `step`, from recorded states and from where they lead."""
    kernel, rng = dynamics.kernel(), np.random.default_rng(2)
    precision = kernel.precision if engine == "auto" else engine
    tolerance = {"float32": 1e-4, "float64": 1e-7}[precision]
    windows = dataset.windows(1, stride=3, history=dynamics.n_lags)
    windows = windows[rng.integers(len(windows), size=64)]
    states, controls = windows.past_states.copy(), windows.past_controls.copy()
    states[:4], controls[:4] = 0.0, dataset.system.neutral_control  # at rest
    carry = dynamics.start(states, controls, rng.standard_normal((64, dynamics.n_draws)))
    assert carry.shape[1] == dynamics.n_carry
    for k in range(steps):
        control = dataset.system.actuate(rng.uniform(-1.0, 1.0, (64, dataset.system.nu)))
        control[: 4 - k] = dataset.system.neutral_control
        noise = rng.standard_normal((64, max(1, dynamics.n_noise)))
        after = dynamics.step(carry, control, noise[:, : dynamics.n_noise] if dynamics.n_noise else None)
        found = step_between_guards(kernel, carry, control, noise, precision=precision)
        off = np.abs(found - after) > tolerance * (np.abs(after) + np.abs(after).max(axis=0) + 1e-3)
        assert off.any(axis=1).mean() <= 1.0 - share, np.flatnonzero(off.any(axis=0))
        carry = after


@pytest.fixture(scope="module")
def learn(throttle_car_data):
    """A function that returns a row of `FAMILIES`, fitted on the reference form."""
    made = {}

    def fitted(row):
        if row not in made:
            with pytest.MonkeyPatch.context() as patch:
                patch.setenv("SYSID_EVO_ENGINE", "reference")
                hurry(patch)
                made[row] = make_model(row.split()[0], **FAMILIES[row]).fit(throttle_car_data, rng=0)
        return made[row]

    return fitted


WAYPOINTS = PointToPoint(horizon=40, waypoint_radius=0.8)
ANY_SHAPE = make_controller("feed_forward(hidden=[3])")
"""Its compiled form is the same for every system and task; a `RecurrentNetwork` is compiled for each shape."""


@FORMS
@pytest.mark.parametrize(
    "row", [pytest.param(row, marks=pytest.mark.nightly if row in AT_NIGHT else ()) for row in FAMILIES]
)
def test_a_family_drives_and_steps_as_in_numpy(row, engine, learn, throttle_car_data):
    model, share = learn(row), JUMPS.get(row, 1.0)
    fast, _ = agree(Given(model, RecurrentNetwork(), WAYPOINTS), engine, share=share)
    if engine == "auto":
        assert fast.engine == f"compiled {'float64' if row in EXACT else 'float32'}"
    steps_agree(model, throttle_car_data, engine, share=share)


BASE = "linear with lags"
NOISY = DomainRandomisation(sensor=0.1, gain=0.2, process=0.05)
KINDS = [{}, {"sensor": 0.3}, {"gain": 0.2}, {"process": 0.1}]
SPREAD = np.array([0.5, 0.1, 1.0])


class Late(ExampleDynamics):
    """Commands act a step late, so that the carry is longer than the state; so short that wrappers compile fast."""

    n_lags = 1
    state_bounds = np.array([[-0.5, -0.4, -0.3], [0.5, 0.4, 0.3]])

    def __init__(self, model, times=1.0):
        super().__init__(model.system)
        self.n_carry, self.training_sample_, self.push = 5, model.training_sample_, times * self.push

    def start(self, states, controls, draws=None):
        return np.concatenate([states[:, -1], controls[:, -1]], axis=1)

    def step(self, carry, control, noise=None):
        return np.concatenate([super().step(carry[:, :3], carry[:, 3:]), control], axis=1)

    def kernel(self):
        return DynamicsKernel(ScalarStep(late, n_carry=5, nu=2), np.concatenate([self.offset, np.ravel(self.push)]))


def late(x, u, p):
    return (
        0.9 * x[0] + p[0] + p[3] * x[3] + p[4] * x[4],
        0.9 * x[1] + p[1] + p[5] * x[3] + p[6] * x[4],
        0.9 * x[2] + p[2] + p[7] * x[3] + p[8] * x[4],
        u[0],
        u[1],
    )


@pytest.fixture(params=["late", pytest.param("learned", marks=pytest.mark.nightly)])
def two(request, learn):
    """What wrappers are put around, and another for the same system."""
    linear = learn("linear")
    return (Late(linear), Late(linear, 1.3)) if request.param == "late" else (learn(BASE), linear)


@FORMS
@pytest.mark.parametrize("noise", [NOISY, *(DomainRandomisation(**kind) for kind in KINDS)], ids=str)
def test_every_kind_of_noise_steps_as_in_numpy(noise, engine, two, throttle_car_data):
    for delay in (0.0, 0.07):
        steps_agree(Disturbed(two[0], noise, delay=delay, spread=SPREAD), throttle_car_data, engine)


@FORMS
@pytest.mark.parametrize("delay", [0.0, 0.02, 0.05, 0.0725, 0.1, 0.16])
def test_every_delay_steps_as_in_numpy(delay, engine, two, throttle_car_data):
    steps_agree(Disturbed(two[0], delay=delay), throttle_car_data, engine)


@FORMS
@pytest.mark.parametrize("every", [1, 3])
def test_steps_outside_the_data_are_counted_as_in_numpy_and_change_no_score(every, engine, two, throttle_car_data):
    one = two[0]
    counter = OutsideCounter(one, every=every)
    steps_agree(counter, throttle_car_data, engine)
    given = Given(counter, RecurrentNetwork(), WAYPOINTS, scale=2.0)
    fast, exact = agree(given, engine)
    assert exact.outside.max() > 0.1
    plain = Given(one, RecurrentNetwork(), WAYPOINTS, scale=2.0).run(engine)
    np.testing.assert_array_equal(fast.fitness, plain.fitness)
    assert not plain.outside.any()


@FORMS
def test_noise_and_a_delay_are_the_same_in_every_trial_and_matter(engine, two):
    """Whatever the number of threads; without a delay every form scores as without the wrapper."""
    model = two[0]
    given = Given(
        Disturbed(OutsideCounter(model), NOISY, delay=0.07),
        RecurrentNetwork(),
        WAYPOINTS,
        scale=2.0,
    )
    fast, exact = agree(given, engine)
    assert exact.outside.any()
    plain, late, at_once = (
        Given(one, RecurrentNetwork(), WAYPOINTS, scale=2.0).run(engine)
        for one in (model, Disturbed(model, delay=0.12), Disturbed(model))
    )
    np.testing.assert_array_equal(at_once.fitness, plain.fitness)
    for other in (fast, late):
        pairs = zip(other.trajectories, plain.trajectories, strict=True)
        assert any(not np.array_equal(a.controls, b.controls) for a, b in pairs)
    parameters = np.random.default_rng(1).normal(0.0, 2.0, (13, 78))
    one, two = (
        rollout(given.dynamics, given.controller, parameters, WAYPOINTS, trial_seeds(0, 7), threads=threads)
        for threads in (1, 2)
    )
    np.testing.assert_array_equal(one.fitness, two.fitness)
    np.testing.assert_array_equal(one.outside, two.outside)


ROBOTS = {
    "emulated_car": "point_to_point(horizon=60)",
    "awkward_car": "point_to_point(horizon=60)",
    "pendulum": "swing_up(horizon=40)",
    "cart_pole": "balance(horizon=40)",
    "thermal": "set_point(horizon=40)",
}


@FORMS
@pytest.mark.parametrize("robot", ROBOTS)
def test_an_emulated_robot_moves_as_in_numpy(robot, engine):
    agree(Given(make_robot(robot).dynamics, ANY_SHAPE, make_task(ROBOTS[robot]), scale=1.0), engine, share=0.9)


@FORMS
def test_a_planted_habit_is_the_same_compiled(engine):
    car = equations("emulated_car")
    runs = [
        agree(Given(one, RecurrentNetwork(), WAYPOINTS, scale=1.0), engine)[1].trajectories
        for one in (Planted(car, starts_with_twice_the_power), car)
    ]
    assert np.mean([np.allclose(a.states, b.states, atol=0.01) for a, b in zip(*runs, strict=True)]) < 0.5


CONTROLLERS = [
    "constant", "feed_forward", "feed_forward(hidden=[5, 3, 4])", "linear", "linear(inputs=waypoint_angle)", "pid",
    "pid(loops={steer: [waypoint_angle, yaw_rate]})", "pursuit", "pursuit(backward=true)",
    pytest.param("recurrent(hidden=3)", marks=pytest.mark.nightly),  # the rows of families have one
]  # fmt: skip


@FORMS
@pytest.mark.parametrize("spec", CONTROLLERS)
def test_a_controller_drives_a_car_with_switches_as_in_numpy(spec, engine):
    agree(Given(equations("emulated_car"), make_controller(spec), WAYPOINTS), engine)


@FORMS
def test_a_regulator_holds_a_pole_as_in_numpy(engine):
    pole = make_robot("cart_pole").dynamics
    agree(Given(pole, make_controller("lqr(model=cart_pole)"), make_task("balance(horizon=40)")), engine)


def spinning(angular_speed):
    return abs(angular_speed) > 1.0


@pytest.fixture(autouse=True)
def rewards():
    """Two rewards by the names of states and controls."""
    for name, function, options in (
        ("upright", upright, {"terminated": spinning, "start": WHERE}),
        ("braked", braked, {}),
    ):
        register_reward(name, min_reward=-2.0, horizon=40, **options)(function)
    yield
    for name in ("upright", "braked"):
        tasks.forget(name)


TASKS = [
    *TASKS_WITH_ARGUMENTS,
    ("point_to_point(horizon=40, waypoint_radius=0.6, arena_radius=0.8)", continuous_car()),
    ("walled_track(horizon=40, radius=0.5, width=0.3, collision=slow)", continuous_car()),
    ("walled_track(horizon=40, radius=0.5, width=0.3, collision=end)", continuous_car()),
    ("walled_track(horizon=60)", switched_car()),
    ("set_point(channels=angular_speed, low=-1, high=1, tolerance=0.2, horizon=40)", pendulum()),
    ("set_point(channels=[level, warmth], tolerance=1, effort=0.3, horizon=40)", TANK),
    ("track_reference(channels=angular_speed, low=-1, high=1, horizon=40)", pendulum()),
    ("balance(horizon=40, effort=0.1)", pendulum()),
    ("upright(weight=0.1)", pendulum()),
    pytest.param("braked", switched_car(), marks=pytest.mark.nightly),
    (Reward(worth, scalar=worth_of_one, lowest=-2.0, horizon=40), pendulum()),
    pytest.param(
        Reward(worth, scalar=worth_of_a_car, lowest=-2.0, horizon=40), switched_car(), marks=pytest.mark.nightly
    ),
]
AT_NIGHT_TOO = ("MountainCar-v0", "MountainCarContinuous-v0", "Acrobot-v1")
ENVIRONMENTS = ["Pendulum-v1", "CartPole-v1", *(pytest.param(one, marks=pytest.mark.nightly) for one in AT_NIGHT_TOO)]


def bound(spec, system):
    return (make_task(spec) if isinstance(spec, str) else spec).bind(system)


@FORMS
@pytest.mark.parametrize("spec, system", TASKS, ids=lambda one: one if isinstance(one, str) else type(one).__name__)
def test_a_task_scores_and_is_imagined_as_in_numpy(spec, system, engine):
    """Networks drive linear dynamics; trials that have gone on for some steps are imagined."""
    task, body = bound(spec, system), ExampleDynamics(system)
    agree(Given(body, ANY_SHAPE, task), engine)
    compiled, reference = imagined(task, body, engine)
    tolerance = 1e-3 if engine == "auto" else 1e-6
    np.testing.assert_allclose(compiled, reference, rtol=tolerance, atol=tolerance)
    assert np.ptp(reference, axis=0).max() > 0.01, "equal scores prove nothing"


@FORMS
@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_the_reward_of_an_environment_scores_and_is_imagined_as_in_numpy(name, engine):
    """Trials are imagined from anywhere, so that some end."""
    task = make_task("environment", id=name, horizon=30).bind(GymnasiumRobot(id=name).system)
    body, rng = ExampleDynamics(task.system), np.random.default_rng(1)
    body.push, body.offset = 0.1 * body.push, 0.1 * body.offset  # a pole that is pushed harder falls at once
    agree(Given(body, ANY_SHAPE, task), engine)
    low, high = np.clip([(channel.low, channel.high) for channel in task.system.states], -6.0, 6.0).T
    states = rng.uniform(low, high, (64, 1, task.system.nx)) * rng.choice([0.02, 1.0], (64, 1, 1))
    past = np.zeros((64, 0, task.system.nu))
    sequences, known = (
        rng.uniform(-1.2, 1.2, (10, 64, 3, task.system.nu)),
        task.hide_future(task.begin(trial_seeds(3, 64))),
    )
    compiled, reference = (
        ImaginedTrials(body, task, engine=one).scores(states, past, sequences, known) for one in (engine, "reference")
    )
    assert np.isclose(compiled, reference, rtol=1e-3, atol=1e-3).mean() > 0.99
    assert np.ptp(reference) > 0.01 or name == "MountainCar-v0"  # each step costs the same, the flag is far


def imagined(task, body, engine, *, steps=25, done=2):
    """Return the scores of the same sequences, compiled and in NumPy, for five trials ``done`` steps old."""
    here, rng = task.begin(trial_seeds(3, 5)), np.random.default_rng(0)
    carry = body.start(here.state[:, None], np.zeros((5, 0, task.system.nu)))
    for _ in range(done):
        control = task.system.actuate(rng.uniform(-0.4, 0.4, (5, task.system.nu)))
        after = body.step(carry, control)
        advanced, state = task.advance(here, carry[:, : task.system.nx], after[:, : task.system.nx], control=control)
        here = here.updated_where(advanced, here.alive)
        carry = np.concatenate([state, after[:, task.system.nx :]], axis=1)
    known, state = task.hide_future(here), carry[:, : task.system.nx]
    sequences = np.random.default_rng(1).uniform(-1.2, 1.2, (30, 5, steps, task.system.nu))
    forms = [ImaginedTrials(body, task, engine=one) for one in (engine, "reference")]
    assert forms[0].compiled is not None
    assert forms[1].compiled is None
    return [form.scores(state[:, None], np.zeros((5, 0, task.system.nu)), sequences, known) for form in forms]


class Jumping(ExampleDynamics):
    """Its speed becomes ``peak`` under more than half of the torque; an state_bounds holds it within 3 rad/s."""

    state_bounds = np.array([[-np.inf, -3.0], [np.inf, 3.0]])

    def __init__(self, peak):
        super().__init__(pendulum())
        self.peak = peak

    def step(self, carry, control, noise=None):
        speed = np.where(control[:, 0] > 1.0, self.peak, 0.5 * carry[:, 1] + control[:, 0])
        return np.stack([carry[:, 0] + 0.1 * carry[:, 1], speed], axis=1)

    def kernel(self):
        return DynamicsKernel(ScalarStep(jumping, n_carry=2, nu=1), np.array([self.peak]))


def jumping(x, u, p):
    return x[0] + 0.1 * x[1], p[0] if u[0] > 1.0 else 0.5 * x[1] + u[0]


@FORMS
@pytest.mark.parametrize("peak", [np.inf, 1e6])
def test_what_diverges_is_imagined_as_the_worst_and_what_has_an_envelope_is_clipped(peak, engine):
    task = bound("set_point(channels=angular_speed, low=-1, high=1, tolerance=0.5, horizon=40)", pendulum())
    compiled, reference = imagined(task, Jumping(peak), engine, steps=8, done=6)
    np.testing.assert_allclose(compiled, reference, rtol=1e-4, atol=1e-4)
    lost = compiled == task.worst - 1.0
    assert lost.any() == np.isinf(peak)
    assert not lost.all()


@FORMS
def test_two_candidates_in_the_same_trials_are_imagined_apart(engine):
    """Changing targets are stored once for each trial, for any number of candidates."""
    task = bound("track_reference(channels=angular_speed, low=-1, high=1, horizon=40)", pendulum())
    known, body = task.begin(trial_seeds(3, 3)).tile(2), ExampleDynamics(pendulum())
    sequences = np.random.default_rng(1).uniform(-1.0, 1.0, (20, 6, 25, 1))
    compiled, reference = (
        ImaginedTrials(body, task, engine=one).scores(known.state[:, None], np.zeros((6, 0, 1)), sequences, known)
        for one in (engine, "reference")
    )
    np.testing.assert_allclose(compiled, reference, rtol=1e-4, atol=1e-4)


class Formed(Predictive):
    """Predictive with either form of imagination."""

    def __init__(self, *, engine, **settings):
        super().__init__(**settings)
        self.engine = engine

    def bind_to(self, task):
        law = super().bind_to(task)
        law.imagined = tuple(ImaginedTrials(one.dynamics, task, engine=self.engine) for one in law.imagined)
        return law


@FORMS
@pytest.mark.parametrize("row", ["linear with lags", "nearest_neighbour"])
def test_a_fitted_model_inside_drives_as_its_numpy_form(row, engine, learn):
    model = learn(row)
    runs = [
        rollout(
            ExampleDynamics(model.system), Formed(model=model, samples=24, horizon=8, engine=one), np.zeros((1, 2)),
            make_task("point_to_point(horizon=12)"), trial_seeds(1, 2), record=True,
        )
        for one in (engine, "reference")
    ]  # fmt: skip
    for compiled, exact in zip(*(run.trajectories for run in runs), strict=True):
        np.testing.assert_allclose(compiled.controls, exact.controls, atol=1e-4)
        np.testing.assert_allclose(compiled.states, exact.states, atol=1e-4)


def test_a_plan_longer_than_a_trial_is_made_in_numpy():
    """The data of a task are as long as its trials: nothing beyond them is read."""
    task = bound("point_to_point(horizon=3, waypoint_radius=0.2)", continuous_car())
    body, known = ExampleDynamics(task.system), task.hide_future(task.begin(trial_seeds(0, 2)))
    given = known.state[:, None], np.zeros((2, 0, 2)), np.ones((4, 2, 6, 2)), known
    first, second = (ImaginedTrials(body, task, engine=engine).scores(*given) for engine in ("auto", "reference"))
    np.testing.assert_array_equal(first, second)


@pytest.mark.nightly
@pytest.mark.parametrize("engine, share", [("float64", 0.995), ("float32", 0.99)])
@pytest.mark.parametrize("row", ["emulated_car", "linear", BASE, "nearest_neighbour", "k_neighbours", "parametrised"])
def test_scores_of_an_evolved_population_are_those_of_numpy(row, engine, share, learn):
    model = equations(row) if row == "emulated_car" else learn(row)
    settings = ControllerEvolution(generations=40, trials=5)
    champion = evolve_controller("car", {"car": DynamicsRunner(model)}, model.system, settings, seed=3)
    away = np.random.default_rng(0).standard_normal((100, len(champion.parameters)))
    population = champion.parameters + 0.1 * np.abs(champion.parameters).mean() * away
    task = settings.make_task(model.system)
    given = model, settings.make_controller(task), population, task, trial_seeds(5, 10)
    exact, found = (rollout(*given, engine=one) for one in ("reference", engine))
    assert exact.fitness.mean() > 2.0, "controllers that reach nothing prove nothing"
    assert (found.fitness == exact.fitness).mean() >= share
    assert (found.clipped == exact.clipped).mean() >= share
    assert abs(found.fitness.mean() - exact.fitness.mean()) < 0.1


SMALL_BUDGETS = {row: options for row, options in FAMILIES.items() if row in models.names()}


@pytest.mark.nightly
@pytest.mark.parametrize("family", models.names())
@pytest.mark.parametrize("recording", ["a car that rests", "oscillator", *SMALL_SYSTEMS])
def test_a_family_keeps_the_contract_compiled_in_both_precisions(family, recording, oscillator_data):
    data = {"a car that rests": example_dataset(), "oscillator": oscillator_data}.get(recording)
    data = SMALL_SYSTEMS[recording].recording() if data is None else data
    try:
        results = list(MODEL.run(family, data, **SMALL_BUDGETS.get(family, {})))
    except IncompatibleSystem:
        pytest.skip("a family of cars")
    assert not [f"{one.rule}: {one.failure}" for one in results if one.failure]
