"""LQR, computed from a linear model: the optimal linear feedback near the targets of a task."""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Self, cast

import numpy as np

from sysid_evo.controllers.controller import ControllerLaw, LawController, channel_scale
from sysid_evo.controllers.inner_model import load_inner_model
from sysid_evo.errors import IncompatibleTask, InvalidArgument
from sysid_evo.extras import missing_extra
from sysid_evo.kernels import Layout, splat
from sysid_evo.models.dynamics import Dynamics, started
from sysid_evo.randomness import trial_seeds
from sysid_evo.registry.registry import register_controller
from sysid_evo.tasks.task import Task
from sysid_evo.tasks.tracking import OBSERVED_TOLERANCES, TrackingState, TrackingTask
from sysid_evo.types import Array, check_shape

SAMPLES = 200
FIT_DISTANCE = 0.01
"""Distance from the targets, in sizes of the states, within which the feedback is fitted to observations."""
MAX_UNEXPLAINED = 0.05
"""Largest share of the feedback that may remain unexplained by observations."""


@register_controller("lqr")
class Lqr(LawController):
    """u = u_r - g K (x - x_r), as outputs within [-1, 1], for tasks with target states.

    K is the gain of the linear quadratic regulator (python-control's ``dlqr``) for the linear model
    x' = A x + B u + c of the system: the matrices ``a``, ``b`` and ``c``, or a ``model`` (the file of a fitted one, an
    emulated robot, a `Dynamics`), which is linearised numerically in the middle of the targets. x_r and u_r are the
    equilibrium on target. The cost is the sum of squares of states, with ``weights`` (1 for target states, 0.01 for
    others), and of controls, with ``effort``; each is divided by its size, for target states ten tolerances. The law
    is then expressed by observations, which is exact if these are linear in states and targets. The parameter is the
    logarithm of g: zero gives LQR itself.
    """

    is_baseline: ClassVar[bool] = True
    requires: ClassVar[tuple[str, ...]] = ("control",)
    n_parameters = 1

    def __init__(
        self,
        *,
        model: str | Dynamics | None = None,
        a: Sequence[Sequence[float]] | None = None,
        b: Sequence[Sequence[float]] | None = None,
        c: Sequence[float] | None = None,
        weights: Mapping[str, float] | None = None,
        effort: float = 0.01,
    ) -> None:
        if (model is None) == (a is None) or (a is None) != (b is None):
            raise InvalidArgument("lqr: expected either a model, or the matrices a and b (and optionally c)")
        if not 0.0 < effort < np.inf or any(not 0.0 <= weight < np.inf for weight in (weights or {}).values()):
            raise InvalidArgument(f"lqr: expected effort > 0 and weights >= 0, got {effort} and {weights}")
        self.model, self.a, self.b, self.c = model, a, b, c
        self.weights, self.effort = weights, effort

    def bind_to(self, task: Task) -> Self:
        if not isinstance(task, TrackingTask):
            raise IncompatibleTask(f"lqr needs a task with target states such as set_point, got {type(task).__name__}")
        unknown = [name for name in self.weights or () if name not in task.system.state_names]
        if unknown:
            raise IncompatibleTask(f"lqr: weights: no state {unknown[0]!r}; there are {task.system.state_names}")
        bound = copy.copy(self)
        began = task.begin(trial_seeds(0, SAMPLES))
        led = [goal.place for goal in task.goals]
        middle = task.system.neutral_state.copy()
        middle[led] = began.target.mean(axis=0)
        linear = self._linear(task, middle)
        gain = self._gain(task, linear, led)
        rest, feedback = _in_observations(task, linear, gain, began, led)
        bound.n_observations, bound.n_outputs = len(task.observations), task.system.nu
        shared = HEAD.pack(rest, feedback, n_inputs=bound.n_observations, n_outputs=bound.n_outputs)
        bound.law = ControllerLaw(lqr, shared)
        return bound

    def _linear(self, task: Task, middle: Array) -> LinearModel:
        if self.model is not None:
            return linear_model(load_inner_model("lqr", self.model, task), middle)
        nx, nu = task.system.nx, task.system.nu
        a, b = check_shape("lqr: a", self.a or (), (nx, nx)), check_shape("lqr: b", self.b or (), (nx, nu))
        return LinearModel(a, b, check_shape("lqr: c", np.zeros(nx) if self.c is None else self.c, (nx,)))

    def _gain(self, task: TrackingTask, linear: LinearModel, led: Sequence[int]) -> Array:
        """Return K (nu, nx)."""
        try:
            import control
        except ModuleNotFoundError as error:
            raise missing_extra("lqr", error.name) from error
        system = task.system
        wanted = {name: 1.0 if place in led else 0.01 for place, name in enumerate(system.state_names)}
        wanted |= dict(self.weights or {})
        sizes = [channel_scale(channel) for channel in system.states]
        for goal in task.goals:
            sizes[goal.place] = OBSERVED_TOLERANCES * goal.tolerance
        q = np.diag([wanted[channel.name] / size**2 for channel, size in zip(system.states, sizes, strict=True)])
        r = np.diag([self.effort / (0.5 * (channel.high - channel.low)) ** 2 for channel in system.controls])
        try:
            gain, _, _ = control.dlqr(linear.a, linear.b, q, r)
        except (ValueError, np.linalg.LinAlgError, control.ControlArgument) as error:
            raise InvalidArgument(f"lqr: no feedback stabilises this model: {error}") from error
        if not np.abs(gain).max() > 0.0:
            raise InvalidArgument("lqr: in this model no control acts on a state within one sample, as with a delay")
        return np.asarray(gain, dtype=np.float64)


def _in_observations(
    task: TrackingTask, linear: LinearModel, gain: Array, began: TrackingState, led: Sequence[int]
) -> tuple[Array, Array]:
    """Return tables (observations + 1, nu) that map observations to the outputs at rest, and to the feedback."""
    system = task.system
    at_rest = [linear.at_rest(target, led) for target in began.target]
    states, controls = (np.array(part) for part in zip(*at_rest, strict=True))
    sizes = np.array([channel_scale(channel) for channel in system.states])
    off = FIT_DISTANCE * sizes * np.random.default_rng(0).standard_normal(states.shape)
    shown = task.observe(began, states + off)
    shown = np.concatenate([shown, np.ones((len(shown), 1))], axis=1)
    span = np.array([0.5 * (channel.high - channel.low) for channel in system.controls])
    middle = np.array([0.5 * (channel.high + channel.low) for channel in system.controls])
    wanted = ((controls - middle) / span, -(off @ gain.T) / span)
    tables = [np.linalg.lstsq(shown, outputs, rcond=1e-10)[0] for outputs in wanted]
    for what, outputs, table in zip(("targets", "states"), wanted, tables, strict=True):
        misfit = np.abs(shown @ table - outputs).max()
        if misfit > MAX_UNEXPLAINED * max(np.abs(outputs).max(), 1e-9) and misfit > 1e-3:
            raise IncompatibleTask(f"lqr: the observations of {type(task).__name__} do not determine all {what}")
    return cast("Array", tables[0]), cast("Array", tables[1])


HEAD = Layout("n_inputs", "n_outputs")


def lqr(theta, memory, observation, raw, parameters, scratch):
    """Outputs at rest plus g times the feedback, see `Lqr`."""
    n_inputs, n_outputs = int(parameters[HEAD.n_inputs]), int(parameters[HEAD.n_outputs])
    size = (n_inputs + 1) * n_outputs
    strength = math.exp(min(max(theta[0], -5.0), 5.0))
    for j in range(n_outputs):
        at = HEAD.size + n_inputs * n_outputs + j
        rest, feedback = splat(parameters[at]), splat(parameters[at + size])
        for i in range(n_inputs):
            at = HEAD.size + i * n_outputs + j
            rest += parameters[at] * observation[i]
            feedback += parameters[at + size] * observation[i]
        raw[j] = min(max(rest + strength * feedback, -1.0), 1.0)


STEP = 1e-4
"""Step of a difference quotient, in sizes of the channel."""


@dataclass(frozen=True)
class LinearModel:
    """x' = A x + B u + c from one sample to the next: ``a`` (nx, nx), ``b`` (nx, nu) and ``c`` (nx,)."""

    a: Array
    b: Array
    c: Array

    def at_rest(self, target: Array, led: Sequence[int]) -> tuple[Array, Array]:
        """Return the equilibrium state (nx,) and control (nu,) with the states ``led`` at ``target``.

        The smallest of several equilibria; if there is none, the least-squares solution.
        """
        nx = len(self.a)
        wanted = np.zeros((len(led), nx + self.b.shape[1]))
        wanted[np.arange(len(led)), led] = 1.0
        steady = np.concatenate([np.eye(nx) - self.a, -self.b], axis=1)
        found = np.linalg.lstsq(np.concatenate([steady, wanted]), np.concatenate([self.c, target]), rcond=None)[0]
        return found[:nx], found[nx:]


def linear_model(dynamics: Dynamics, state: Array) -> LinearModel:
    """Return ``dynamics`` linearised around ``state`` (nx,) and the neutral control, by central differences.

    The rest of the carry is that of a system that has long been in this state, without noise.
    """
    system = dynamics.system
    neutral = system.neutral_control
    steps = STEP * np.array([channel_scale(channel) for channel in (*system.states, *system.controls)])
    moves = np.concatenate([np.diag(steps), -np.diag(steps), np.zeros((1, len(steps)))])
    states, controls = state + moves[:, : system.nx], neutral + moves[:, system.nx :]
    after = system.unwrap_towards(dynamics.step(started(dynamics, states), controls)[:, : system.nx], states)
    n = len(steps)
    slopes = ((after[:n] - after[n : 2 * n]) / (2.0 * steps[:, None])).T
    a, b = slopes[:, : system.nx], slopes[:, system.nx :]
    return LinearModel(a, b, after[-1] - a @ state - b @ neutral)
