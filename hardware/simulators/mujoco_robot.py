"""Any robot that MuJoCo can read from a file, as a simulator: joints to states, actuators to controls."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from hardware.arguments import check_number, check_text
from hardware.simulators.simulator import ExternalSimulator, SimulatorSession
from hardware.simulators.simulator_robot import SimulatorRobot
from sysid_evo.angles import TURN
from sysid_evo.errors import IncompatibleSystem, InvalidArgument
from sysid_evo.extras import check_installed
from sysid_evo.registry import register_robot
from sysid_evo.rigid_body import RigidBody, rotated
from sysid_evo.system import Channel, System, rigid_body_states
from sysid_evo.types import Array

STEP = 0.02
"""The sampling time (s) to which the default is the nearest multiple of the model's time step."""
START = 0.05
"""Largest deviation of positions (m, rad) and speeds from the start of a recorded episode."""


@register_robot("mujoco")
class MujocoRobot(SimulatorRobot):
    """The robot in the MuJoCo ``file`` (MJCF or URDF).

    The states are position and speed of every hinge (rad) and slide (m), with the names of the joints; a hinge without
    limits is periodic. A free joint is a `RigidBody` in ENU, whose position is no state. The controls are the
    actuators with their ctrlrange. Episodes begin near the first keyframe, or the pose of the file without one, and
    have no end. ``dt`` (s) is a multiple of the model's time step, by default the one nearest to 0.02 s.

    Raises `InvalidArgument` for a file that MuJoCo cannot read, `IncompatibleSystem` for a model without actuators,
    with a ball joint or several free ones, or with an actuator without limits; `MissingExtra`.
    """

    requires: ClassVar[tuple[str, ...]] = ("mujoco",)
    file_parameters: ClassVar[tuple[str, ...]] = ("file",)

    def __init__(self, *, file: str = "robot.xml", dt: float | None = None) -> None:
        check_text("robot mujoco: file", file)
        check_installed("robot 'mujoco'", self.requires)
        mujoco = import_module("mujoco")
        what = f"robot mujoco({file})"
        try:
            model: Any = mujoco.MjModel.from_xml_path(str(Path(file).expanduser()))
        except ValueError as error:
            raise InvalidArgument(f"{what}: MuJoCo cannot read it: {error}") from error
        start = np.array(model.key_qpos[0] if model.nkey else model.qpos0)
        states, free, joints = _joints(what, model, start)
        timestep = float(model.opt.timestep)
        repeats = max(1, round((STEP if dt is None else check_number(f"{what}: dt", dt, above=0.0)) / timestep))
        if dt is not None and not np.isclose(repeats * timestep, dt, rtol=1e-6):
            raise InvalidArgument(f"{what}: dt: expected a multiple of its time step, {timestep:g} s, got {dt:g} s")
        motion, name = None if free is None else RigidBody(), Path(file).stem
        system = System(states, _actuators(what, model), repeats * timestep, motion, name)
        self.default_task = "hover" if free is not None else f"set_point(channels={states[0].name})"
        super().__init__(MujocoSimulator(name, system, model, repeats, start, free, joints))


@dataclass(frozen=True)
class Joint:
    """A hinge or slide: its places in qpos and qvel."""

    position: int
    speed: int


@dataclass(frozen=True)
class MujocoSimulator(ExternalSimulator):
    """A ``model`` of MuJoCo, stepped ``repeats`` times per sample; ``start`` (nq,) are the positions of its start.

    ``free`` is the free joint, if there is one, ``joints`` are all others.
    """

    name: str
    system: System
    model: Any
    repeats: int
    start: Array
    free: Joint | None
    joints: tuple[Joint, ...]

    def open(self) -> MujocoSession:
        return MujocoSession(self)


class MujocoSession(SimulatorSession):
    """Episodes of one model, one after the other."""

    def __init__(self, simulator: MujocoSimulator) -> None:
        self._simulator, self._mujoco = simulator, import_module("mujoco")
        self._data = self._mujoco.MjData(simulator.model)

    def reset(self, seed: int, at: Array | None = None) -> Array:
        simulator, data = self._simulator, self._data
        self._mujoco.mj_resetData(simulator.model, data)
        data.qpos[:] = simulator.start
        if at is None:
            at = self._measured() + START * np.random.default_rng(seed).uniform(-1.0, 1.0, simulator.system.nx)
        own = 0
        if simulator.free is not None:
            own, position, speed = 9, simulator.free.position, simulator.free.speed
            up = at[6:9] / np.linalg.norm(at[6:9])
            attitude = simulator.system.initial_pose(np.concatenate([at[:6], up, at[9:]]))[3:]
            data.qpos[position + 3 : position + 7] = attitude
            data.qvel[speed : speed + 6] = [*rotated(*attitude, *at[:3]), *at[3:6]]
        for k, joint in enumerate(simulator.joints):
            data.qpos[joint.position], data.qvel[joint.speed] = at[own + 2 * k : own + 2 * k + 2]
        return self._measured()

    def step(self, control: Array) -> tuple[Array, float, bool, bool]:
        before = self._measured()
        self._data.ctrl[:] = control
        self._mujoco.mj_step(self._simulator.model, self._data, self._simulator.repeats)
        kinds = self._mujoco.mjtWarning  # after these MuJoCo resets a simulation
        reset = int(kinds.mjWARN_BADQPOS), int(kinds.mjWARN_BADQVEL), int(kinds.mjWARN_BADQACC)
        unstable = any(self._data.warning[kind].number for kind in reset)
        return before if unstable else self._measured(), 0.0, unstable, False

    def _measured(self) -> Array:
        data, free, found = self._data, self._simulator.free, []
        if free is not None:
            w, x, y, z = data.qpos[free.position + 3 : free.position + 7]
            world, rates = data.qvel[free.speed : free.speed + 3], data.qvel[free.speed + 3 : free.speed + 6]
            found += [*rotated(w, -x, -y, -z, *world), *rates, *rotated(w, -x, -y, -z, 0.0, 0.0, 1.0)]
        for joint in self._simulator.joints:
            found += [data.qpos[joint.position], data.qvel[joint.speed]]
        return np.array(found, dtype=np.float64)


def _joints(what: str, model: Any, start: Array) -> tuple[list[Channel], Joint | None, tuple[Joint, ...]]:
    """Return the states, the free joint if there is one, and all others."""
    kinds = import_module("mujoco").mjtJoint
    states: list[Channel] = []
    free: list[Joint] = []
    joints: list[Joint] = []
    for i in range(model.njnt):
        joint, kind = model.joint(i), int(model.jnt_type[i])
        name, place = joint.name or f"joint_{i}", Joint(int(model.jnt_qposadr[i]), int(model.jnt_dofadr[i]))
        if kind == kinds.mjJNT_FREE:
            free.append(place)
            continue
        if kind == kinds.mjJNT_BALL:
            raise IncompatibleSystem(f"{what}: the ball joint {name!r} has no angles; replace it by three hinges")
        unit, neutral = ("rad" if kind == kinds.mjJNT_HINGE else "m"), float(start[place.position])
        low, high = map(float, model.jnt_range[i])
        if model.jnt_limited[i]:  # limits are soft
            margin = 0.1 * (high - low)
            states.append(Channel(name, unit, low - margin, high + margin, neutral=neutral))
        else:
            states.append(Channel(name, unit, neutral=neutral, period=TURN if unit == "rad" else None))
        states.append(Channel(f"{name}_speed", f"{unit}/s"))
        joints.append(place)
    if len(free) > 1 or not (free or joints):
        raise IncompatibleSystem(
            f"{what}: expected at most one free joint and at least one joint, got {len(free)} free"
        )
    body = rigid_body_states(RigidBody()) if free else ()
    return [*body, *states], free[0] if free else None, tuple(joints)


def _actuators(what: str, model: Any) -> list[Channel]:
    if not model.nu:
        raise IncompatibleSystem(f"{what}: the model has no actuator, so that nothing can be controlled")
    found = []
    for i in range(model.nu):
        name = model.actuator(i).name or f"actuator_{i}"
        if not model.actuator_ctrllimited[i]:
            raise IncompatibleSystem(f"{what}: the actuator {name!r} has no limits: give it a ctrlrange in the file")
        low, high = map(float, model.actuator_ctrlrange[i])
        found.append(Channel(name, low=low, high=high))
    return found
