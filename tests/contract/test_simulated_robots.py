"""Robots of other packages: the contract, closed forms, and agreement with the motion that their states claim."""

from importlib import import_module

import numpy as np
import pytest

from hardware.robot import find_robot
from hardware.simulators.drift_car import MODELS
from hardware.testing import check_robot
from sysid_evo.angles import TURN
from sysid_evo.controllers import RecurrentNetwork
from sysid_evo.errors import IncompatibleSystem, InvalidArgument
from sysid_evo.models.dynamics import rk4
from sysid_evo.randomness import trial_seeds
from sysid_evo.registry import Spec, robots
from sysid_evo.tasks.task import make_task

WITHOUT = "the robot {} needs a package that is not installed: pip install sysid-evo[{}]"
ARM = """
<mujoco>
  <option timestep="0.004"/>
  <worldbody>
    <body name="cart">
      <joint name="rail" type="slide" axis="1 0 0" limited="true" range="-1 1"/>
      <geom type="box" size="0.1 0.1 0.1" mass="1"/>
      <body name="pole">
        <joint name="swing" type="hinge" axis="0 1 0"/>
        <inertial pos="0 0 -0.5" mass="0.000001" diaginertia="1e-12 1e-12 1e-12"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="push" joint="rail" ctrllimited="true" ctrlrange="-5 10"/></actuator>
</mujoco>
"""
FREE = """
<mujoco>
  <worldbody>
    <body name="brick">
      <freejoint/>
      <geom type="box" size="0.1 0.2 0.3" mass="1" contype="0"/>
      <body><joint name="fin" axis="1 0 0"/><geom type="sphere" size="0.05" mass="0.1" contype="0"/></body>
    </body>
  </worldbody>
  <actuator><motor name="flap" joint="fin" ctrllimited="true" ctrlrange="-1 1"/></actuator>
</mujoco>
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = tmp_path_factory.mktemp("mujoco")
    (made / "arm.xml").write_text(ARM)
    (made / "free.xml").write_text(FREE)
    return made


def made(name, folder=None, **parameters):
    """The robot; the test is skipped without its package."""
    module = {"quadrotor": "rotorpy", "drift_car": "vehiclemodels", "mujoco": "mujoco"}[name]
    pytest.importorskip(module, reason=WITHOUT.format(name, name))
    if folder is not None:
        parameters["file"] = str(folder)
    return find_robot(Spec(name, parameters))


def run(robot, controls, at=None, seed=0):
    """The states (T + 1, nx) under ``controls`` (T, nu), without a look at the ends of episodes."""
    with robot.simulator.open() as session:
        states = [session.reset(seed, at)]
        states += [session.step(control)[0] for control in controls]
    return np.array(states)


def under_random_controls(robot, steps, share=1.0, at=None):
    drawn = np.random.default_rng(3).uniform(-share, share, (steps, robot.system.nu))
    return run(robot, robot.system.actuate(np.repeat(drawn[::10], 10, axis=0)[:steps]), at)


ALL = [
    ("quadrotor", {}),
    ("quadrotor", {"vehicle": "crazyflie", "command": "motors"}),
    ("drift_car", {}),
    ("drift_car", {"model": "multi_body"}),
    ("mujoco", {"file": "arm.xml"}),
    ("mujoco", {"file": "free.xml"}),
]


@pytest.fixture(scope="module", params=ALL, ids=lambda given: "-".join(map(str, (given[0], *given[1].values()))))
def robot(request, folder):
    name, parameters = request.param
    place = folder / parameters["file"] if "file" in parameters else None
    return made(name, place, **{key: value for key, value in parameters.items() if key != "file"})


def test_every_robot_has_bounded_controls_and_a_task_of_its_own_that_can_be_run_in_it(robot):
    assert all(channel.bounded for channel in robot.system.controls)
    task = make_task(robot.default_task, horizon=5)
    controller = RecurrentNetwork(hidden=2)
    size = controller.bind_to(task.bind(robot.system)).n_parameters
    found = robot.runner().bind(controller, task)(np.zeros((1, size)), trial_seeds(1, 2), record=True)
    np.testing.assert_array_equal(found.survived, 5)
    np.testing.assert_allclose(found.trajectories[0].states[0], robot.system.neutral_state, atol=1e-9)


def test_an_episode_begins_in_the_given_state_and_continues_from_it_always_alike(robot):
    states = under_random_controls(robot, 12, 0.5)
    assert np.isfinite(states).all()
    start, control = states[-1], robot.system.actuate(np.full(robot.system.nu, 0.3))
    first, again = (run(robot, [control] * 3, start, seed) for seed in (1, 2))
    np.testing.assert_allclose(first[0], start, atol=1e-9)
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(run(robot, [], None, 1), run(robot, [], None, 2))


@pytest.mark.parametrize(("name", "parameters"), [("quadrotor", {}), ("drift_car", {})])
def test_the_contract_of_robots_holds(name, parameters):
    made(name)
    check_robot(name, **parameters)


@pytest.mark.parametrize("vehicle", ["hummingbird", "crazyflie"])
def test_a_quadrotor_hovers_at_its_weight_and_climbs_with_twice_that(vehicle):
    robot = made("quadrotor", vehicle=vehicle)
    neutral = robot.system.neutral_control
    at_rest = run(robot, [neutral] * 50, robot.system.neutral_state)
    np.testing.assert_allclose(at_rest, np.tile(robot.system.neutral_state, (51, 1)), atol=1e-6)
    speed = run(robot, [neutral * [2.0, 0.0, 0.0, 0.0]] * 15, robot.system.neutral_state)[:, 2]
    after = 2 if vehicle == "hummingbird" else 14  # the motors of the other are slower
    assert speed[after + 1] - speed[after] == pytest.approx(9.81 * 0.02, rel=0.15)


def test_a_quadrotor_follows_commanded_rates():
    robot = made("quadrotor")
    command = np.array([robot.system.neutral_control[0], 1.0, -0.5, 0.8])
    states = run(robot, [command] * 25, robot.system.neutral_state)
    np.testing.assert_allclose(states[-1, 3:6], [1.0, -0.5, 0.8], atol=0.1)
    assert states[10, 7] > 0.1, "a roll to the right raises the left side"
    assert states[10, 6] > 0.05, "a negative pitch rate raises the nose"


@pytest.mark.parametrize("name", ["quadrotor", "free.xml"])
def test_up_turns_as_the_motion_of_a_rigid_body_says(name, folder):
    robot = made("quadrotor") if name == "quadrotor" else made("mujoco", folder / name)
    states = under_random_controls(robot, 40, 0.8)
    turned = np.abs(np.diff(states[:, 6:9], axis=0)).max() / robot.system.dt
    off = np.abs(robot.system.acceleration(states[:-1], states[1:])[:, 6:9]).max()
    assert off < 0.05 * max(turned, 0.2)


def test_a_brick_falls_with_gravity_along_its_own_up(folder):
    robot = made("mujoco", folder / "free.xml")
    start = np.array([0.4, -0.3, 0.2, 0.0, 0.0, 0.0, 0.6, 0.0, 0.8, 0.0, 0.0])
    states = run(robot, [np.zeros(1)] * 5, start)
    np.testing.assert_allclose(states[5, :3] - start[:3], -9.81 * 5 * robot.system.dt * start[6:9], atol=1e-3)


@pytest.mark.parametrize("model", ["drift", "multi_body"])
def test_the_pose_of_a_car_by_its_motion_is_the_one_of_the_package(model):
    robot = made("drift_car", model=model)
    system, drawn = robot.system, np.random.default_rng(5)
    start = np.array([12.0, 0.0, 0.0, 0.02, 12.0, 12.0])
    with robot.simulator.open() as session:
        states, pose = session.reset(0, start), np.zeros(3)
        for _ in range(60):
            after, *_ = session.step(system.actuate(drawn.uniform(-0.4, 0.4, 2)))
            pose, states = system.move(pose, states, after), after
        inside = session._state
    np.testing.assert_allclose(pose[:2], inside[:2], atol=0.05)
    assert pose[2] == pytest.approx(inside[4], abs=0.01)
    assert abs(pose[1]) > 0.1


@pytest.mark.parametrize("model", ["drift", "multi_body"])
def test_a_compiled_car_is_the_one_of_the_package(model):
    session = made("drift_car", model=model).simulator.open()
    equations = getattr(
        import_module(f"vehiclemodels.vehicle_dynamics_{MODELS[model]}"), f"vehicle_dynamics_{MODELS[model]}"
    )
    vehicle = import_module("vehiclemodels.parameters_vehicle2").parameters_vehicle2()
    session.reset(0, [8.0, 0.2, 0.1, 0.05, 8.0, 8.2])

    def rate(state):
        return np.array(equations(state.tolist(), [(0.2 - state[2]) / 0.1, 3.0], vehicle))

    expected = session._state
    for _ in range(50):
        expected = rk4(rate, expected, 1e-3)
        expected[session._wheels] = np.maximum(expected[session._wheels], 0.0)
    session.step([3.0, 0.2])
    np.testing.assert_allclose(session._state, expected, rtol=1e-9, atol=1e-12)


def test_steering_to_the_left_turns_both_models_of_a_car_alike():
    steered = [(0.0, 0.1)] * 40
    drift, bodies = (
        run(made("drift_car", model=model), steered, [10.0, 0, 0, 0, 10.0, 10.0]) for model in ("drift", "multi_body")
    )
    assert drift[-1, 3] == pytest.approx(0.1, abs=1e-3)
    assert drift[-1, 2] > 0.2
    np.testing.assert_allclose(drift[-1, :3], bodies[-1, :3], rtol=0.15, atol=0.02)


def test_a_car_that_slides_at_full_power_spins_round_and_its_episode_ends():
    robot = made("drift_car")
    with robot.simulator.open() as session:
        session.reset(0, [14.0, -5.0, 1.0, -0.1, 14.0, 20.0])
        found = [session.step([6.0, -0.1]) for _ in range(40)]
    slip = [abs(np.arctan2(state[1], state[0])) for state, *_ in found]
    assert max(slip) > 1.5
    ended = [over for _, _, over, _ in found]
    assert ended[-1]
    assert ended == [not 1.0 <= state[0] <= 30.0 for state, *_ in found]


def test_the_channels_of_a_model_file_have_its_names_units_and_limits(folder):
    robot = made("mujoco", folder / "arm.xml")
    channels = [(c.name, c.unit, c.period) for c in robot.system.states]
    assert channels == [
        ("rail", "m", None),
        ("rail_speed", "m/s", None),
        ("swing", "rad", TURN),
        ("swing_speed", "rad/s", None),
    ]
    assert (robot.system.states[0].low, robot.system.states[0].high) == pytest.approx((-1.2, 1.2))
    assert (robot.system.controls[0].name, robot.system.controls[0].low, robot.system.controls[0].high) == (
        "push",
        -5.0,
        10.0,
    )
    assert robot.system.dt == pytest.approx(0.02)
    assert made("mujoco", folder / "arm.xml", dt=0.012).system.dt == pytest.approx(0.012)


def test_a_light_pendulum_swings_with_the_period_of_its_length(folder):
    robot = made("mujoco", folder / "arm.xml")
    angle = run(robot, [np.zeros(1)] * 200, [0.0, 0.0, 0.02, 0.0])[:, 2]
    falling = np.flatnonzero((angle[:-1] > 0.0) & (angle[1:] <= 0.0))
    assert np.diff(falling)[0] * 0.02 == pytest.approx(TURN * np.sqrt(0.5 / 9.81), abs=0.03)


@pytest.mark.parametrize(
    ("text", "error", "message"),
    [
        ("<mujoco", InvalidArgument, "MuJoCo cannot read it"),
        (
            ARM.replace('ctrllimited="true" ctrlrange="-5 10"', ""),
            IncompatibleSystem,
            "'push' has no limits: give it a ctrlrange",
        ),
        (
            ARM.replace('type="hinge" axis="0 1 0"', 'type="ball"'),
            IncompatibleSystem,
            "the ball joint 'swing' has no angles",
        ),
        ("<mujoco><worldbody/></mujoco>", IncompatibleSystem, "at least one joint"),
    ],
)
def test_a_model_that_cannot_be_a_robot_is_refused_with_the_reason(text, error, message, tmp_path):
    (tmp_path / "odd.xml").write_text(text)
    with pytest.raises(error, match=message):
        made("mujoco", tmp_path / "odd.xml")


def test_the_time_of_a_sample_must_be_whole_steps_of_the_model(folder):
    with pytest.raises(InvalidArgument, match=r"expected a multiple of its time step, 0.004 s, got 0.01 s"):
        made("mujoco", folder / "arm.xml", dt=0.01)


def test_results_are_found_by_the_content_of_the_model_file(tmp_path):
    (tmp_path / "arm.xml").write_text(ARM)
    made("mujoco", tmp_path / "arm.xml")
    spec = Spec("mujoco", {"file": str(tmp_path / "arm.xml")})
    before = robots.identity(spec)
    assert robots.identity(spec) == before
    (tmp_path / "arm.xml").write_text(ARM.replace('mass="1"', 'mass="2"'))
    assert robots.identity(spec) != before


def test_a_recording_of_a_robot_without_a_reward_has_none(folder):
    robot = made("mujoco", folder / "arm.xml")
    recorded = robot.record(seed=1, duration=16.0).dataset
    assert {episode.rewards is None for episode in recorded.episodes} == {True}
    assert sum(len(episode.controls) for episode in recorded.episodes) == 800
