"""What the tasks that lead states along a reference have in common, whatever the system."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar, Self, cast

import numpy as np

from sysid_evo.angles import TURN, wrap
from sysid_evo.arrays import Array, BoolArray, IntArray, Seeds
from sysid_evo.errors import InvalidArgument
from sysid_evo.randomness import TASK_STREAM, generator
from sysid_evo.system import Channel, System
from sysid_evo.tasks.goals import Goal
from sysid_evo.tasks.scene import Scene, Target
from sysid_evo.tasks.task import Task, TaskState

if TYPE_CHECKING:
    from sysid_evo.kernels import TaskKernel

SETTLED = 0.9
"""A state has settled if it stays within its tolerance from this share of the trial on."""
SHOWN = 10.0
"""An error of so many tolerances is observed as 1."""


@dataclass(frozen=True)
class FollowingState(TaskState):
    """Where B trials stand that are led along a reference of m channels.

    ``reference`` (E, K, m) holds the targets of each of E trials, K = 1 where they do not change, else one for each
    sample; ``step`` (B,) is the number of steps so far. ``score`` (B,) is the fitness so far; ``squared`` (B,)
    the sum of square errors in tolerances; ``late`` (B,) the last step at which an error exceeded its tolerance;
    ``reached`` (B,) whether none ever did so; ``beyond`` (B,) how far the states went past their targets after
    that, in shares of the ``first`` error (B, m).
    """

    shared: ClassVar[frozenset[str]] = frozenset({"reference", "goals"})

    reference: Array
    goals: tuple[Goal, ...]
    trial: IntArray
    step: IntArray
    score: Array
    squared: Array
    late: IntArray
    reached: BoolArray
    beyond: Array
    first: Array

    @property
    def target(self) -> Array:
        """What is wanted now, (B, m)."""
        return self.reference[self.trial, np.minimum(self.step, self.reference.shape[1] - 1)]


class Following(Task):
    """Fitness is the mean over the horizon, in per cent, of what each step scores.

    A step scores ``c = 1 / (1 + sum (error / tolerance)^2 + (change per second / still)^2)`` over all channels:
    1 at rest on the target, a half at one tolerance; so a channel with a small tolerance weighs more. With a weight
    ``effort`` it scores ``(c + effort (1 - p)) / (1 + effort)``, p the mean over the controls of the square of their
    share of the full one.
    Errors of periodic channels count the shortest way round. A trial that is over early scores nothing from then on.

    A class gives `goals` and `references`; ``starts_at_target`` says where its trials begin, else at rest.

    The observations are a bias (always 1); every state, scaled by its limits if it has both (-1 to 1), a periodic
    one as sine and cosine; and the error of every target in tens of tolerances, a periodic one as sine and cosine.
    """

    usual_noise: ClassVar[str] = "envelope(process=0.02)"
    """A model without noise never leaves the target that it rests on: nothing shows what would bring it back."""
    fitness_unit = "% of full score"
    observations: tuple[Channel, ...] = (Channel("bias", neutral=1.0),)
    starts_at_target = False
    changes = False
    """Whether targets change within a trial."""
    name: ClassVar[str]
    goals: tuple[Goal, ...] = ()

    def __init__(self, *, effort: float = 0.0, horizon: int = 300) -> None:
        if not isinstance(horizon, int) or horizon < 1 or effort < 0.0:
            raise InvalidArgument(
                f"{self.name}: expected horizon >= 1 steps and effort >= 0, got {horizon} and {effort}"
            )
        self.effort = effort
        self.horizon = horizon

    @abstractmethod
    def goals_on(self, system: System) -> tuple[Goal, ...]:
        """Return what is wanted on ``system``. Raises `IncompatibleTask`, `InvalidArgument`."""

    @abstractmethod
    def references(self, rng: np.random.Generator) -> Array:
        """Return the targets of one trial, (1, m), or (horizon + 1, m) where they change; the task is bound."""

    def check_system(self, system: System) -> None:
        for goal in self.goals_on(system):
            if not (min(goal.tolerance, goal.still, goal.end) > 0.0 and goal.low <= goal.high and goal.spread >= 0.0):
                raise InvalidArgument(
                    f"{self.name}: {goal.channel.name}: expected low <= high, tolerance, still and end > 0, "
                    f"spread >= 0, got {goal.low:g}, {goal.high:g}; {goal.tolerance:g}, {goal.still:g}, "
                    f"{goal.end:g}; {goal.spread:g}"
                )

    def bind(self, system: System) -> Self:
        bound = super().bind(system)
        bound.goals = self.goals_on(system)
        bound.observations = observations(system, bound.goals)
        return bound

    def begin(self, seeds: Seeds) -> FollowingState:
        trials, system, goals = len(seeds), self.system, self.goals
        spread = np.array([goal.spread for goal in goals])
        generators = [generator(seed, TASK_STREAM) for seed in seeds]
        off = np.array([spread * rng.uniform(-1.0, 1.0, len(spread)) for rng in generators])
        reference = np.array([self.references(rng) for rng in generators])
        state = np.tile(system.neutral_state, (trials, 1))
        at = [goal.place for goal in goals]
        start = reference[:, 0] if self.starts_at_target else state[:, at]
        state[:, at] = start + off
        return FollowingState(
            state=state,
            pose=np.zeros((trials, system.n_pose)),
            alive=np.ones(trials, dtype=bool),
            reference=reference,
            goals=goals,
            trial=np.arange(trials),
            step=np.zeros(trials, dtype=np.int64),
            score=np.zeros(trials),
            squared=np.zeros(trials),
            late=np.zeros(trials, dtype=np.int64),
            reached=np.zeros(trials, dtype=bool),
            beyond=np.zeros(trials),
            first=self._errors(reference[:, 0], state),
        )

    def observe(self, task_state: TaskState, state: Array) -> Array:
        here = cast("FollowingState", task_state)
        columns = shown_states(self.system, state)
        errors = here.target - state[:, [goal.place for goal in self.goals]]
        for goal, error in zip(self.goals, errors.T, strict=True):
            columns += _shown(goal.channel, error, 0.0, 1.0 / (SHOWN * goal.tolerance))
        return np.stack(columns, axis=1)

    def formulas(self) -> Mapping[str, str]:
        found = formulas_of_states(self.system)
        for goal in self.goals:
            name = goal.channel.name
            found |= _formula(goal.channel, f"{name}_error", f"target - {name}", 0.0, 1.0 / (SHOWN * goal.tolerance))
        return found

    def advance(
        self, task_state: TaskState, before: Array, after: Array, *, control: Array, pose: Array | None = None
    ) -> tuple[TaskState, Array]:
        here = cast("FollowingState", task_state)
        moved = replace(here, step=here.step + 1)
        tolerance, still, end = np.array([(goal.tolerance, goal.still, goal.end) for goal in self.goals]).T
        errors = self._errors(moved.target, after)
        rates = self._errors(after[:, [goal.place for goal in self.goals]], before) / self.system.dt
        off = np.abs(errors) > tolerance
        squares = ((errors / tolerance) ** 2).sum(axis=1)
        moving = ((rates / still) ** 2).sum(axis=1)
        reached = here.reached | ~off.any(axis=1)
        past = (-np.sign(here.first) * errors / np.maximum(np.abs(here.first), tolerance)).max(axis=1)
        gained = (1.0 / (1.0 + squares + moving) + self.effort * (1.0 - self._power(control))) / (1.0 + self.effort)
        advanced = replace(
            moved,
            pose=self.system.move(here.pose, before, after) if pose is None else pose,
            score=here.score + 100.0 / self.horizon * gained,
            squared=here.squared + squares,
            late=np.where(off.any(axis=1), moved.step, here.late),
            reached=reached,
            beyond=np.where(reached, np.maximum(here.beyond, past), here.beyond),
            alive=here.alive & ~(np.abs(errors) > end).any(axis=1),
        )
        return advanced, after

    def fitness(self, task_state: TaskState) -> Array:
        return cast("FollowingState", task_state).score

    def measures(self, task_state: TaskState) -> Mapping[str, Array]:
        """Return how well the targets were met: settling and overshoot, or the error where targets change."""
        here = cast("FollowingState", task_state)
        if here.reference.shape[1] > 1:
            steps = np.maximum(1, here.step) * len(here.goals)
            return {"error (tolerances, rms)": np.sqrt(here.squared / steps)}
        settled = here.alive & (here.late <= SETTLED * here.step)
        return {
            "settled (% of trials)": 100.0 * settled,
            "settling time (s)": np.where(settled, here.late * self.system.dt, np.nan),
            "overshoot (%)": np.where(here.reached, 100.0 * here.beyond, np.nan),
        }

    def scene(self, task_state: TaskState, trial: int) -> Scene:
        """Return the targets of one trial at every sample, by the names of their channels."""
        here = cast("FollowingState", task_state)
        values = here.reference[here.trial[trial]]
        return Scene(
            targets=tuple(
                Target(goal.channel, goal.place, column.copy(), goal.tolerance)
                for goal, column in zip(here.goals, values.T, strict=True)
            )
        )

    def kernel(self) -> TaskKernel[Any] | None:
        from sysid_evo.engine.kernels.following import following_kernel

        return following_kernel(self)

    def _errors(self, target: Array, state: Array) -> Array:
        """Return target minus state (B, m), of periodic channels the shortest way round."""
        errors = target - state[:, [goal.place for goal in self.goals]]
        for i, goal in enumerate(self.goals):
            if goal.period:
                errors[:, i] = wrap(errors[:, i], goal.period)
        return errors

    def _power(self, control: Array) -> Array:
        """Return the mean square share of the full controls (B,), 0 without a command."""
        if not self.system.nu:
            return np.zeros(len(control))
        return np.mean(((control - self.system.neutral_control) * full_controls(self.system)) ** 2, axis=1)


def observations(system: System, goals: tuple[Goal, ...]) -> tuple[Channel, ...]:
    """Return what a controller of `Following` is shown."""
    shown = [(channel, channel.name) for channel in system.states]
    shown += [(goal.channel, f"{goal.channel.name}_error") for goal in goals]
    found = [Channel("bias", neutral=1.0)]
    for channel, name in shown:
        found += [Channel(f"sin_{name}"), Channel(f"cos_{name}")] if channel.period else [Channel(name)]
    return tuple(found)


def shown_states(system: System, state: Array) -> list[Array]:
    """Return a bias and what is shown of every state (B, nx), (B,) each."""
    columns = [np.ones(len(state))]
    for channel, values in zip(system.states, state.T, strict=True):
        columns += _shown(channel, values, *scaling(channel))
    return columns


def scaling(channel: Channel) -> tuple[float, float]:
    """Return centre and scale: (value - centre) scale is -1 to 1 between the limits of a state that has both."""
    if not channel.bounded:
        return 0.0, 1.0
    return 0.5 * (channel.low + channel.high), 2.0 / (channel.high - channel.low)


def formulas_of_states(system: System) -> dict[str, str]:
    """Return how what `shown_states` shows is computed, by the name of the observation."""
    found: dict[str, str] = {}
    for channel in system.states:
        found |= _formula(channel, channel.name, channel.name, *scaling(channel))
    return found


def _formula(channel: Channel, name: str, value: str, centre: float, scale: float) -> dict[str, str]:
    """Return the formulas of what `_shown` shows of a ``value``; none for what is shown as it is."""
    if channel.period:
        factor = "" if math.isclose(channel.period, TURN) else f"{TURN / channel.period:.10g} "
        inside = f"{factor}({value})" if factor and " " in value else f"{factor}{value}"
        return {f"sin_{name}": f"sin({inside})", f"cos_{name}": f"cos({inside})"}
    unit = f" {channel.unit}" if channel.unit else ""
    if (centre, scale) == (0.0, 1.0):
        return {name: f"{value}, in{unit}" if unit else value} if unit or value != name else {}
    off = f"{value} {'-' if centre > 0.0 else '+'} {abs(centre):.10g}{unit}" if centre else value
    return {name: f"{f'({off})' if ' ' in off else off} / ({1.0 / scale:.10g}{unit})"}


def full_controls(system: System) -> Array:
    """Return 1 / the largest distance from neutral of each control, (nu,)."""
    return np.array([1.0 / max(c.high - c.neutral, c.neutral - c.low) for c in system.controls])


def _shown(channel: Channel, values: Array, centre: float, scale: float) -> list[Array]:
    if channel.period:
        angle = TURN / channel.period * values
        return [np.sin(angle), np.cos(angle)]
    return [(values - centre) * scale]
