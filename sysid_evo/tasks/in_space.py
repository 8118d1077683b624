"""Tasks of a rigid body in space: pass waypoints in a box, hover at a point, follow a path."""

# mypy: disallow-untyped-defs=False, check-untyped-defs=False, disallow-untyped-calls=False
# (the kernel functions are read by Numba, which infers their types)

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, cast

import numpy as np

from sysid_evo.angles import TURN, rotate, rotated
from sysid_evo.errors import IncompatibleTask, InvalidArgument
from sysid_evo.kernels import LANES, KernelSource, Layout, TaskKernel, splat, view
from sysid_evo.laws import ROLLOUTS, ScalarLaw, read, together
from sysid_evo.randomness import TASK_STREAM, draw, generator
from sysid_evo.registry.registry import register_task
from sysid_evo.rigid_body import ROLES, RigidBody
from sysid_evo.system import Channel, System
from sysid_evo.tasks.task import Scene, Task, TaskState
from sysid_evo.types import Array, BoolArray, IntArray, Seeds


@dataclass(frozen=True)
class SpaceState(TaskState):
    """State of B trials in space; positions in m from the start.

    ``waypoints`` (E, K, 3) are the places of each of E trials in order, one after the other or one per sample;
    ``passed`` (B,) is the number of the present one, ``score`` (B,) the fitness so far.
    """

    shared: ClassVar[frozenset[str]] = frozenset({"waypoints"})

    waypoints: Array
    trial: IntArray
    passed: IntArray
    score: Array

    @property
    def goal(self) -> Array:
        """The present place to be, (B, 3) m."""
        return self.waypoints[self.trial, np.minimum(self.passed, self.waypoints.shape[1] - 1)]

    def squared_distance(self, pose: Array) -> Array:
        """Return the square of the distance (B,) from ``pose`` (B, 7) to the present place, in m^2."""
        return np.asarray(np.sum((self.goal - pose[:, :3]) ** 2, axis=1))


class SpaceTask(Task):
    """Base class of tasks of a rigid body: observations in the body's frame, and the end of a body that turns over.

    Trials start at rest in the origin, and are over when the body tilts by more than a right angle. Position and
    heading are not observed by themselves: all directions are those of the body.

    | observation | unit |
    |---|---|
    | bias, always 1 | |
    | velocity along each axis of the body | m/s |
    | rate about each axis | rad/s |
    | up, along each axis: (0, 0, 1) for a level body in ENU | |
    | the way to the place to be, along each axis | m |
    """

    name: ClassVar[str]
    observations = (
        Channel("bias", neutral=1.0),
        *(Channel(f"{axis}_speed", "m/s") for axis in ("forward", "lateral", "vertical")),
        *(Channel(f"{axis}_rate", "rad/s") for axis in ("roll", "pitch", "yaw")),
        *(Channel(f"up_{axis}") for axis in "xyz"),
        *(Channel(f"way_{axis}", "m") for axis in "xyz"),
    )

    def __init__(self, *, horizon: int) -> None:
        if horizon < 1:
            raise InvalidArgument(f"{self.name}: expected horizon >= 1 step, got {horizon}")
        self.horizon = horizon

    def check_system(self, system: System) -> None:
        check_in_space(self.name, system)

    @abstractmethod
    def places(self, seeds: Seeds) -> Array:
        """Return the places of each trial (E, K, 3) in m; the task is bound."""

    def begin(self, seeds: Seeds) -> SpaceState:
        trials = len(seeds)
        state = np.tile(self.system.neutral_state, (trials, 1))
        return SpaceState(
            state=state,
            pose=self.system.initial_pose(state),
            alive=np.ones(trials, dtype=bool),
            waypoints=self.places(seeds),
            trial=np.arange(trials),
            passed=np.zeros(trials, dtype=np.int64),
            score=np.zeros(trials),
        )

    def observe(self, task_state: TaskState, state: Array) -> Array:
        found = [0.0] * len(self.observations)
        read(show, ROLLOUTS)(_rows(cast("SpaceState", task_state)), state.T, found, self._parameters().tolist())
        return together(found, state.shape[:1])

    def formulas(self) -> Mapping[str, str]:
        return {f"way_{axis}": f"way to the target along the body's {axis} axis, in m" for axis in "xyz"}

    def fitness(self, task_state: TaskState) -> Array:
        return cast("SpaceState", task_state).score

    def _moved(self, here: SpaceState, before: Array, after: Array, pose: Array | None) -> tuple[Array, BoolArray]:
        """Return the pose after a step, and which bodies have not turned over, (B,)."""
        *_, up = self._body.indices(self.system.state_names)
        moved = self.system.move(here.pose, before, after) if pose is None else pose
        return moved, here.alive & (self._body.up * after[:, up[2]] >= 0.0)

    @property
    def _body(self) -> RigidBody:
        return cast("RigidBody", self.system.motion)

    def _parameters(self, *, scale: float = 0.0, gain: float = 0.0, n_data: int = 0) -> Array:
        places = np.concatenate(self._body.indices(self.system.state_names))
        return HEAD.pack(places, dt=self.system.dt, up=self._body.up, scale=scale, gain=gain, n_data=n_data)

    def _kernel(self, advance: Callable[..., None], **numbers: Any) -> TaskKernel[Any] | None:
        motion = self.system.motion_kernel()
        if motion is None:
            return None
        return TaskKernel(
            observe=OBSERVING,
            advance=KernelSource(advance, {"move_body": KernelSource(move_upright, {"move": motion.move})}),
            rows=_rows,
            trial_data=lambda here: here.waypoints.reshape(len(here.waypoints), -1),
            state=_state,
            parameters=self._parameters(**numbers),
            pose_row=ROWS.x,
            n_pose=RigidBody.n_pose,
        )


def check_in_space(task: str, system: System) -> None:
    """Raise `IncompatibleTask` unless the motion of ``system`` is a rigid body."""
    if not isinstance(system.motion, RigidBody):
        raise IncompatibleTask(
            f"{task} needs a rigid body in space (roles {', '.join(ROLES[:3])}, ...); "
            f"{system.name or 'this system'} has {'no motion' if system.motion is None else system.motion.kind}"
        )


MEAN_DISTANCE = 1.323
"""Mean distance of two random points of a cube, in half its edges."""


USUAL_ARENA = 1.5
"""Half the edge (m) of the cube for which the first step sizes of searches were chosen."""


class SpaceWaypoints(SpaceTask):
    """`PointToPoint` in space: waypoints are uniform in a cube around the start, ``arena_radius`` m to each side."""

    name = "point_to_point"
    fitness_unit = "waypoints"
    rest_is_zero = True

    def __init__(self, *, horizon: int, waypoint_radius: float, arena_radius: float) -> None:
        super().__init__(horizon=horizon)
        self.waypoint_radius, self.arena_radius = waypoint_radius, arena_radius

    def places(self, seeds: Seeds) -> Array:
        drawn = draw(np.asarray(seeds, dtype=np.uint64), TASK_STREAM, (self.horizon + 1, 3), "random")
        return self.arena_radius * (2.0 * drawn - 1.0)

    def advance(
        self, task_state: TaskState, before: Array, after: Array, *, control: Array, pose: Array | None = None
    ) -> tuple[TaskState, Array]:
        here = cast("SpaceState", task_state)
        moved, upright = self._moved(here, before, after, pose)
        passed = here.passed + (here.squared_distance(moved) <= self.waypoint_radius**2)
        return replace(here, pose=moved, alive=upright, passed=passed, score=passed.astype(np.float64)), after

    def observation_sizes(self) -> Array:
        way = np.full(3, max(1.0, self.arena_radius / USUAL_ARENA))
        return np.concatenate([np.ones(len(self.observations) - 3), way])

    def hide_future(self, task_state: TaskState) -> SpaceState:
        """Return the trials with the next waypoint only; all later ones are moved to the start."""
        here = cast("SpaceState", task_state)
        known = np.zeros((len(here.trial), here.waypoints.shape[1], 3))
        known[:, 0] = here.goal
        return replace(here, waypoints=known, trial=np.arange(len(known)), passed=np.zeros_like(here.passed))

    def potential(self, task_state: TaskState, state: Array) -> Array:
        """Return 1 minus the distance to the next waypoint in edges of the cube, at least 0."""
        here = cast("SpaceState", task_state)
        return np.maximum(0.0, 1.0 - np.sqrt(here.squared_distance(here.pose)) / (2.0 * self.arena_radius))

    def feasibility_warnings(self, farthest: Array) -> tuple[str, ...]:
        """Return a warning if the recorded speed is too low for three waypoints in a trial."""
        speeds, _, _ = self._body.indices(self.system.state_names)
        speed, way = float(max(farthest[speeds])), MEAN_DISTANCE * self.arena_radius - self.waypoint_radius
        flown = speed * self.horizon * self.system.dt
        if flown >= 3.0 * way:
            return ()
        return (
            f"point_to_point: at its fastest, {speed:.2g} m/s, this robot covers {flown:.2g} m in a trial, and the "
            f"mean distance between waypoints is {way:.2g} m. Use a smaller arena_radius or a larger horizon",
        )

    def scene(self, task_state: TaskState, trial: int) -> Scene:
        """Return the passed waypoints in order, and the next one."""
        here = cast("SpaceState", task_state)
        return waypoint_scene(here.waypoints[here.trial[trial]], here.passed[trial], self)

    def kernel(self) -> TaskKernel[Any] | None:
        return self._kernel(pass_waypoints, scale=self.waypoint_radius**2, n_data=3 * (self.horizon + 1))


def waypoint_scene(waypoints: Array, passed: int, task: Any) -> Scene:
    """Return the scene of a trial with these waypoints (K, 2) or (K, 3), of which the first were ``passed``."""
    return Scene(waypoints[: passed + 1].copy(), int(passed), task.waypoint_radius, task.arena_radius)


class SpacePath(SpaceTask):
    """Base class of tasks that keep a body at a place, which may move.

    Fitness is the mean of ``1 / (1 + (distance / tolerance)^2)`` over all steps of the horizon, in per cent.
    """

    fitness_unit = "% of full score"

    def __init__(self, *, tolerance: float, horizon: int) -> None:
        super().__init__(horizon=horizon)
        if not tolerance > 0.0:
            raise InvalidArgument(f"{self.name}: expected tolerance > 0 m, got {tolerance}")
        self.tolerance = tolerance

    def advance(
        self, task_state: TaskState, before: Array, after: Array, *, control: Array, pose: Array | None = None
    ) -> tuple[TaskState, Array]:
        here = cast("SpaceState", task_state)
        moved, upright = self._moved(here, before, after, pose)
        next_one = replace(here, pose=moved, alive=upright, passed=here.passed + 1)
        closeness = 1.0 / (1.0 + next_one.squared_distance(moved) / self.tolerance**2)
        return replace(next_one, score=here.score + 100.0 / self.horizon * closeness), after

    def scene(self, task_state: TaskState, trial: int) -> Scene:
        """Return the path as a line, or its only place as a marker."""
        return path_scene(cast("SpaceState", task_state), trial)

    def kernel(self) -> TaskKernel[Any] | None:
        return self._kernel(follow_path, scale=self.tolerance**-2, gain=100.0 / self.horizon, n_data=self._count)

    @property
    def _count(self) -> int:
        """Numbers in the places of a trial."""
        return 3 * (self.horizon + 1)


def path_scene(here: SpaceState, trial: int) -> Scene:
    """Return the scene of one trial of a `SpacePath`."""
    path = here.waypoints[here.trial[trial]]
    return Scene(markers=path.copy()) if len(path) == 1 else Scene(np.empty((0, 3)), walls=(path.copy(),))


@register_task("hover")
class Hover(SpacePath):
    """Fly from rest to a random point, at most ``spread`` m away along each axis, and stay there.

    Fitness is the mean of ``1 / (1 + (distance / tolerance)^2)`` over all steps, in per cent; ``tolerance`` is in m.
    Heading is free. See `SpaceTask` for the observations and the end of a trial.
    """

    name = "hover"

    def __init__(self, *, spread: float = 0.5, tolerance: float = 0.2, horizon: int = 300) -> None:
        super().__init__(tolerance=tolerance, horizon=horizon)
        if spread < 0.0:
            raise InvalidArgument(f"hover: expected spread >= 0 m, got {spread}")
        self.spread = spread

    def places(self, seeds: Seeds) -> Array:
        drawn = draw(np.asarray(seeds, dtype=np.uint64), TASK_STREAM, (1, 3), "random")
        return self.spread * (2.0 * drawn - 1.0)

    @property
    def _count(self) -> int:
        return 3


PATHS = ("helix", "figure_of_eight")


class SpaceReference(SpacePath):
    """`TrackReference` in space: a helix or a figure of eight of ``size`` m, any heading and direction of rotation.

    Once around takes from ``period`` to twice that, in s; a helix rises or sinks by ``size`` in a trial.
    """

    name = "track_reference"

    def __init__(self, *, kind: str, period: float | None, size: float, tolerance: float, horizon: int) -> None:
        super().__init__(tolerance=tolerance, horizon=horizon)
        if not size > 0.0:
            raise InvalidArgument(f"track_reference: expected low < high, got a path of {size} m")
        self.kind, self.period, self.size = kind, period, size

    def places(self, seeds: Seeds) -> Array:
        return np.array([self._path(generator(seed, TASK_STREAM)) for seed in seeds])

    def _path(self, rng: np.random.Generator) -> Array:
        """Return the path of one trial (horizon + 1, 3), which begins in the origin."""
        time = self.system.dt * np.arange(self.horizon + 1)
        period = 0.5 * time[-1] if self.period is None else self.period
        phase, climb, heading = TURN * time / (period * rng.uniform(1.0, 2.0)), rng.uniform(-1, 1), rng.uniform(0, TURN)
        if self.kind == "helix":
            x, y, z = np.sin(phase), 1.0 - np.cos(phase), climb * time / time[-1]
        else:
            x, y, z = np.sin(phase), 0.5 * np.sin(2.0 * phase), 0.5 * climb * np.sin(phase)
        east, north = rotate(x, rng.choice([-1.0, 1.0]) * y, heading)
        return self.size * np.stack([east, north, z], axis=1)


ROWS = Layout("score", "alive", "passed", "x", "y", "z", "qw", "qx", "qy", "qz", "goal_x", "goal_y", "goal_z")
HEAD = Layout("dt", "up", "scale", "gain", "n_data")
"""Followed by the places of velocities, rates and up in the state, which are the parameters of the motion too."""


def _rows(here: SpaceState) -> Array:
    rows = [here.score, here.alive, here.passed, *here.pose.T, *here.goal.T]
    return np.stack([np.asarray(row, dtype=np.float64) for row in rows])


def _state(here: SpaceState, rows: Array) -> TaskState:
    return replace(
        here,
        score=rows[ROWS.score],
        alive=rows[ROWS.alive] > 0,
        passed=rows[ROWS.passed].astype(np.int64),
        pose=rows[ROWS.x : ROWS.goal_x].T.copy(),
    )


def show(task, state, observation, parameters):
    """Bias, velocities, rates, up, way to the goal in the body's frame. The law of both forms, see `sysid_evo.laws`."""
    places = view(parameters, HEAD.size)
    observation[0] = splat(1.0)
    for i in range(9):
        observation[1 + i] = state[int(places[i])]
    x, y, z = rotated(
        task[ROWS.qw],
        -task[ROWS.qx],
        -task[ROWS.qy],
        -task[ROWS.qz],
        task[ROWS.goal_x] - task[ROWS.x],
        task[ROWS.goal_y] - task[ROWS.y],
        task[ROWS.goal_z] - task[ROWS.z],
    )
    observation[10] = x
    observation[11] = y
    observation[12] = z


OBSERVING = ScalarLaw(show, rows=("task", "state", "observation"))


def squared_distance(task, lane):
    """The square of the distance to the goal in one lane."""
    x = task[ROWS.goal_x * LANES + lane] - task[ROWS.x * LANES + lane]
    y = task[ROWS.goal_y * LANES + lane] - task[ROWS.y * LANES + lane]
    z = task[ROWS.goal_z * LANES + lane] - task[ROWS.z * LANES + lane]
    return x * x + y * y + z * z


def take_goal(task, trials, trial_data, lane, n_data):
    """Write the place that follows those passed."""
    place = trials[lane] * n_data + min(3 * int(task[ROWS.passed * LANES + lane]), n_data - 3)
    for i in range(3):
        task[(ROWS.goal_x + i) * LANES + lane] = trial_data[place + i]


def move_upright(task, before, after, parameters):
    """Move the pose, and end the trials of bodies that have turned over."""
    places = view(parameters, HEAD.size)
    move(view(task, ROWS.x * LANES), before, after, parameters[HEAD.dt], places)
    up, sign = view(after, int(places[8]) * LANES), parameters[HEAD.up]
    for lane in range(LANES):
        if sign * up[lane] < 0.0:
            task[ROWS.alive * LANES + lane] = 0.0


def pass_waypoints(task, before, after, control, trials, trial_data, parameters):
    """Move, and count the waypoints within the radius."""
    n_data = int(parameters[HEAD.n_data])
    move_body(task, before, after, parameters)
    for lane in range(LANES):
        if squared_distance(task, lane) <= parameters[HEAD.scale]:
            task[ROWS.passed * LANES + lane] += 1.0
            task[ROWS.score * LANES + lane] = task[ROWS.passed * LANES + lane]
            take_goal(task, trials, trial_data, lane, n_data)


def follow_path(task, before, after, control, trials, trial_data, parameters):
    """Move, take the next place, and add the score of the distance to it."""
    n_data = int(parameters[HEAD.n_data])
    move_body(task, before, after, parameters)
    for lane in range(LANES):
        task[ROWS.passed * LANES + lane] += 1.0
        take_goal(task, trials, trial_data, lane, n_data)
        share = squared_distance(task, lane) * parameters[HEAD.scale]
        task[ROWS.score * LANES + lane] += parameters[HEAD.gain] / (1.0 + share)
