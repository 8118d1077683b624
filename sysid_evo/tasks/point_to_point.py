"""Point-to-point racing: pass as many random waypoints as possible (paper, section 5.2)."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, ClassVar, cast

import numpy as np

from sysid_evo.angles import wrap
from sysid_evo.errors import InvalidArgument
from sysid_evo.kernels import (
    LANES,
    QUARTER,
    KernelSource,
    Layout,
    TaskKernel,
    first_lane,
    lanes_at_most,
    load,
    load_quarter,
    splat,
    splat_quarter,
    store,
    view,
    where_bits,
)
from sysid_evo.motion_kernels import wrap as wrap_lanes
from sysid_evo.randomness import TASK_STREAM, draw
from sysid_evo.registry.registry import register_task
from sysid_evo.rigid_body import RigidBody
from sysid_evo.system import Channel, System
from sysid_evo.tasks.in_space import USUAL_ARENA, SpaceState, SpaceWaypoints, waypoint_scene
from sysid_evo.tasks.task import Scene, Task, TaskState, planar_places
from sysid_evo.types import Array, IntArray, Seeds

MEAN_DISTANCE = 128.0 / (45.0 * np.pi)
"""Mean distance of two random points of a disc, in its radii."""
TOO_FEW, SUGGESTED = 3.0, 10.0
"""Waypoints per trial at full speed: with fewer than the first number a warning proposes enough for the second."""


@dataclass(frozen=True)
class PointToPointState(TaskState):
    """``waypoints`` (E, horizon + 1, 2) m for each trial, ``trial`` and ``passed`` (B,)."""

    shared: ClassVar[frozenset[str]] = frozenset({"waypoints"})

    waypoints: Array
    trial: IntArray
    passed: IntArray

    @property
    def waypoint(self) -> Array:
        """The next waypoint, (B, 2) m."""
        trials, number, _ = self.waypoints.shape
        return self.waypoints.reshape(trials * number, 2).take(self.trial * number + self.passed, axis=0)

    def to_waypoint(self, pose: Array) -> tuple[Array, Array]:
        """Return the distance (m) from ``pose`` (B, 3) to the next waypoint in x and in y, (B,) each."""
        waypoint = self.waypoint
        return waypoint[:, 0] - pose[:, 0], waypoint[:, 1] - pose[:, 1]


@register_task("point_to_point")
class PointToPoint(Task):
    """Fitness is the number of waypoints passed in ``horizon`` steps.

    A waypoint is passed when the centre of the body is within ``waypoint_radius`` of it (0.3 m);
    the next one then appears at a random position, uniform over the disc of ``arena_radius`` (1.5 m)
    around the origin. Trials start at rest in the origin, heading along x (not specified in the paper).
    Only the next waypoint is known. A rigid body in space has a cube with edges of twice the radius instead of a disc,
    and other observations, see `SpaceTask`; a trial is over when it turns over.

    | observation | unit |
    |---|---|
    | bias, always 1 | |
    | forward speed | m/s |
    | yaw rate | rad/s |
    | angle from the heading to the waypoint, counter-clockwise, in (-pi, pi] | rad |
    | distance to the waypoint | m |
    """

    fitness_unit = "waypoints"
    rest_is_zero = True
    observations = (
        Channel("bias", neutral=1.0),
        Channel("forward_speed", "m/s"),
        Channel("yaw_rate", "rad/s"),
        Channel("waypoint_angle", "rad", -np.pi, np.pi),
        Channel("waypoint_distance", "m"),
    )

    def __init__(self, *, horizon: int = 500, waypoint_radius: float = 0.3, arena_radius: float = USUAL_ARENA) -> None:
        if horizon < 1 or waypoint_radius <= 0 or arena_radius <= 0:
            raise InvalidArgument(
                "point_to_point: expected horizon >= 1 and radii > 0, "
                f"got {horizon}, {waypoint_radius} m, {arena_radius} m"
            )
        self.horizon = horizon
        self.waypoint_radius = waypoint_radius
        self.arena_radius = arena_radius

    def bind(self, system: System) -> Any:
        """Return this task on ``system``, or `SpaceWaypoints` if that moves in space."""
        if not isinstance(system.motion, RigidBody):
            return super().bind(system)
        return SpaceWaypoints(
            horizon=self.horizon, waypoint_radius=self.waypoint_radius, arena_radius=self.arena_radius
        ).bind(system)

    def observation_sizes(self) -> Array:
        """Return the sizes of a larger arena than the usual one, and of a body whose trials start in motion."""
        forward, _ = self._speeds
        speed, distance = abs(self.system.neutral_state[forward]), self.arena_radius / USUAL_ARENA
        return np.maximum(1.0, [1.0, speed, 1.0, 1.0, distance])

    def check_system(self, system: System) -> None:
        if not isinstance(system.motion, RigidBody):
            planar_places("point_to_point", system)

    def begin(self, seeds: Seeds) -> PointToPointState:
        trials = len(seeds)
        return PointToPointState(
            state=np.tile(self.system.neutral_state, (trials, 1)),
            pose=np.zeros((trials, 3)),
            alive=np.ones(trials, dtype=bool),
            waypoints=waypoints(tuple(seeds.tolist()), self.horizon + 1, self.arena_radius),
            trial=np.arange(trials),
            passed=np.zeros(trials, dtype=np.int64),
        )

    def observe(self, task_state: TaskState, state: Array) -> Array:
        here = cast("PointToPointState", task_state)
        forward, yaw_rate = self._speeds
        dx, dy = here.to_waypoint(here.pose)
        angle = np.arctan2(dy, dx) - here.pose[:, 2]
        seen = [np.ones(len(state)), state[:, forward], state[:, yaw_rate], wrap(angle), np.sqrt(dx * dx + dy * dy)]
        return np.stack(seen, axis=1)

    def advance(
        self, task_state: TaskState, before: Array, after: Array, *, control: Array, pose: Array | None = None
    ) -> tuple[TaskState, Array]:
        here = cast("PointToPointState", task_state)
        if pose is None:
            pose = self.system.move(here.pose, before, after)
        dx, dy = here.to_waypoint(pose)
        near = dx * dx + dy * dy <= self.waypoint_radius**2
        return replace(here, pose=pose, passed=here.passed + near), after

    def fitness(self, task_state: TaskState) -> Array:
        return cast("PointToPointState", task_state).passed.astype(np.float64)

    def hide_future(self, task_state: TaskState) -> PointToPointState:
        """Return the trials with the next waypoint only; all later ones are moved to the centre of the arena."""
        here = cast("PointToPointState", task_state)
        trials = len(here.trial)
        known = np.zeros((trials, here.waypoints.shape[1], 2))
        known[:, 0] = here.waypoint
        return replace(here, waypoints=known, trial=np.arange(trials), passed=np.zeros(trials, dtype=np.int64))

    def potential(self, task_state: TaskState, state: Array) -> Array:
        """Return 1 minus the distance to the next waypoint in diameters of the arena, at least 0."""
        here = cast("PointToPointState", task_state)
        dx, dy = here.to_waypoint(here.pose)
        return np.maximum(0.0, 1.0 - np.sqrt(dx * dx + dy * dy) / (2.0 * self.arena_radius))

    def feasibility_warnings(self, farthest: Array) -> tuple[str, ...]:
        """Return warnings if waypoints are too far apart or too small for the speed, or the arena too small to turn."""
        forward, yaw_rate = self._speeds
        speed, turning, dt = farthest[forward], farthest[yaw_rate], self.system.dt
        if speed <= 0.0:
            return ("point_to_point: this robot does not move in the recording, so it cannot reach any waypoint",)
        way = max(MEAN_DISTANCE * self.arena_radius - self.waypoint_radius, 1e-9)
        driven, size = speed * self.horizon * dt, 2.0 * self.waypoint_radius
        fastest = f"point_to_point: at its fastest, {speed:.2g} m/s, this robot"
        found = []
        if driven < TOO_FEW * way:
            arena = (driven / SUGGESTED + self.waypoint_radius) / MEAN_DISTANCE
            steps = np.ceil(SUGGESTED * way / speed / dt)
            found.append(
                f"{fastest} drives {driven:.2g} m in a trial of {self.horizon * dt:g} s, and the mean distance between "
                f"waypoints is {way:.2g} m: it can pass about {driven / way:.1f}. Use a smaller arena "
                f"(arena_radius={arena:.2g}) or more steps (horizon={steps:.0f})"
            )
        if speed * dt > size:
            found.append(
                f"{fastest} drives {speed * dt:.2g} m in one step and may jump over a waypoint of {size:.2g} m: "
                "use a larger waypoint_radius"
            )
        if speed > TOO_FEW * self.arena_radius * turning:
            circle = f"circles of {speed / turning:.2g} m" if turning > 0.0 else "no circle"
            found.append(
                f"{fastest} turns at {turning:.2g} rad/s at most, in {circle}, in an arena of {self.arena_radius:g} m: "
                "use a larger arena_radius"
            )
        return tuple(found)

    def scene(self, task_state: TaskState, trial: int) -> Scene:
        """Return the passed waypoints in order, and the next one."""
        here = cast("PointToPointState | SpaceState", task_state)
        return waypoint_scene(here.waypoints[here.trial[trial]], here.passed[trial], self)

    def kernel(self) -> TaskKernel[Any] | None:
        motion = self.system.motion_kernel()
        if motion is None:
            return None
        forward, yaw_rate = self._speeds
        parameters = HEAD.pack(
            motion.parameters,
            forward=forward,
            yaw_rate=yaw_rate,
            dt=self.system.dt,
            radius_squared=self.waypoint_radius**2,
            n_data=2 * (self.horizon + 1),
        )
        return TaskKernel(
            observe=KernelSource(observe_lanes),
            advance=KernelSource(advance_lanes, {"move": motion.move}),
            rows=_rows,
            trial_data=lambda here: here.waypoints.reshape(len(here.waypoints), -1),
            state=_state,
            parameters=parameters,
            pose_row=ROWS.x,
            n_pose=self.system.n_pose,
        )

    @property
    def _speeds(self) -> tuple[int, int]:
        """The indices of forward speed and yaw rate among the states."""
        places = planar_places("point_to_point", self.system)
        return places["forward"], places["yaw_rate"]


@lru_cache(maxsize=16)
def waypoints(seeds: tuple[int, ...], count: int, arena_radius: float) -> Array:
    """Return ``count`` random waypoints for each seed, (E, count, 2) m.

    Read-only and cached: all models of an ensemble are run in the same trials.
    """
    found = draw(np.array(seeds, dtype=np.uint64), TASK_STREAM, (count, 2), "random")
    radius, angle = arena_radius * np.sqrt(found[..., 0]), 2.0 * np.pi * found[..., 1]
    found[..., 0], found[..., 1] = radius * np.cos(angle), radius * np.sin(angle)
    found.flags.writeable = False
    return found


ROWS = Layout("passed", "alive", "x", "y", "heading", "next_x", "next_y")
HEAD = Layout("forward", "yaw_rate", "dt", "radius_squared", "n_data")


def _rows(here: PointToPointState) -> Array:
    x, y, heading = here.pose.T
    rows = [here.passed, here.alive, x, y, wrap(heading), *here.waypoint.T]  # wrapped while still exact
    return np.stack([np.asarray(row, dtype=np.float64) for row in rows])


def _state(here: PointToPointState, rows: Array) -> TaskState:
    passed = rows[ROWS.passed].astype(np.int64)
    return replace(here, passed=passed, alive=rows[ROWS.alive] > 0, pose=rows[ROWS.x : ROWS.heading + 1].T.copy())


def observe_lanes(task, state, observation, parameters):
    """Bias, forward speed, yaw rate, angle and distance to the waypoint."""
    forward = view(state, int(parameters[HEAD.forward]) * LANES)
    yaw_rate = view(state, int(parameters[HEAD.yaw_rate]) * LANES)
    store(observation, 0, splat(1.0))
    store(observation, LANES, load(forward, 0))
    store(observation, 2 * LANES, load(yaw_rate, 0))
    for lane in range(0, LANES, QUARTER):
        here, seen = view(task, lane), view(observation, lane)
        dx = load_quarter(here, ROWS.next_x * LANES) - load_quarter(here, ROWS.x * LANES)
        dy = load_quarter(here, ROWS.next_y * LANES) - load_quarter(here, ROWS.y * LANES)
        store(seen, 3 * LANES, wrap_lanes(math.atan2(dy, dx) - load_quarter(here, ROWS.heading * LANES)))
        store(seen, 4 * LANES, math.sqrt(dx * dx + dy * dy))


def advance_lanes(task, before, after, control, trials, trial_data, parameters):
    """Move the pose and count the waypoints within the radius."""
    reach = parameters[HEAD.radius_squared]
    move(view(task, ROWS.x * LANES), before, after, parameters[HEAD.dt], view(parameters, HEAD.size))
    dx = load(task, ROWS.next_x * LANES) - load(task, ROWS.x * LANES)
    dy = load(task, ROWS.next_y * LANES) - load(task, ROWS.y * LANES)
    passing = lanes_at_most(dx * dx + dy * dy, splat(reach))
    while passing != 0:
        lane = first_lane(passing)
        passing &= passing - 1
        number = task[ROWS.passed * LANES + lane] + 1.0
        place = trials[lane] * int(parameters[HEAD.n_data]) + 2 * int(number)
        put(view(task, ROWS.passed * LANES), lane, number)
        put(view(task, ROWS.next_x * LANES), lane, trial_data[place])
        put(view(task, ROWS.next_y * LANES), lane, trial_data[place + 1])


def put(row, lane, number):
    """Write one lane of a row as a whole quarter; a vector read soon after a scalar write would stall."""
    first = lane - lane % QUARTER
    store(row, first, where_bits(1 << (lane % QUARTER), splat_quarter(number), load_quarter(row, first)))
