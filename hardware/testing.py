"""The contract of a robot, rule by rule, and the contracts of all kinds of plugins.

A physical robot (its ``dynamics`` is None) is never connected: only checks without a connection are made.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from hardware.connection import Connection, Measurement
from hardware.robot import Robot
from sysid_evo.errors import ContractViolation, InvalidArgument, LinkLost, ShapeError
from sysid_evo.models.dynamics import Dynamics, started
from sysid_evo.registry import Spec, robots
from sysid_evo.system import System
from sysid_evo.testing.closed_loop import CONTROLLER, TASK
from sysid_evo.testing.contract import Contract, NotApplicable, expect, expect_error, expect_numbers, normal, same
from sysid_evo.testing.evolution import STRATEGY
from sysid_evo.testing.models import (
    ADAPTER,
    MODEL,
    StepInputs,
    expect_independent_rows,
    expect_pure_step,
    expect_same_compiled,
    expect_shape_and_type,
)
from sysid_evo.testing.readers import READER
from sysid_evo.types import Array

FRAMES = 40
LOOKS = 100
"""Number of calls of measure within which the next frame must come."""
SECONDS = 2.0
ROWS = 8


@dataclass(frozen=True)
class RobotExample:
    """A robot, and the spec that it was made from."""

    spec: Spec
    robot: Robot

    @property
    def dynamics(self) -> Dynamics:
        """Dynamics of an emulated robot. Raises `NotApplicable` for a physical one."""
        if self.robot.dynamics is None:
            raise NotApplicable
        return self.robot.dynamics

    def connect(self) -> Connection:
        """Open a session with an emulated robot. Raises `NotApplicable` for a physical one."""
        assert self.dynamics is not None
        return self.robot.connect(seed=1)


def check_robot(name: str, **parameters: Any) -> None:
    """Raise `ContractViolation` listing every rule that the registered robot ``name`` violates."""
    ROBOT.check(name, **parameters)


def _robot(name: str, **parameters: Any) -> tuple[RobotExample]:
    spec = robots.check(name, **parameters)
    return (RobotExample(spec, robots.make(spec)),)


def it_has_a_name_and_a_system(given: RobotExample) -> None:
    """It has a name, and a system whose controls have finite limits"""
    robot = given.robot
    expect(isinstance(robot, Robot), f"expected a hardware.robot.Robot, got a {type(robot).__name__}")
    expect(isinstance(robot.name, str) and robot.name, f"expected a name, got {robot.name!r}")
    if not isinstance(robot.system, System):
        raise ContractViolation(f"expected a system, got {robot.system!r}")
    for channel in robot.system.controls:
        expect(channel.bounded, f"control {channel.name!r} has no finite limits: give low and high, or levels")


def another_is_the_same(given: RobotExample) -> None:
    """The same name and parameters make the same robot"""
    other = robots.make(given.spec)
    expect(other.system == given.robot.system and other.name == given.robot.name, "a second one has another system")


def its_dynamics_are_of_its_system(given: RobotExample) -> None:
    """Its dynamics step by one sampling time of its own system"""
    system = given.dynamics.system
    expect(system == given.robot.system, f"the dynamics are those of {system.name or 'another system'}")


def the_carry_begins_with_the_state(given: RobotExample) -> None:
    """The carry begins with the state"""
    inputs = _some_inputs(given.dynamics, steps=0)
    neutral = np.tile(given.robot.system.neutral_state, (ROWS, 1))
    expect(same(inputs.carry[:, : neutral.shape[1]], neutral), "carry[:, :nx] after start is not the last state")


def a_step_has_the_right_shape_and_type(given: RobotExample) -> None:
    """A step turns a carry (B, n_carry) into a carry of the same shape, finite and in float64"""
    expect_shape_and_type(given.dynamics, _some_inputs(given.dynamics))


def rows_are_independent(given: RobotExample) -> None:
    """Every row of a batch is computed for itself"""
    expect_independent_rows(given.dynamics, _some_inputs(given.dynamics))


def a_step_is_pure(given: RobotExample) -> None:
    """A step changes neither its arguments nor its own later results"""
    expect_pure_step(given.dynamics, _some_inputs(given.dynamics))


def the_compiled_form_steps_as_step_does(given: RobotExample) -> None:
    """The compiled form steps as step does"""
    expect_same_compiled(given.dynamics, _some_inputs(given.dynamics))


def a_session_shows_frames(given: RobotExample) -> None:
    """A session shows frame after frame, with rising numbers and times and a pose (n_pose,)"""
    with given.connect() as connection:
        frames = [_next(connection, given.robot.system.dt) for _ in range(FRAMES)]
    for before, after in pairwise(frames):
        expect(after.frame > before.frame, f"frame {after.frame} comes after {before.frame}")
        expect(after.source_time > before.source_time, f"{after.source_time} s comes after {before.source_time} s")
        expect(after.arrival_time >= after.source_time, f"frame {after.frame} arrives before it is taken")
        if after.valid:
            expect_numbers("pose", after.pose, (given.robot.system.n_pose,))


def the_seed_decides(given: RobotExample) -> None:
    """The same seed and the same commands give the same session"""
    command = _extremes(given.robot.system)[0]
    first, again = (_driven(given, command, valid_for=SECONDS) for _ in range(2))
    expect(same(first, again), "the same seed gives other poses")


def a_command_moves_it(given: RobotExample) -> None:
    """A command moves it, and only as long as it is valid"""
    system = given.robot.system
    if system.n_pose == 0:
        raise NotApplicable
    resting = _driven(given, system.neutral_control, valid_for=SECONDS)
    moves = [_driven(given, command, valid_for=SECONDS) for command in _extremes(system)]
    expect(any(not same(moved, resting) for moved in moves), "no command changes where it goes")
    for command, moved in zip(_extremes(system), moves, strict=True):
        if not same(moved, resting):
            short = _driven(given, command, valid_for=2.0 * system.dt)
            expect(not same(short, moved), "a command acts after the time it is valid for")


def a_command_that_is_not_legal_is_refused(given: RobotExample) -> None:
    """A command of the wrong shape, beyond its limits or valid for no time is refused"""
    system = given.robot.system
    neutral, beyond = system.neutral_control, np.array([channel.high + 1.0 for channel in system.controls])
    wrong: list[tuple[Array, float, type[Exception]]] = [
        (np.zeros(system.nu + 1), 1.0, ShapeError),
        (beyond, 1.0, InvalidArgument),
        (neutral, 0.0, InvalidArgument),
    ]
    with given.connect() as connection:
        for control, valid_for, error in wrong:
            when = f"{control} valid for {valid_for:g} s"
            expect_error(error, when, connection.send, control, valid_for=valid_for)


def a_closed_session_is_over(given: RobotExample) -> None:
    """A session can be closed twice, and is over then: commands raise LinkLost"""
    connection = given.connect()
    connection.close()
    connection.close()
    expect_error(LinkLost, "after close", connection.send, given.robot.system.neutral_control, valid_for=1.0)


CHECKS = (
    it_has_a_name_and_a_system,
    another_is_the_same,
    its_dynamics_are_of_its_system,
    the_carry_begins_with_the_state,
    a_step_has_the_right_shape_and_type,
    rows_are_independent,
    a_step_is_pure,
    the_compiled_form_steps_as_step_does,
    a_session_shows_frames,
    the_seed_decides,
    a_command_moves_it,
    a_command_that_is_not_legal_is_refused,
    a_closed_session_is_over,
)
ROBOT = Contract(robots, _robot, CHECKS)
CONTRACTS = {one.registry.kind: one for one in (MODEL, TASK, CONTROLLER, STRATEGY, ADAPTER, ROBOT, READER)}


def _some_inputs(dynamics: Dynamics, steps: int = 20) -> StepInputs:
    """Return carries after some steps from rest under random legal controls, and the next inputs."""
    system, rng = dynamics.system, np.random.default_rng(3)
    carry = started(dynamics, np.tile(system.neutral_state, (ROWS, 1)), normal(dynamics.n_draws, ROWS, rng))
    for _ in range(steps):
        control = system.actuate(rng.uniform(-1.0, 1.0, (ROWS, system.nu)))
        carry = dynamics.step(carry, control, normal(dynamics.n_noise, ROWS, rng))
    control = system.actuate(rng.uniform(-1.0, 1.0, (ROWS, system.nu)))
    return StepInputs(carry, control, normal(dynamics.n_noise, ROWS, rng))


def _next(connection: Connection, timeout: float) -> Measurement:
    for _ in range(LOOKS):
        frame = connection.measure(timeout)
        if frame is not None:
            return frame
    raise ContractViolation(f"no frame within {LOOKS} calls of measure({timeout:g})")


def _extremes(system: System) -> list[Array]:
    """Return one command for each control: it at its upper limit, the others neutral; and all at theirs."""
    high = np.array([channel.high for channel in system.controls])
    single = [np.where(np.arange(system.nu) == i, high, system.neutral_control) for i in range(system.nu)]
    return [high, *single]


def _driven(given: RobotExample, command: Array, *, valid_for: float) -> Array:
    """Return the poses (K, n_pose) of a session of some seconds that begins with one command."""
    poses = []
    dt = given.robot.system.dt
    with given.connect() as connection:
        began = _next(connection, dt).source_time
        connection.send(command, valid_for=valid_for)
        for _ in range(LOOKS * FRAMES):
            frame = _next(connection, dt)
            poses.append(frame.pose)
            if frame.source_time - began >= 0.9 * SECONDS:
                break
    return np.array(poses)
