"""How states move a pose, and how accelerations come out of velocities in a turning frame."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from sysid_evo.angles import rotate, wrap
from sysid_evo.engine.compiled.open_loop import kernel_step
from sysid_evo.kernels import LANES, DynamicsKernel, KernelSource, Layout, view
from sysid_evo.motion import CentralDifferences, PlanarBody
from sysid_evo.system import Channel, System

HEAD = Layout("nx", "dt")
MIXED = ("temperature", "yaw_rate", "lateral_speed", "forward_speed")
NAMES = ("forward_speed", "lateral_speed", "yaw_rate")
MOTIONS = {"planar": PlanarBody(), "without lateral": PlanarBody(lateral=None), "none": None}
fixed = settings(derandomize=True, deadline=None, database=None)
states = arrays(np.float64, (4, 3), elements=st.floats(-20.0, 20.0))


def system_with(motion, dt=0.05):
    return System(tuple(Channel(name) for name in NAMES), (), dt, motion)


def coasting(dt, n, turn):
    """The body velocities of a body that coasts straight at (1.3, -0.4) m/s while its yaw rate varies."""
    rate = turn(np.arange(n) * dt)
    heading = np.concatenate([[0.0], np.cumsum(rate[:-1] * dt)])
    u, v = rotate(np.full(n, 1.3), np.full(n, -0.4), -heading)
    return np.stack([u, v, rate], axis=1)


def test_a_body_that_spins_while_coasting_straight_has_zero_acceleration(car):
    states = coasting(car.dt, 200, lambda t: 3.0 + 0.0 * t)
    np.testing.assert_allclose(car.acceleration(states[:-1], states[1:]), 0.0, atol=1e-12)


def test_only_the_yaw_rate_of_a_coasting_body_accelerates_when_it_spins_up(car):
    states = coasting(car.dt, 200, lambda t: 2.0 * t)
    acceleration = car.acceleration(states[:-1], states[1:])
    np.testing.assert_allclose(acceleration[:, :2], 0.0, atol=1e-12)
    np.testing.assert_allclose(acceleration[:, 2], 2.0, rtol=1e-9)


def test_a_quarter_turn_to_the_left_without_a_force_leaves_the_velocity_on_the_right(car):
    quarter = np.array([[1.0, 0.0, np.pi / 2 / car.dt]])
    np.testing.assert_allclose(car.integrate(quarter, np.zeros((1, 3)))[:, :2], [[0.0, -1.0]], atol=1e-12)


@pytest.mark.parametrize("motion", MOTIONS.values(), ids=MOTIONS)
@given(before=states, after=states, dt=st.floats(0.005, 0.2))
@fixed
def test_integration_inverts_differentiation(motion, before, after, dt):
    system = system_with(motion, dt)
    scale = 1.0 + np.abs(before).max() + np.abs(after).max()
    again = system.integrate(before, system.acceleration(before, after))
    np.testing.assert_allclose(again, after, rtol=0, atol=8 * np.finfo(float).eps * scale)


@pytest.mark.parametrize("motion", MOTIONS.values(), ids=MOTIONS)
@given(state=states, acceleration=states)
@fixed
def test_differentiation_inverts_integration(motion, state, acceleration):
    system = system_with(motion)
    scale = (1.0 + np.abs(state).max() + np.abs(acceleration).max()) / system.dt
    again = system.acceleration(state, system.integrate(state, acceleration))
    np.testing.assert_allclose(again, acceleration, rtol=0, atol=8 * np.finfo(float).eps * scale)


@pytest.mark.parametrize("motion", [None, PlanarBody(lateral=None)])
def test_without_a_turning_frame_accelerations_are_plain_differences(motion):
    system = system_with(motion)
    before, after = np.array([[1.0, 2.0, 3.0]]), np.array([[1.5, 1.0, 3.0]])
    np.testing.assert_allclose(system.acceleration(before, after), [[10.0, -20.0, 0.0]], rtol=1e-12)


def test_neither_direction_overwrites_its_arguments(car, rng):
    a, b = rng.standard_normal((2, 5, 3))
    kept = a.copy(), b.copy()
    car.acceleration(a, b)
    car.integrate(a, b)
    np.testing.assert_array_equal(a, kept[0])
    np.testing.assert_array_equal(b, kept[1])


def circle_error(dt, lateral):
    """Distance from the closed form after 2 s at 1.2 m/s forward, ``lateral`` m/s sideways and 1.5 rad/s."""
    u, r, n = 1.2, 1.5, round(2.0 / dt)
    state = np.array([[u, lateral, r]])
    pose = np.zeros((1, 3))
    for _ in range(n):
        pose = PlanarBody().move(pose, state, state, dt, NAMES)
    t = n * dt
    x = (u * np.sin(r * t) + lateral * (np.cos(r * t) - 1.0)) / r
    y = (u * (1.0 - np.cos(r * t)) + lateral * np.sin(r * t)) / r
    assert pose[0, 2] == pytest.approx(r * t, rel=1e-12)
    return float(np.hypot(pose[0, 0] - x, pose[0, 1] - y))


@pytest.mark.parametrize("lateral", [0.0, 0.3])
def test_the_pose_on_a_steady_circle_is_second_order(lateral):
    coarse, fine = circle_error(0.05, lateral), circle_error(0.025, lateral)
    assert coarse < 1e-3
    assert coarse / fine == pytest.approx(4.0, rel=0.02)


def test_a_left_turn_raises_the_heading_and_bends_to_positive_y():
    pose = np.zeros((1, 3))
    for _ in range(10):
        pose = PlanarBody().move(pose, np.array([[1.0, 0.0, 1.0]]), np.array([[1.0, 0.0, 1.0]]), 0.05, NAMES)
    assert pose[0, 2] == pytest.approx(0.5)
    assert pose[0, 0] > 0
    assert pose[0, 1] > 0


def test_changing_speeds_count_with_their_mean():
    before, after = np.array([[1.0, 0.5, 0.0]]), np.array([[2.0, -0.5, 0.0]])
    moved = PlanarBody().move(np.array([[3.0, 4.0, np.pi / 2]]), before, after, 0.1, NAMES)
    np.testing.assert_allclose(moved, [[3.0, 4.15, np.pi / 2]], atol=1e-12)


def test_roles_find_their_channels_in_any_order_and_under_any_name(rng):
    mixed = System(
        tuple(Channel(name) for name in ("omega", "vx", "temperature", "vy")),
        (),
        0.05,
        PlanarBody(forward="vx", lateral="vy", yaw_rate="omega"),
    )
    plain = System(tuple(Channel(name) for name in (*NAMES, "temperature")), (), 0.05, PlanarBody())
    before, after = rng.standard_normal((2, 6, 4))

    def to_plain(x):
        return x[:, [1, 3, 0, 2]]

    np.testing.assert_array_equal(
        to_plain(mixed.acceleration(before, after)), plain.acceleration(to_plain(before), to_plain(after))
    )
    np.testing.assert_array_equal(
        to_plain(mixed.integrate(before, after)), plain.integrate(to_plain(before), to_plain(after))
    )
    assert mixed.motion is not None
    assert plain.motion is not None
    pose = rng.standard_normal((6, 3))
    np.testing.assert_array_equal(
        mixed.motion.move(pose, before, after, 0.05, mixed.state_names),
        plain.motion.move(pose, to_plain(before), to_plain(after), 0.05, plain.state_names),
    )


def test_the_heading_of_a_body_that_spins_on_stays_within_half_a_turn_either_way():
    spinning, pose, headings = np.array([[0.0, 0.0, 40.0]]), np.array([[0.0, 0.0, 1000.0]]), []
    for _ in range(50):
        pose = PlanarBody().move(pose, spinning, spinning, 0.05, NAMES)
        headings.append(pose[0, 2])
    assert np.abs(headings).max() <= np.pi
    turned = 1000.0 + 2.0 * np.arange(1, 51)
    np.testing.assert_allclose(np.exp(1j * np.array(headings)), np.exp(1j * turned), atol=1e-9)


@pytest.mark.parametrize("lateral", ["lateral_speed", None])
def test_one_body_moves_to_the_last_bit_as_it_does_among_many(lateral, rng):
    motion = PlanarBody(lateral=lateral)
    poses, before, after = 3.0 * rng.standard_normal((3, 500, 3))
    poses[0], before[0], after[0] = (0.0, 0.0, np.pi), 0.0, 0.0
    poses[1], poses[2] = (0.0, 0.0, -np.pi), (0.0, 0.0, np.nan)
    among = motion.move(poses, before, after, 0.05, NAMES)
    for pose, start, end, expected in zip(poses, before, after, among, strict=True):
        np.testing.assert_array_equal(motion.move(pose, start, end, 0.05, NAMES), expected)


def all_three(carry, control, noise, parameters, scratch):
    """Integrate the second nx rows of the carry, turn the third nx rows, and move the pose after them."""
    nx, dt, own = int(parameters[HEAD.nx]), parameters[HEAD.dt], view(parameters, HEAD.size)
    after, rate, pose = view(carry, nx * LANES), view(carry, 2 * nx * LANES), view(carry, 3 * nx * LANES)
    integrate(carry, after, nx, dt, own)  # noqa: F821  # bound below, as are the other two
    turn_frame(carry, rate, own)  # noqa: F821
    move_pose(pose, carry, after, dt, own)  # noqa: F821


@pytest.mark.parametrize("lateral", ["lateral_speed", None])
def test_the_compiled_form_integrates_turns_and_moves_as_the_form_on_arrays(lateral, rng):
    motion, nx, dt = PlanarBody(lateral=lateral), len(MIXED), 0.05
    state, acceleration = rng.standard_normal((2, 12, nx))
    pose = rng.uniform(-2.0, 2.0, (12, 3))
    form = motion.kernel(MIXED)
    bindings = {"integrate": form.integrate, "turn_frame": form.turn, "move_pose": form.move}
    kernel = DynamicsKernel(KernelSource(all_three, bindings), HEAD.pack(form.parameters, nx=nx, dt=dt))
    carry = np.concatenate([state, acceleration, acceleration, pose], axis=1)
    found = kernel_step(kernel, carry, np.zeros((12, 1)), precision="float64")
    after = motion.integrate(state, acceleration, dt, MIXED)
    np.testing.assert_allclose(found[:, nx : 2 * nx], after, atol=1e-7)
    turned = acceleration + motion.turning(state, MIXED)
    np.testing.assert_allclose(found[:, 2 * nx : 3 * nx], turned, atol=1e-7)
    moved = found[:, 3 * nx :] - motion.move(pose, state, after, dt, MIXED)
    moved[:, 2] = wrap(moved[:, 2])
    np.testing.assert_allclose(moved, 0.0, atol=1e-7)


@pytest.mark.parametrize("lateral", ["lateral_speed", None])
def test_the_gradient_form_is_the_derivative_of_integrate_and_turning(lateral, rng):
    motion = PlanarBody(lateral=lateral)
    state, acceleration, gradient = rng.standard_normal((3, 12, len(MIXED)))
    form, differences = motion.gradient_form(MIXED), CentralDifferences(motion, MIXED)
    for found, expected in zip(
        form.integrated(state, acceleration, 0.05, gradient),
        differences.integrated(state, acceleration, 0.05, gradient),
        strict=True,
    ):
        np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-7)
    turned = form.turned(state, gradient), differences.turned(state, gradient)
    np.testing.assert_allclose(*turned, rtol=1e-6, atol=1e-7)
