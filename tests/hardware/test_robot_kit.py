"""The contract of robots: all that are listed keep it, each broken one is caught with its sentence."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from hardware import testing as kit
from hardware.robot import Robot
from hardware.testing import check_robot, run_robot_checks
from sysid_evo.errors import ContractViolation
from sysid_evo.models import Dynamics
from sysid_evo.registry import make_robot, robots
from sysid_evo.system import System
from tests.broken import broken, sentence


class Around(Dynamics):
    """Dynamics that do as those inside them."""

    def __init__(self, inner):
        self.inner, self.system, self.n_carry = inner, inner.system, inner.n_carry
        self.n_lags, self.n_noise, self.n_draws = inner.n_lags, inner.n_noise, inner.n_draws

    def start(self, states, controls, draws=None):
        return self.inner.start(states, controls, draws)

    def step(self, carry, control, noise=None):
        return self.inner.step(carry, control, noise)


class StartsElsewhere(Around):
    def start(self, states, controls, draws=None):
        return super().start(states, controls, draws) + 0.01


class Miscounting(Around):
    def __init__(self, inner):
        super().__init__(inner)
        self.n_carry += 1


class Comparing(Around):
    def step(self, carry, control, noise=None):
        after = super().step(carry, control, noise)
        return after + 1e-3 * carry.mean(axis=0)


class Overwriting(Around):
    def step(self, carry, control, noise=None):
        after = super().step(carry, control, noise)
        control[:] = 0.0
        return after


class OtherKernel(Around):
    def step(self, carry, control, noise=None):
        return 1.001 * super().step(carry, control, noise)

    def kernel(self):
        return self.inner.kernel()


class Car(Robot):
    """A sound one: the emulated car under another name, with other dynamics or other sessions."""

    wrapping: type[Around] = Around

    def __init__(self):
        self.inner = make_robot("emulated_car")
        self.name, self.system = "car", self.inner.system
        self.dynamics: Dynamics = self.wrapping(self.inner.dynamics)

    def connect(self, *, seed=None):
        return self.altered(self.inner.connect(seed=seed))

    def altered(self, connection):
        return connection


class Nameless(Car):
    def __init__(self):
        super().__init__()
        self.name = ""


class Numbered(Car):
    made = 0

    def __init__(self):
        super().__init__()
        Numbered.made += 1
        self.name = f"car number {Numbered.made}"


class OtherSystem(Car):
    def __init__(self):
        super().__init__()
        system: System = self.system
        self.system = system.with_dt(2.0 * system.dt)


class CountingDown(Car):
    def altered(self, connection):
        measure = connection.measure

        def counted(timeout):
            frame = measure(timeout)
            return None if frame is None else replace(frame, frame=-frame.frame)

        connection.measure = counted  # type: ignore[method-assign]  # one session that is broken
        return connection


class Unseeded(Car):
    def connect(self, *, seed=None):
        return super().connect()


class Tireless(Car):
    def altered(self, connection):
        send = connection.send

        def lasting(control, *, valid_for):
            send(control, valid_for=100.0 * valid_for)

        connection.send = lasting  # type: ignore[method-assign]  # one session that is broken
        return connection


class Lenient(Car):
    def altered(self, connection):
        send = connection.send

        def clipped(control, *, valid_for):
            send(np.clip(control[: self.system.nu], -1.0, 1.0), valid_for=valid_for)

        connection.send = clipped  # type: ignore[method-assign]  # one session that is broken
        return connection


class Open(Car):
    def altered(self, connection):
        connection.close = lambda: None  # type: ignore[method-assign]  # one session that is broken
        return connection


def with_dynamics(wrapping):
    return type(wrapping.__name__, (Car,), {"wrapping": wrapping})


BROKEN: list[tuple[type[Car], Callable[..., None], str]] = [
    (Nameless, kit.it_says_what_it_is, "expected a name, got ''"),
    (Numbered, kit.another_is_the_same, "a second one has another"),
    (OtherSystem, kit.its_dynamics_are_of_its_system, "the dynamics are those of"),
    (with_dynamics(StartsElsewhere), kit.the_carry_begins_with_the_state, "after start is not the last state"),
    (
        with_dynamics(Miscounting),
        kit.a_step_has_the_right_shape_and_type,
        r"start gives a carry of \d+ numbers, n_carry",
    ),
    (with_dynamics(Comparing), kit.rows_are_independent, "changes with the other rows"),
    (with_dynamics(Overwriting), kit.a_step_is_pure, "step overwrites its arguments"),
    (with_dynamics(OtherKernel), kit.the_compiled_form_steps_as_step_does, "rows differ after one step in float64"),
    (CountingDown, kit.a_session_shows_frames, "frame -1 comes after 0"),
    (Unseeded, kit.the_seed_decides, "the same seed gives other poses"),
    (Tireless, kit.a_command_moves_it, "a command goes on after the time it is valid for"),
    (Lenient, kit.a_command_that_is_not_legal_is_refused, "valid for 1 s: expected ShapeError, got no error"),
    (Open, kit.a_closed_session_is_over, "after close: expected LinkLost, got no error"),
]


@pytest.mark.parametrize("name", robots.names())
def test_every_robot_keeps_every_sentence_and_a_physical_one_is_not_connected(name, monkeypatch):
    if make_robot(name).dynamics is None:
        monkeypatch.setattr(robots.get(name), "connect", lambda *_, **__: pytest.fail("it was connected"))
    check_robot(name)


def test_a_sound_robot_keeps_every_sentence_but_that_of_kernels(register):
    register(robots, "car", Car)
    results = list(run_robot_checks("car"))
    assert broken(results) == {}
    assert [result.sentence for result in results if result.idle] == [
        sentence(kit.the_compiled_form_steps_as_step_does)
    ]
    assert len(results) == 1 + len(kit.CHECKS)


@pytest.mark.parametrize(("made", "check", "reason"), BROKEN)
def test_a_broken_robot_is_caught_with_the_one_sentence_it_breaks(made, check, reason, register):
    register(robots, "broken", made)
    found = broken(run_robot_checks("broken"))
    assert list(found) == [sentence(check)]
    with pytest.raises(ContractViolation, match=f"robot 'broken' breaks 1 of .*\n- .*{reason}"):
        check_robot("broken")


def test_every_sentence_has_something_that_breaks_it():
    assert {check for _, check, _ in BROKEN} == set(kit.CHECKS)
