"""The contract of motions: all that are listed keep it, each broken one is caught with its sentence."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from sysid_evo.arrays import Array
from sysid_evo.errors import ContractViolation, InvalidSystem
from sysid_evo.motion import Motion, PlanarBody
from sysid_evo.motion.compiled_form import MotionKernel
from sysid_evo.motion.gradient_form import MotionGradient
from sysid_evo.registry import motions
from sysid_evo.testing import check_motion, run_motion_checks
from sysid_evo.testing import motions as kit
from tests.broken import broken, sentence

PLANE = PlanarBody("u", "v", "r")


@dataclass(frozen=True)
class Body(Motion):
    """A sound one: a planar body in NumPy alone, with channels u, v and r."""

    kind = "broken"
    n_pose = 3
    pose_names = ("x", "y", "heading")
    pose_units = ("m", "m", "rad")

    label: str = "anything"

    def roles(self) -> dict[str, str]:
        return PLANE.roles()

    def acceleration(self, before: Array, after: Array, dt: float, names: Sequence[str]) -> Array:
        return PLANE.acceleration(before, after, dt, names)

    def integrate(self, state: Array, acceleration: Array, dt: float, names: Sequence[str]) -> Array:
        return PLANE.integrate(state, acceleration, dt, names)

    def turning(self, state: Array, names: Sequence[str]) -> Array:
        return PLANE.turning(state, names)

    def move(self, pose: Array, before: Array, after: Array, dt: float, names: Sequence[str]) -> Array:
        return PLANE.move(pose, before, after, dt, names)


class OfAnotherKind(Body):
    kind = "another"


class Unnamed(Body):
    pose_units = ("m", "m")


class Uncritical(Body):
    def check(self, names: Sequence[str]) -> None:
        if len(names) < len(self.roles()):
            raise InvalidSystem("something is missing")


class Forgetful(Body):
    def to_dict(self) -> dict[str, Any]:
        return {"kind": self.kind, "label": "something else"}


class SinglePrecision(Body):
    def move(self, pose: Array, before: Array, after: Array, dt: float, names: Sequence[str]) -> Array:
        return super().move(pose, before, after, dt, names).astype(np.float32)


class Overwriting(Body):
    def turning(self, state: Array, names: Sequence[str]) -> Array:
        turned = super().turning(state, names)
        state[:, names.index("v")] = 0.0
        return turned


class Comparing(Body):
    def move(self, pose: Array, before: Array, after: Array, dt: float, names: Sequence[str]) -> Array:
        moved = super().move(pose, before, after, dt, names)
        return moved + 1e-3 * dt * before[:, :1].mean()


class NotItsInverse(Body):
    def acceleration(self, before: Array, after: Array, dt: float, names: Sequence[str]) -> Array:
        return super().acceleration(before, after, dt, names) * (1.0 + 1e-6 * (np.array(names) != kit.UNRELATED))


class TurningTheOtherWay(Body):
    def turning(self, state: Array, names: Sequence[str]) -> Array:
        return -super().turning(state, names)


class TakingTheFirst(Body):
    """Stretches time for the first channel, whichever it is, there and back."""

    def acceleration(self, before: Array, after: Array, dt: float, names: Sequence[str]) -> Array:
        rate = super().acceleration(before, after, dt, names)
        rate[..., 0] *= 2.0
        return rate

    def integrate(self, state: Array, acceleration: Array, dt: float, names: Sequence[str]) -> Array:
        slower = np.array(acceleration)
        slower[..., 0] *= 0.5
        return super().integrate(state, slower, dt, names)


class Jumping(Body):
    def move(self, pose: Array, before: Array, after: Array, dt: float, names: Sequence[str]) -> Array:
        return super().move(pose, before, after, dt, names) + np.array([0.01, 0.0, 0.0])


class Mirrored(Body):
    def velocities(self, pose: Array, rate: Array) -> dict[str, Array]:
        found = PLANE.velocities(pose, rate)
        return {**found, "v": -found["v"]}


class Unturned(Body):
    def seen_from(self, origin: Array, pose: Array) -> Array:
        return pose - origin


class OtherKernel(Body):
    def kernel(self, names: Sequence[str]) -> MotionKernel | None:
        form = PLANE.kernel(names)
        forward, lateral, yaw_rate = form.parameters[:3]
        return replace(form, parameters=np.array([lateral, forward, yaw_rate, *form.parameters[3:]]))


class OtherGradient(Body):
    def gradient_form(self, names: Sequence[str]) -> MotionGradient:
        return PlanarBody("v", "u", "r").gradient_form(names)


BROKEN: list[tuple[type[Motion], Callable[..., None], str]] = [
    (OfAnotherKind, kit.it_says_what_it_is, "its kind is 'another'"),
    (Unnamed, kit.it_says_what_it_is, "n_pose is 3, with 3 names and 2 units"),
    (Uncritical, kit.a_missing_channel_is_named, "expected InvalidSystem without 'u', got no error"),
    (Forgetful, kit.it_can_be_stored, "it comes back as .*something else"),
    (SinglePrecision, kit.results_have_the_right_shape_and_type, r"move: expected \(12, 3\) float64, got .* float32"),
    (Overwriting, kit.everything_is_pure, "turning overwrites its arguments"),
    (Comparing, kit.rows_are_independent, "move of a row changes with the other rows"),
    (NotItsInverse, kit.integration_undoes_differentiation, "gives another state"),
    (TurningTheOtherWay, kit.turning_is_what_a_short_step_does, "integrate changes it at another rate"),
    (TakingTheFirst, kit.other_channels_are_plain_differences, "a channel without a role is turned"),
    (Jumping, kit.two_halves_are_a_whole, "halving the step leaves (0.99|1.0.) of it"),
    (Mirrored, kit.velocities_move_the_pose, "v is not the one that moved the pose"),
    (Unturned, kit.where_it_is_seen_from_does_not_matter, "it moves otherwise"),
    (OtherKernel, kit.the_compiled_form_is_the_same, "integrate gives another result"),
    (OtherGradient, kit.the_gradient_form_is_its_derivative, "derivative of integrate by the state is another"),
]


@pytest.mark.parametrize("name", motions.names())
def test_every_motion_keeps_every_sentence(name: str) -> None:
    check_motion(name)


def test_a_planar_body_without_lateral_speed_keeps_every_sentence() -> None:
    results = list(run_motion_checks("planar_body", lateral=None))
    assert broken(results) == {}
    assert len(results) == 1 + len(kit.CHECKS)


def test_a_sound_motion_keeps_every_sentence_that_applies(register: Callable[..., Any]) -> None:
    register(motions, "broken", Body)
    results = list(run_motion_checks("broken"))
    assert broken(results) == {}
    assert len(results) == 1 + len(kit.CHECKS) - 3


@pytest.mark.parametrize(("made", "check", "reason"), BROKEN)
def test_a_broken_motion_is_caught_with_the_one_sentence_it_breaks(
    made: type[Motion], check: Callable[..., None], reason: str, register: Callable[..., Any]
) -> None:
    register(motions, "broken", made)
    found = broken(run_motion_checks("broken"))
    assert list(found) == [sentence(check)]
    with pytest.raises(ContractViolation, match=f"motion 'broken' breaks 1 of .*\n- .*{reason}"):
        check_motion("broken")


def test_every_sentence_has_something_that_breaks_it() -> None:
    assert {check for _, check, _ in BROKEN} == set(kit.CHECKS)
