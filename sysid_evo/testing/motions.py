"""The contract of a motion, sentence by sentence."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from sysid_evo.angles import wrap
from sysid_evo.arrays import Array
from sysid_evo.errors import ContractViolation, IncompatibleSystem, InvalidSystem
from sysid_evo.motion import Motion, motion_from_dict
from sysid_evo.motion.gradient_form import CentralDifferences
from sysid_evo.registry import motions
from sysid_evo.testing.arrays import copied, expect_numbers, twice
from sysid_evo.testing.verdicts import Check, CheckResult, DoesNotApply, expect, raise_broken, verdicts

ROWS = 12
DT = 0.05
SHORT = 1e-6
UNRELATED = "a_channel_without_a_role"


@dataclass(frozen=True)
class Given:
    """A motion, the ``name`` it is registered under, and states (B, nx), accelerations (B, nx), poses (B, n_pose)."""

    name: str
    motion: Motion
    before: Array
    after: Array
    acceleration: Array
    pose: Array

    @classmethod
    def of(cls, name: str, motion: Motion) -> Given:
        """Return ``motion`` with random states of its roles and one further channel, which stands first."""
        rng = np.random.default_rng(11)
        shape = ROWS, len(_names(motion))
        before, after, acceleration = (rng.standard_normal(shape) for _ in range(3))
        return cls(name, motion, before, after, acceleration, rng.uniform(-2.0, 2.0, (ROWS, motion.n_pose)))

    @property
    def names(self) -> tuple[str, ...]:
        """The channels of the states."""
        return _names(self.motion)

    def apart(self, found: Array, expected: Array) -> Array:
        """Return how far poses (B, n_pose) lie from each other, angles the shorter way round."""
        difference = found - expected
        for i in self.motion.angles:
            difference[..., i] = wrap(difference[..., i])
        return difference

    def calls(self) -> dict[str, tuple[Callable[..., Array], tuple[Any, ...], int]]:
        """Return what works on arrays: the function, its arguments, and the width of its result."""
        motion, names, nx = self.motion, self.names, len(self.names)
        before, after, acceleration, pose = copied((self.before, self.after, self.acceleration, self.pose))
        return {
            "acceleration": (motion.acceleration, (before, after, DT, names), nx),
            "integrate": (motion.integrate, (before, acceleration, DT, names), nx),
            "turning": (motion.turning, (before, names), nx),
            "move": (motion.move, (pose, before, after, DT, names), motion.n_pose),
        }


def check_motion(name: str, **parameters: Any) -> None:
    """Raise `ContractViolation` listing every sentence that the registered motion ``name`` breaks."""
    raise_broken("motion", name, run_motion_checks(name, **parameters))


def run_motion_checks(name: str, **parameters: Any) -> Iterator[CheckResult]:
    """Yield the result of every check of the registered motion ``name``."""
    return verdicts(lambda: Given.of(name, motions.make(name, **parameters)), CHECKS)


def it_says_what_it_is(given: Given) -> None:
    """Its kind is its registered name; every coordinate of the pose has a name and a unit"""
    motion = given.motion
    expect(motion.kind == given.name, f"its kind is {motion.kind!r}")
    sizes = motion.n_pose, len(motion.pose_names), len(motion.pose_units)
    expect(len(set(sizes)) == 1, f"n_pose is {sizes[0]}, with {sizes[1]} names and {sizes[2]} units")
    channels = list(motion.roles().values())
    expect(channels and len(set(channels)) == len(channels), f"expected one channel for each role, got {channels}")


def a_missing_channel_is_named(given: Given) -> None:
    """check names the role and the channel that a system lacks"""
    for role, channel in given.motion.roles().items():
        try:
            given.motion.check([name for name in given.names if name != channel])
        except InvalidSystem as error:
            expect(role in str(error) and channel in str(error), f"expected {role!r} and {channel!r} in: {error}")
        else:
            raise ContractViolation(f"expected InvalidSystem without {channel!r}, got no error")


def it_can_be_stored(given: Given) -> None:
    """Stored as JSON and read again it is the same"""
    stored = {**given.motion.to_dict(), "kind": given.name}
    again = motion_from_dict(json.loads(json.dumps(stored, allow_nan=False)))
    expect(again == given.motion, f"it comes back as {again}")


def results_have_the_right_shape_and_type(given: Given) -> None:
    """acceleration, integrate, turning and move give finite float64 numbers of the right shape"""
    for name, (function, arguments, width) in given.calls().items():
        expect_numbers(name, function(*arguments), (ROWS, width))


def everything_is_pure(given: Given) -> None:
    """acceleration, integrate, turning and move change neither their arguments nor their own later results"""
    for name, (function, arguments, _) in given.calls().items():
        twice(name, function, *arguments)


def rows_are_independent(given: Given) -> None:
    """Every row of a batch is computed for itself"""
    for name, (function, arguments, _) in given.calls().items():
        together = function(*copied(arguments))
        for row in range(ROWS):
            of_row = (a[row : row + 1].copy() if isinstance(a, np.ndarray) else a for a in arguments)
            alone = function(*of_row)
            expect(np.allclose(alone, together[row], rtol=1e-9), f"{name} of a row changes with the other rows")


def integration_undoes_differentiation(given: Given) -> None:
    """integrate is the exact inverse of acceleration"""
    motion, names = given.motion, given.names
    after = motion.integrate(given.before, motion.acceleration(given.before, given.after, DT, names), DT, names)
    expect(np.allclose(after, given.after, rtol=1e-9), "integrating the acceleration gives another state")
    reached = motion.integrate(given.before, given.acceleration, DT, names)
    rate = motion.acceleration(given.before, reached, DT, names)
    expect(np.allclose(rate, given.acceleration, rtol=1e-7), "the acceleration of an integrated state is another one")


def turning_is_what_a_short_step_does(given: Given) -> None:
    """turning says how a state without acceleration changes in a short time"""
    names = given.names
    after = given.motion.integrate(given.before, np.zeros_like(given.before), SHORT, names)
    rate = (after - given.before) / SHORT
    expect(
        np.allclose(rate, given.motion.turning(given.before, names), rtol=1e-4, atol=1e-4),
        "integrate changes it at another rate",
    )


def other_channels_are_plain_differences(given: Given) -> None:
    """A channel without a role is not touched: its acceleration is its plain difference"""
    motion, names = given.motion, given.names
    i = names.index(UNRELATED)
    rate = motion.acceleration(given.before, given.after, DT, names)[:, i]
    difference = (given.after - given.before)[:, i] / DT
    turned = motion.turning(given.before, names)[:, i]
    expect(np.allclose(rate, difference, rtol=1e-9) and not turned.any(), "a channel without a role is turned")


def two_halves_are_a_whole(given: Given) -> None:
    """Two half steps move the pose as one whole step does, in the limit of short steps"""
    motion, names = given.motion, given.names
    errors = []
    for dt in (0.02, 0.01):
        middle = 0.5 * (given.before + given.after)
        whole = motion.move(given.pose, given.before, given.after, dt, names)
        half = motion.move(given.pose, given.before, middle, 0.5 * dt, names)
        errors.append(np.abs(given.apart(motion.move(half, middle, given.after, 0.5 * dt, names), whole)).max())
    expect(
        errors[1] <= 0.3 * errors[0] + 1e-9, f"halving the step leaves {errors[1] / max(errors[0], 1e-30):.2f} of it"
    )


def velocities_move_the_pose(given: Given) -> None:
    """velocities are those that move a pose at this rate, if it says which"""
    motion, names = given.motion, given.names
    moved = motion.move(given.pose, given.before, given.before, SHORT, names)
    rate = given.apart(moved, given.pose) / SHORT
    try:
        found = motion.velocities(given.pose, rate)
    except IncompatibleSystem:
        raise DoesNotApply from None
    for channel, values in found.items():
        expected = given.before[:, names.index(channel)]
        expect(np.allclose(values, expected, rtol=1e-3, atol=1e-3), f"{channel} is not the one that moved the pose")


def where_it_is_seen_from_does_not_matter(given: Given) -> None:
    """A pose that is seen from elsewhere moves in the same way, if it says how poses are seen"""
    motion, names = given.motion, given.names
    origin = np.linspace(0.7, -0.4, motion.n_pose)
    try:
        seen = motion.seen_from(origin, given.pose)
    except IncompatibleSystem:
        raise DoesNotApply from None
    at_itself = given.apart(motion.seen_from(origin, origin[None]), np.zeros((1, motion.n_pose)))
    expect(np.abs(at_itself).max() < 1e-9, "seen from itself a pose is not zero")
    moved = motion.seen_from(origin, motion.move(given.pose, given.before, given.after, DT, names))
    expected = motion.move(seen, given.before, given.after, DT, names)
    expect(np.abs(given.apart(moved, expected)).max() < 1e-9, "it moves otherwise")


def the_compiled_form_is_the_same(given: Given) -> None:
    """The compiled form integrates, turns and moves as the form on arrays does"""
    motion, names, nx = given.motion, given.names, len(given.names)
    form = motion.kernel(names)
    if form is None:
        raise DoesNotApply
    from sysid_evo.engine.compiled.dialect import KernelSource
    from sysid_evo.engine.compiled.kernel import DynamicsKernel
    from sysid_evo.engine.compiled.single_step import kernel_step
    from sysid_evo.testing.kernels.motion_forms import HEAD, all_three

    bindings = {"integrate": form.integrate, "turn_frame": form.turn, "move_pose": form.move}
    kernel = DynamicsKernel(KernelSource(all_three, bindings), HEAD.pack(form.parameters, nx=nx, dt=DT))
    carry = np.concatenate([given.before, given.acceleration, given.acceleration, given.pose], axis=1)
    found = kernel_step(kernel, carry, np.zeros((ROWS, 1)), precision="float64")
    after = motion.integrate(given.before, given.acceleration, DT, names)
    expected = {
        "integrate": (found[:, nx : 2 * nx], after),
        "turn": (found[:, 2 * nx : 3 * nx], given.acceleration + motion.turning(given.before, names)),
    }
    for name, (compiled, exact) in expected.items():
        expect(np.allclose(compiled, exact, rtol=1e-7, atol=1e-7), f"{name} gives another result")
    off = given.apart(found[:, 3 * nx :], motion.move(given.pose, given.before, after, DT, names))
    expect(np.abs(off).max(initial=0.0) < 1e-7, "move gives another result")


def the_gradient_form_is_its_derivative(given: Given) -> None:
    """The gradient form is the derivative of integrate and turning"""
    motion, names = given.motion, given.names
    form, differences = motion.gradient_form(names), CentralDifferences(motion, names)
    arguments = given.before, given.acceleration, DT, given.after
    pairs = zip(form.integrated(*arguments), differences.integrated(*arguments), strict=True)
    turned = form.turned(given.before, given.after), differences.turned(given.before, given.after)
    for what, (found, expected) in zip(
        ("integrate by the state", "integrate by the acceleration", "turning"), (*pairs, turned), strict=True
    ):
        expect(np.allclose(found, expected, rtol=1e-6, atol=1e-7), f"the derivative of {what} is another")


CHECKS: tuple[Check[Given], ...] = (
    it_says_what_it_is,
    a_missing_channel_is_named,
    it_can_be_stored,
    results_have_the_right_shape_and_type,
    everything_is_pure,
    rows_are_independent,
    integration_undoes_differentiation,
    turning_is_what_a_short_step_does,
    other_channels_are_plain_differences,
    two_halves_are_a_whole,
    velocities_move_the_pose,
    where_it_is_seen_from_does_not_matter,
    the_compiled_form_is_the_same,
    the_gradient_form_is_its_derivative,
)


def _names(motion: Motion) -> tuple[str, ...]:
    return (UNRELATED, *dict.fromkeys(reversed(list(motion.roles().values()))))
