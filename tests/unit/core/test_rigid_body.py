"""A rigid body in space: against closed forms, its derivative, and its frames."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sysid_evo.errors import InvalidSystem
from sysid_evo.motion import motion_from_dict
from sysid_evo.rigid_body import RigidBody
from sysid_evo.system import Channel, System

NAMES = (
    "temperature", "yaw_rate", "up_z", "forward_speed", "roll_rate", "up_y", "vertical_speed", "pitch_rate",
    "lateral_speed", "up_x",
)  # fmt: skip
MIXED = System(tuple(Channel(name) for name in NAMES), (), 0.05, RigidBody())
IDENTITY = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])


def state_of(speeds, rates, up=(0.0, 0.0, 1.0)):
    values = dict(zip(RigidBody().roles().values(), (*speeds, *rates, *up), strict=True))
    return np.array([[values.get(name, 20.0) for name in NAMES]])


def attitude(pose):
    return Rotation.from_quat(pose[..., [4, 5, 6, 3]])


def test_integration_and_differentiation_invert_each_other(rng):
    before, after = rng.uniform(-20.0, 20.0, (2, 50, len(NAMES)))
    np.testing.assert_allclose(MIXED.integrate(before, MIXED.acceleration(before, after)), after, rtol=0, atol=1e-12)
    np.testing.assert_allclose(MIXED.acceleration(before, MIXED.integrate(before, after)), after, rtol=0, atol=1e-11)


def test_a_body_that_tumbles_while_it_coasts_has_no_acceleration_except_of_its_rates(rng):
    """Velocity and up are constant in the world; the attitude turns by the mean rates of every sample."""
    rates = np.cumsum(rng.uniform(-1.0, 1.0, (101, 3)), axis=0)
    turning = [Rotation.identity()]
    for first, second in pairwise(rates):
        turning.append(turning[-1] * Rotation.from_rotvec(0.5 * MIXED.dt * (first + second)))
    back = Rotation.concatenate(turning).inv()
    seen = np.concatenate([
        state_of(v, r, u)
        for v, r, u in zip(back.apply([1.3, -0.4, 0.7]), rates, back.apply([0.0, 0.0, 1.0]), strict=True)
    ])  # fmt: skip
    found = MIXED.acceleration(seen[:-1], seen[1:])
    expected = np.zeros_like(found)
    columns = [NAMES.index(name) for name in ("roll_rate", "pitch_rate", "yaw_rate")]
    expected[:, columns] = np.diff(rates, axis=0) / MIXED.dt
    np.testing.assert_allclose(found, expected, atol=1e-11)


def test_a_constant_velocity_without_rates_is_a_straight_line():
    state, pose = state_of((1.0, -2.0, 0.5), (0.0, 0.0, 0.0)), IDENTITY[None]
    for _ in range(40):
        pose = MIXED.move(pose, state, state)
    np.testing.assert_allclose(pose, [[2.0, -4.0, 1.0, 1.0, 0.0, 0.0, 0.0]], atol=1e-12)


def test_constant_rates_give_the_exact_attitude_through_the_vertical_and_after_many_turns():
    rates = np.array([0.4, 7.0, -1.0])
    state, pose, norms = state_of((0.0, 0.0, 0.0), rates), IDENTITY[None], []
    for k in range(1, 401):
        pose = MIXED.move(pose, state, state)
        norms.append(np.linalg.norm(pose[0, 3:]))
        assert (attitude(pose[0]).inv() * Rotation.from_rotvec(rates * 0.05 * k)).magnitude() < 1e-12
    np.testing.assert_allclose(norms, 1.0, atol=1e-15)


def helix_error(dt):
    """Distance from the closed form after 2 s at (1.2, 0.3, -0.2) m/s in the body and constant rates."""
    speeds, rates, pose = np.array([1.2, 0.3, -0.2]), np.array([0.3, -0.5, 1.5]), IDENTITY[None]
    state = state_of(speeds, rates)
    for _ in range(round(2.0 / dt)):
        pose = MIXED.move(pose, state, state, dt)
    turned = 2.0 * np.linalg.norm(rates)
    axis = rates / np.linalg.norm(rates)
    once = np.cross(axis, speeds)
    way = 2.0 * speeds + 2.0 / turned * (
        (1.0 - np.cos(turned)) * once + (turned - np.sin(turned)) * np.cross(axis, once)
    )
    return float(np.linalg.norm(pose[0, :3] - way))


def test_the_position_on_a_helix_is_second_order():
    coarse, fine = helix_error(0.05), helix_error(0.025)
    assert 1e-5 < coarse < 1e-3
    assert coarse / fine == pytest.approx(4.0, rel=0.02)


@pytest.mark.parametrize(("frame", "sign"), [("ENU", 1.0), ("NED", -1.0)])
def test_a_trial_begins_with_the_attitude_of_its_state_and_the_axis_of_the_frame(frame, sign, rng):
    motion, up = RigidBody(frame=frame), rng.standard_normal((20, 3))
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    up[0], up[1] = (0.0, 0.0, sign), (0.0, 0.0, -sign)
    states = np.concatenate([state_of((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), u) for u in up])
    pose = motion.initial_pose(states, NAMES)
    np.testing.assert_array_equal(pose[0], IDENTITY)
    np.testing.assert_allclose(attitude(pose).apply(up), np.tile([0.0, 0.0, sign], (20, 1)), atol=1e-9)
    assert motion_from_dict(motion.to_dict()) == motion


@pytest.mark.parametrize("frame", ["ENU", "NED"])
def test_velocities_undo_the_movement_of_the_pose(frame):
    system = System(MIXED.states, (), 0.05, RigidBody(frame=frame))
    start = Rotation.from_rotvec([0.3, -0.8, 1.1])
    up = start.inv().apply([0.0, 0.0, system.motion.up])
    state, dt = state_of((1.2, -0.3, 0.8), (0.5, -0.7, 0.2), up), 1e-6
    pose = np.array([[1.0, 2.0, 3.0, *start.as_quat()[[3, 0, 1, 2]]]])
    found = system.motion.velocities(pose, (system.move(pose, state, state, dt) - pose) / dt)
    for name, value in found.items():
        assert value[0] == pytest.approx(state[0, NAMES.index(name)], abs=1e-5), name


def test_a_pose_seen_from_another_is_where_a_body_there_would_put_it():
    turn = Rotation.from_rotvec([0.0, 0.0, np.pi / 2])
    origin = np.array([1.0, 2.0, 3.0, *turn.as_quat()[[3, 0, 1, 2]]])
    seen = MIXED.relative_pose(origin, np.array([1.0, 3.0, 4.0, 1.0, 0.0, 0.0, 0.0]))
    np.testing.assert_allclose(seen[:3], [1.0, 0.0, 1.0], atol=1e-12)
    assert (attitude(seen) * turn).magnitude() < 1e-12


def test_another_frame_and_a_derived_class_are_refused():
    with pytest.raises(InvalidSystem, match="expected frame ENU or NED, got 'NWU'"):
        RigidBody(frame="NWU")
    with pytest.raises(TypeError, match="Drone: no class may be derived from RigidBody; derive it from Motion"):

        class Drone(RigidBody):  # type: ignore[misc]  # that is what is refused
            pass
