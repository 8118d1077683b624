"""How states move a pose, and how accelerations come out of velocities in a turning frame."""

import logging

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from sysid_evo import system as systems
from sysid_evo.angles import rotate
from sysid_evo.errors import IncompatibleSystem, InvalidSystem
from sysid_evo.motion import CentralDifferences, PlanarBody, motion_from_dict
from sysid_evo.registry.registry import motions
from sysid_evo.rigid_body import RigidBody
from sysid_evo.system import Channel, System
from tests.fixtures.motions import Clockwise, clockwise

MIXED = ("temperature", "yaw_rate", "lateral_speed", "forward_speed")
IN_SPACE = ("temperature", *reversed(RigidBody().roles().values()))
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


@pytest.mark.parametrize(("turn", "spin_up"), [(lambda t: 3.0 + 0.0 * t, 0.0), (lambda t: 2.0 * t, 2.0)])
def test_only_the_yaw_rate_of_a_body_that_coasts_straight_accelerates_when_it_spins_up(turn, spin_up, car):
    states = coasting(car.dt, 200, turn)
    acceleration = car.acceleration(states[:-1], states[1:])
    np.testing.assert_allclose(acceleration, np.tile([0.0, 0.0, spin_up], (199, 1)), rtol=1e-9, atol=1e-12)


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


def test_a_left_turn_raises_the_heading_and_changing_speeds_count_with_their_mean():
    pose, turning = np.zeros((1, 3)), np.array([[1.0, 0.0, 1.0]])
    for _ in range(10):
        pose = PlanarBody().move(pose, turning, turning, 0.05, NAMES)
    assert pose[0, 2] == pytest.approx(0.5)
    assert (pose[0, :2] > 0).all()
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


@pytest.mark.parametrize(
    ("motion", "names"),
    [(PlanarBody(), MIXED), (PlanarBody(lateral=None), MIXED), (RigidBody(), IN_SPACE)],
    ids=["planar", "without lateral", "rigid"],
)
def test_the_gradient_form_is_the_derivative_of_integrate_and_turning(motion, names, rng):
    state, acceleration, gradient = 3.0 * rng.standard_normal((3, 12, len(names)))
    state[0, [i for i, name in enumerate(names) if name.endswith("_rate")]] = 0.0
    acceleration[0] = 0.0
    form, differences = motion.gradient_form(names), CentralDifferences(motion, names)
    given = state, acceleration, 0.3, gradient
    for found, expected in zip(form.of_integrate(*given), differences.of_integrate(*given), strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-6)
    turned = form.of_frame_rotation(state, gradient), differences.of_frame_rotation(state, gradient)
    np.testing.assert_allclose(*turned, rtol=1e-6, atol=1e-6)


def test_one_remark_says_that_a_motion_has_no_compiled_form(car, caplog):
    systems._remark_slow.cache_clear()
    with caplog.at_level(logging.WARNING):
        for _ in range(3):
            assert clockwise(car).motion_kernel() is None
    assert [record.getMessage() for record in caplog.records] == [
        "motion clockwise has no compiled form: its systems run in NumPy, about ten times slower"
    ]


def test_a_system_with_a_registered_motion_is_stored_and_read(car, register):
    register(motions, "clockwise", Clockwise)
    system = clockwise(car)
    assert System.from_dict(system.to_dict()) == system


def test_an_unknown_motion_is_refused_with_the_known_ones_and_the_option_that_loads_a_plugin(car):
    with pytest.raises(
        InvalidSystem, match=r"expected one of planar_body, rigid_body, got 'hovercraft'.*--plugin FILE"
    ):
        System.from_dict({**car.to_dict(), "motion": {"kind": "hovercraft"}})
    with pytest.raises(InvalidSystem, match="motion planar_body: cannot be made from wheels"):
        motion_from_dict({"kind": "planar_body", "wheels": 4})


def test_no_class_inherits_the_compiled_form_of_a_planar_body():
    with pytest.raises(TypeError, match="Skid: no class may be derived from PlanarBody; derive it from Motion"):

        class Skid(PlanarBody):  # type: ignore[misc]  # that is what is refused
            pass


def test_the_continuous_form_is_the_limit_of_the_sampled_one(car, rng):
    rigid = System(tuple(Channel(name) for name in IN_SPACE), (), 0.05, RigidBody())
    for system in (car, clockwise(car), rigid):
        state, dt = rng.standard_normal((6, system.nx)), 1e-7
        coasting = system.motion.integrate(state, np.zeros_like(state), dt, system.state_names)
        np.testing.assert_allclose((coasting - state) / dt, system.frame_rotation(state), atol=1e-5)


def test_a_pose_seen_from_another_is_where_a_body_there_would_put_it(car):
    origin = np.array([1.0, 2.0, np.pi / 2])
    np.testing.assert_allclose(
        car.relative_pose(origin, np.array([1.0, 3.0, np.pi])), [1.0, 0.0, np.pi / 2], atol=1e-12
    )
    with pytest.raises(IncompatibleSystem, match="clockwise does not define relative poses"):
        clockwise(car).relative_pose(origin, origin)


def test_velocities_undo_the_movement_of_the_pose(car):
    state, pose, dt = np.array([1.2, -0.3, 0.8]), np.array([0.4, 0.1, 2.0]), 1e-6
    rate = (car.move(pose, state, state, dt) - pose) / dt
    told = car.motion.velocities(pose, rate)
    np.testing.assert_allclose([told[name] for name in car.state_names], state, atol=1e-5)
