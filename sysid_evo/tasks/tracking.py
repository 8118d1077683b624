"""Tasks that bring states of any system to targets: score, observations, measures."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self, TypeAlias, cast

import numpy as np

from sysid_evo.angles import TURN, wrap
from sysid_evo.errors import IncompatibleTask, InvalidArgument
from sysid_evo.kernels import LANES, KernelSource, Layout, TaskKernel, nearest, splat, view
from sysid_evo.laws import ROLLOUTS, ScalarLaw, read, together
from sysid_evo.randomness import TASK_STREAM, generator
from sysid_evo.system import Channel, System
from sysid_evo.tasks.task import Scene, Target, Task, TaskState
from sysid_evo.types import Array, BoolArray, IntArray, Seeds

SETTLED_SHARE = 0.9
"""A state has settled if it stays within its tolerance from this share of the trial on."""
OBSERVED_TOLERANCES = 10.0
"""The error, in tolerances, that is observed as 1."""


@dataclass(frozen=True)
class TrackingState(TaskState):
    """State of B trials that follow a reference of m channels.

    - ``reference`` (E, K, m): the targets of each of E trials; K = 1 for constant ones, else one per sample.
    - ``step`` (B,): number of steps so far; ``score`` (B,): fitness so far.
    - ``squared_error`` (B,): sum of squared errors, in tolerances.
    - ``last_violation`` (B,): the last step at which an error exceeded its tolerance.
    - ``reached`` (B,): whether all errors were within tolerance at some step.
    - ``overshoot`` (B,): the largest distance beyond the targets after that, as a share of ``first_error`` (B, m).
    """

    shared: ClassVar[frozenset[str]] = frozenset({"reference", "goals"})

    reference: Array
    goals: tuple[Goal, ...]
    trial: IntArray
    step: IntArray
    score: Array
    squared_error: Array
    last_violation: IntArray
    reached: BoolArray
    overshoot: Array
    first_error: Array

    @property
    def target(self) -> Array:
        """The present target, (B, m)."""
        return self.reference[self.trial, np.minimum(self.step, self.reference.shape[1] - 1)]


class TrackingTask(Task):
    """Fitness is the mean score of all steps over the horizon, in per cent.

    The score is ``c = 1 / (1 + sum (error / tolerance)^2 + (change per second / rate_tolerance)^2)``, summed over all
    channels: 1 at rest on the target, 0.5 at one tolerance; a channel with a small tolerance weighs more. With a weight
    ``effort`` it is ``(c + effort (1 - p)) / (1 + effort)``, where p is the mean square of the controls, each as a
    share of its largest value. Errors of periodic channels are the shortest ones. After an early end the score is 0.

    Subclasses define `goals_on` and `references`; with ``starts_at_target`` trials begin at the target, else at rest.

    The observations are a bias (always 1); every state, scaled by its limits if it has both (-1 to 1), a periodic
    one as sine and cosine; and the error of every target in tens of tolerances, a periodic one as sine and cosine.
    """

    default_noise: ClassVar[str] = "domain_randomisation(process=0.02)"
    """Without noise, a model at rest on the target never leaves it, so evolution would not see how to return."""
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
        """Return the goals on ``system``. Raises `IncompatibleTask`, `InvalidArgument`."""

    @abstractmethod
    def references(self, rng: np.random.Generator) -> Array:
        """Return the targets of one trial, (1, m), or (horizon + 1, m) if they change; the task is bound."""

    def check_system(self, system: System) -> None:
        for goal in self.goals_on(system):
            if not (
                min(goal.tolerance, goal.rate_tolerance, goal.abort_error) > 0.0
                and goal.low <= goal.high
                and goal.start_spread >= 0.0
            ):
                raise InvalidArgument(
                    f"{self.name}: {goal.channel.name}: expected low <= high, tolerance, rate_tolerance and "
                    f"abort_error > 0, start_spread >= 0, got {goal.low:g}, {goal.high:g}; {goal.tolerance:g}, "
                    f"{goal.rate_tolerance:g}, {goal.abort_error:g}; {goal.start_spread:g}"
                )

    def bind(self, system: System) -> Self:
        bound = super().bind(system)
        bound.goals = self.goals_on(system)
        bound.observations = observations(system, bound.goals)
        controls = np.stack([system.neutral_control, full_controls(system)], axis=1) if system.nu else np.zeros(0)
        m, samples = len(bound.goals), self.horizon + 1 if self.changes else 1
        bound.numbers = numbers_of(
            system,
            bound.goals,
            controls,
            gain=100.0 / self.horizon / (1.0 + self.effort),
            effort=self.effort,
            stride=m if self.changes else 0,
            n_data=samples * m,
        )
        return bound

    numbers: Array
    """The parameters of a bound task for `show` and `follow`."""

    def begin(self, seeds: Seeds) -> TrackingState:
        trials, system, goals = len(seeds), self.system, self.goals
        spread = np.array([goal.start_spread for goal in goals])
        generators = [generator(seed, TASK_STREAM) for seed in seeds]
        off = np.array([spread * rng.uniform(-1.0, 1.0, len(spread)) for rng in generators])
        reference = np.array([self.references(rng) for rng in generators])
        state = np.tile(system.neutral_state, (trials, 1))
        at = [goal.place for goal in goals]
        start = reference[:, 0] if self.starts_at_target else state[:, at]
        state[:, at] = start + off
        return TrackingState(
            state=state,
            pose=system.initial_pose(state),
            alive=np.ones(trials, dtype=bool),
            reference=reference,
            goals=goals,
            trial=np.arange(trials),
            step=np.zeros(trials, dtype=np.int64),
            score=np.zeros(trials),
            squared_error=np.zeros(trials),
            last_violation=np.zeros(trials, dtype=np.int64),
            reached=np.zeros(trials, dtype=bool),
            overshoot=np.zeros(trials),
            first_error=self._errors(reference[:, 0], state),
        )

    def observe(self, task_state: TaskState, state: Array) -> Array:
        here = cast("TrackingState", task_state)
        return shown(self.numbers, _rows(here), state, len(self.observations))

    def formulas(self) -> Mapping[str, str]:
        found = formulas_of_states(self.system)
        for goal in self.goals:
            name = goal.channel.name
            found |= _formula(
                goal.channel, f"{name}_error", f"target - {name}", 0.0, 1.0 / (OBSERVED_TOLERANCES * goal.tolerance)
            )
        return found

    def advance(
        self, task_state: TaskState, before: Array, after: Array, *, control: Array, pose: Array | None = None
    ) -> tuple[TaskState, Array]:
        here = cast("TrackingState", task_state)
        moved = replace(
            here,
            step=here.step + 1,
            pose=self.system.move(here.pose, before, after) if pose is None else pose,
        )
        rows = list(_rows(moved))
        read(follow, ROLLOUTS)(rows, before.T, after.T, control.T, self.numbers.tolist())
        return _state(moved, np.array(rows)), after

    def fitness(self, task_state: TaskState) -> Array:
        return cast("TrackingState", task_state).score

    def measures(self, task_state: TaskState) -> Mapping[str, Array]:
        """Return settling time and overshoot, or the error where targets change."""
        here = cast("TrackingState", task_state)
        if here.reference.shape[1] > 1:
            steps = np.maximum(1, here.step) * len(here.goals)
            return {"error (tolerances, rms)": np.sqrt(here.squared_error / steps)}
        settled = here.alive & (here.last_violation <= SETTLED_SHARE * here.step)
        return {
            "settled (% of trials)": 100.0 * settled,
            "settling time (s)": np.where(settled, here.last_violation * self.system.dt, np.nan),
            "overshoot (%)": np.where(here.reached, 100.0 * here.overshoot, np.nan),
        }

    def scene(self, task_state: TaskState, trial: int) -> Scene:
        """Return the targets of one trial at every sample."""
        here = cast("TrackingState", task_state)
        values = here.reference[here.trial[trial]]
        return Scene(
            targets=tuple(
                Target(goal.channel, goal.place, column.copy(), goal.tolerance)
                for goal, column in zip(here.goals, values.T, strict=True)
            )
        )

    def kernel(self) -> TaskKernel[Any] | None:
        motion = self.system.motion_kernel()
        if motion is None:
            return None
        score = ScalarLaw(follow, rows=("task", "before", "after", "control"))
        return TaskKernel(
            observe=OBSERVING,
            advance=KernelSource(advance_lanes, {"move": motion.move, "score": score}),
            rows=_rows,
            trial_data=lambda here: here.reference.reshape(len(here.reference), -1),
            state=_state,
            parameters=np.concatenate([self.numbers, motion.parameters]),
            pose_row=ROWS.pose,
            n_pose=self.system.n_pose,
        )

    def _errors(self, target: Array, state: Array) -> Array:
        """Return target minus state (B, m), for periodic channels the shortest difference."""
        errors = target - state[:, [goal.place for goal in self.goals]]
        for i, goal in enumerate(self.goals):
            if goal.period:
                errors[:, i] = wrap(errors[:, i], goal.period)
        return errors


def observations(system: System, goals: tuple[Goal, ...]) -> tuple[Channel, ...]:
    """Return the observations of a `TrackingTask`."""
    shown = [(channel, channel.name) for channel in system.states]
    shown += [(goal.channel, f"{goal.channel.name}_error") for goal in goals]
    found = [Channel("bias", neutral=1.0)]
    for channel, name in shown:
        found += [Channel(f"sin_{name}"), Channel(f"cos_{name}")] if channel.period else [Channel(name)]
    return tuple(found)


def shown(numbers: Array, rows: Array, state: Array, count: int) -> Array:
    """Return the observations (B, count) of the law `show` for states (B, nx)."""
    found = [0.0] * count
    read(show, ROLLOUTS)(rows, state.T, found, numbers.tolist())
    return together(found, state.shape[:1])


def scaling(channel: Channel) -> tuple[float, float]:
    """Return centre and scale such that (value - centre) scale is -1 to 1 between both limits of a state."""
    if not channel.bounded:
        return 0.0, 1.0
    return 0.5 * (channel.low + channel.high), 2.0 / (channel.high - channel.low)


def formulas_of_states(system: System) -> dict[str, str]:
    """Return the formulas of the observed states in `show`, by the name of the observation."""
    found: dict[str, str] = {}
    for channel in system.states:
        found |= _formula(channel, channel.name, channel.name, *scaling(channel))
    return found


def _formula(channel: Channel, name: str, value: str, centre: float, scale: float) -> dict[str, str]:
    """Return the formulas of the observations of a ``value`` in `show`; none if it is observed unchanged."""
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


Names: TypeAlias = str | Sequence[str]
Numbers: TypeAlias = float | Sequence[float] | None
"""One number for all channels, or one for each; None for the task's default."""
TOLERANCES = 20.0
"""The range of the targets in tolerances, if no tolerance is given."""


@dataclass(frozen=True)
class Goal:
    """The goal of one state: its ``channel`` and its index ``place`` among the states of the system.

    All in the channel's unit: targets lie between ``low`` and ``high``; an error of one ``tolerance``, or a change of
    ``rate_tolerance`` per second, costs half of the score; a trial begins within ``start_spread`` of its start, and is
    over once the error exceeds ``abort_error``.
    """

    channel: Channel
    place: int
    low: float
    high: float
    tolerance: float
    rate_tolerance: float = math.inf
    start_spread: float = 0.0
    abort_error: float = math.inf

    @property
    def period(self) -> float:
        """The period of the channel, 0 if it has none."""
        return self.channel.period or 0.0


def goals_of(
    task: str,
    system: System,
    channels: Names,
    low: Numbers,
    high: Numbers,
    tolerance: Numbers,
    *,
    rate_tolerance: Numbers = math.inf,
    start_spread: Numbers = 0.0,
    abort_error: Numbers = math.inf,
) -> tuple[Goal, ...]:
    """Return the goals for ``channels`` (default: the first state), with default values where none are given."""
    found = places(task, listed(channels) or system.state_names[:1], system)
    states, count = [system.states[place] for place in found], len(found)
    middle = [middle_half(channel) for channel in states]
    lows = numbers(f"{task}: low", low, count, [limits[0] for limits in middle])
    highs = numbers(f"{task}: high", high, count, [limits[1] for limits in middle])
    widths = [b - a if b > a else limits[1] - limits[0] for a, b, limits in zip(lows, highs, middle, strict=True)]
    tolerances = numbers(f"{task}: tolerance", tolerance, count, [width / TOLERANCES for width in widths])
    rate_tolerances = numbers(f"{task}: rate_tolerance", rate_tolerance, count, [math.inf] * count)
    start_spreads = numbers(f"{task}: start_spread", start_spread, count, [0.0] * count)
    abort_errors = numbers(f"{task}: abort_error", abort_error, count, [math.inf] * count)
    chosen = zip(states, found, lows, highs, tolerances, rate_tolerances, start_spreads, abort_errors, strict=True)
    return tuple(Goal(*values) for values in chosen)


def listed(names: Names) -> tuple[str, ...]:
    """Return ``names`` as a tuple; an empty text gives an empty one."""
    if isinstance(names, str):
        return (names,) if names else ()
    return tuple(names)


def numbers(what: str, given: Numbers, count: int, default: Sequence[float]) -> tuple[float, ...]:
    """Return ``given`` for each of ``count`` channels. Raises `InvalidArgument` unless it has one or ``count``."""
    if given is None:
        return tuple(default)
    values = [given] if isinstance(given, int | float) else list(given)
    if len(values) not in (1, count):
        raise InvalidArgument(f"{what}: expected one number, or one for each of {count} channels, got {len(values)}")
    if any(isinstance(value, bool) or not isinstance(value, int | float) or math.isnan(value) for value in values):
        raise InvalidArgument(f"{what}: expected numbers, got {given!r}")
    return tuple(float(value) for value in (values * count if len(values) == 1 else values))


def places(task: str, names: Sequence[str], system: System) -> tuple[int, ...]:
    """Return the indices of the states ``names``. Raises `IncompatibleTask` with the name of a missing one."""
    if system.nx == 0:
        raise IncompatibleTask(f"{task} needs a state; {system.name or 'this system'} has none")
    for name in names:
        if name not in system.state_names:
            raise IncompatibleTask(f"{task} needs the state {name!r}; the states are {', '.join(system.state_names)}")
    if len(set(names)) < len(names):
        raise InvalidArgument(f"{task}: expected every state once, got {', '.join(names)}")
    return tuple(system.state_names.index(name) for name in names)


def middle_half(channel: Channel) -> tuple[float, float]:
    """Return the middle half of a channel's limits; without both limits, neutral +- 1 (or 1/8 of a period)."""
    if channel.bounded:
        quarter = 0.25 * (channel.high - channel.low)
        return channel.low + quarter, channel.high - quarter
    reach = 1.0 if channel.period is None else channel.period / 8.0
    return channel.neutral - reach, channel.neutral + reach


ROWS = Layout("score", "alive", "step", "squared_error", "last_violation", "reached", "overshoot", "pose")
"""The pose is followed by the present target of each channel, and its first error."""
HEAD = Layout(
    "nx", "nu", "goals", "dt", "n_pose", "gain", "effort", "stride", "n_data", "of_goals", "of_nu", "of_motion"
)
STATE = Layout("turn", "centre", "scale")
GOAL = Layout("place", "period", "per_tolerance", "per_rate", "turn", "scale", "abort_error")
CONTROL = Layout("neutral", "full")
NEVER = 1e30


def numbers_of(
    system: System,
    goals: Sequence[Goal],
    own: Array,
    *,
    gain: float = 0.0,
    effort: float = 0.0,
    stride: int = 0,
    n_data: int = 0,
) -> Array:
    """Return the parameters of `show` and `follow`: `HEAD`, its tables, and the task's ``own`` (of controls)."""
    states, of_goal = [_of_state(channel) for channel in system.states], [_of_goal(goal) for goal in goals]
    of_goals = HEAD.size + len(states) * STATE.size
    of_nu = of_goals + len(of_goal) * GOAL.size
    return HEAD.pack(
        *states,
        *of_goal,
        own,
        nx=system.nx,
        nu=system.nu,
        goals=len(goals),
        dt=system.dt,
        n_pose=system.n_pose,
        gain=gain,
        effort=effort,
        stride=stride,
        n_data=n_data,
        of_goals=of_goals,
        of_nu=of_nu,
        of_motion=of_nu + own.size,
    )


def _of_state(channel: Channel) -> Array:
    centre, scale = scaling(channel)
    return STATE.pack(turn=TURN / channel.period if channel.period else 0.0, centre=centre, scale=scale)


def _of_goal(goal: Goal) -> Array:
    return GOAL.pack(
        place=goal.place,
        period=goal.period,
        per_tolerance=1.0 / goal.tolerance,
        per_rate=1.0 / goal.rate_tolerance,
        turn=TURN / goal.period if goal.period else 0.0,
        scale=1.0 / (OBSERVED_TOLERANCES * goal.tolerance),
        abort_error=min(goal.abort_error, NEVER),
    )


def _rows(here: TrackingState) -> Array:
    numbers = [here.score, here.alive, here.step, here.squared_error, here.last_violation, here.reached, here.overshoot]
    rows = [*numbers, *here.pose.T, *here.target.T, *here.first_error.T]
    return np.stack([np.asarray(row, dtype=np.float64) for row in rows])


def _state(here: TrackingState, rows: Array) -> TaskState:
    return replace(
        here,
        score=rows[ROWS.score],
        alive=rows[ROWS.alive] > 0,
        step=rows[ROWS.step].astype(np.int64),
        squared_error=rows[ROWS.squared_error],
        last_violation=rows[ROWS.last_violation].astype(np.int64),
        reached=rows[ROWS.reached] > 0,
        overshoot=rows[ROWS.overshoot],
        pose=rows[ROWS.pose : ROWS.pose + here.pose.shape[1]].T.copy(),
    )


def show(task, state, observation, parameters):
    """Bias, states, errors; sine and cosine of periodic ones. The law of both forms, see `sysid_evo.laws`."""
    targets, at = ROWS.pose + int(parameters[HEAD.n_pose]), 1
    observation[0] = splat(1.0)
    for i in range(int(parameters[HEAD.nx])):
        p = view(parameters, HEAD.size + i * STATE.size)
        if p[STATE.turn] > 0.0:
            observation[at] = math.sin(p[STATE.turn] * state[i])
            observation[at + 1] = math.cos(p[STATE.turn] * state[i])
            at += 2
        else:
            observation[at] = (state[i] - p[STATE.centre]) * p[STATE.scale]
            at += 1
    for i in range(int(parameters[HEAD.goals])):
        p = view(parameters, int(parameters[HEAD.of_goals]) + i * GOAL.size)
        error = task[targets + i] - state[int(p[GOAL.place])]
        if p[GOAL.turn] > 0.0:
            observation[at] = math.sin(p[GOAL.turn] * error)
            observation[at + 1] = math.cos(p[GOAL.turn] * error)
            at += 2
        else:
            observation[at] = error * p[GOAL.scale]
            at += 1


OBSERVING = ScalarLaw(show, rows=("task", "state", "observation"))


def advance_lanes(task, before, after, control, trials, trial_data, parameters):
    """Move the pose, take the next target, and `follow`."""
    goals, n_pose = int(parameters[HEAD.goals]), int(parameters[HEAD.n_pose])
    pose, step = view(task, ROWS.pose * LANES), view(task, ROWS.step * LANES)
    targets = view(pose, n_pose * LANES)
    move(pose, before, after, parameters[HEAD.dt], view(parameters, int(parameters[HEAD.of_motion])))
    stride, n_data = int(parameters[HEAD.stride]), int(parameters[HEAD.n_data])
    for lane in range(LANES):
        step[lane] += 1.0
    if stride > 0:
        for lane in range(LANES):
            place = trials[lane] * n_data + min(int(step[lane]) * stride, n_data - goals)
            for i in range(goals):
                targets[i * LANES + lane] = trial_data[place + i]
    score(task, before, after, control, parameters)


def follow(task, before, after, control, parameters):
    """The score of a step, see `TrackingTask`. The law of both forms, see `sysid_evo.laws`."""
    goals, nu = int(parameters[HEAD.goals]), int(parameters[HEAD.nu])
    targets = ROWS.pose + int(parameters[HEAD.n_pose])
    squares, moving, off = splat(0.0), splat(0.0), splat(0.0)
    past, over, power = splat(-NEVER), splat(0.0), splat(0.0)
    per_dt = 1.0 / parameters[HEAD.dt]
    for i in range(goals):
        p = view(parameters, int(parameters[HEAD.of_goals]) + i * GOAL.size)
        place, first = int(p[GOAL.place]), task[targets + goals + i]
        error = nearest_way(task[targets + i] - after[place], p[GOAL.period])
        rate = nearest_way(after[place] - before[place], p[GOAL.period]) * per_dt * p[GOAL.per_rate]
        moving += rate * rate
        share = error * p[GOAL.per_tolerance]
        squares += share * share
        off = 1.0 if abs(share) > 1.0 else off
        over = 1.0 if abs(error) > p[GOAL.abort_error] else over
        way = (1.0 if first > 0.0 else 0.0) - (1.0 if first < 0.0 else 0.0)
        past = max(past, -way * share / max(abs(first) * p[GOAL.per_tolerance], 1.0))
    for j in range(nu):
        c = view(parameters, int(parameters[HEAD.of_nu]) + j * CONTROL.size)
        full = (control[j] - c[CONTROL.neutral]) * c[CONTROL.full]
        power += full * full
    effort = parameters[HEAD.effort] * (1.0 - power / max(float(nu), 1.0))
    task[ROWS.score] += parameters[HEAD.gain] * (1.0 / (1.0 + squares + moving) + effort)
    task[ROWS.alive] = 0.0 if over > 0.0 else task[ROWS.alive]
    task[ROWS.squared_error] += squares
    task[ROWS.last_violation] = task[ROWS.step] if off > 0.0 else task[ROWS.last_violation]
    reached = task[ROWS.reached] if off > 0.0 else 1.0
    overshoot = task[ROWS.overshoot]
    task[ROWS.reached] = reached
    task[ROWS.overshoot] = max(overshoot, past) if reached > 0.0 else overshoot


SHORTEST = 1e-6
"""Lower bound of periods."""


def nearest_way(error, period):
    """Return ``error`` wrapped to half a ``period`` around 0, as `sysid_evo.angles.wrap` does; unchanged for 0."""
    error = error - period * nearest(error / max(period, SHORTEST))
    return error + period if error <= -0.5 * period else error
