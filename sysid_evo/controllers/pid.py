"""PID loops on named channels, with anti-windup; the gains are evolved."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from typing import Self

import numpy as np

from sysid_evo.controllers.controller import (
    ControllerLaw,
    LawController,
    channel_period,
    channel_scale,
    control_indices,
    observation_indices,
)
from sysid_evo.errors import InvalidArgument
from sysid_evo.kernels import Layout, nearest, splat, view
from sysid_evo.registry.registry import register_controller
from sysid_evo.tasks.task import Task


@register_controller("pid")
class Pid(LawController):
    """PID loops, each of which brings one observation to zero with one control; loops of the same control add up.

    ::

        y = b + sum of K_p e + K_i (integral of e) / T + K_d T (change of e) / dt,    e = o / scale

    limited to [-1, 1]. ``loops`` maps a control to an observation or a list of them: ``{heater: error}``. By
    default every control has a loop on every observation that is an error (its sine, if it is observed as sine and
    cosine), or, without any, on every observation but the bias. ``scales`` are the observations that count as an error
    of 1: by default the largest value, or 1 of the unit without limits. T is ``time`` (s). Gains of about 1 are
    therefore a reasonable start for any robot. Integrals are frozen while the output is saturated and they would
    increase it further (anti-windup). Changes of angles are the shortest ones.

    The parameters are K_p, K_i, K_d of every loop, then b of every control. The memory is the integral of every
    loop, its last error, and whether there was one.
    """

    def __init__(
        self,
        *,
        loops: Mapping[str, str | Sequence[str]] | None = None,
        scales: Mapping[str, float] | None = None,
        time: float = 1.0,
    ) -> None:
        if not 0.0 < time < np.inf:
            raise InvalidArgument(f"pid: expected time > 0 s, got {time}")
        if loops is not None and not (isinstance(loops, Mapping) and loops):
            raise InvalidArgument(f"pid: expected loops such as {{control: observation}}, got {loops!r}")
        wrong = [f"{name} {scale}" for name, scale in (scales or {}).items() if not 0.0 < scale < np.inf]
        if wrong:
            raise InvalidArgument(f"pid: expected scales > 0, got {', '.join(wrong)}")
        self.loops, self.scales, self.time = loops, scales, time

    def bind_to(self, task: Task) -> Self:
        bound = copy.copy(self)
        pairs = [
            (control, name)
            for control, names in (self.loops or _all_loops(task)).items()
            for name in ((names,) if isinstance(names, str) else names)
        ]
        observation_indices("pid: scales", tuple(self.scales or ()), task)
        observations = observation_indices("pid", [name for _, name in pairs], task)
        controls = control_indices("pid", [control for control, _ in pairs], task)
        rows = []
        for seen, control in zip(observations, controls, strict=True):
            channel = task.observations[seen]
            scale = (self.scales or {}).get(channel.name, channel_scale(channel))
            period = (channel_period(channel) or 0.0) / scale
            per_period = 1.0 / period if period else 0.0
            shares = {"per_scale": 1.0 / scale, "period": period, "per_period": per_period}
            rows.append(LOOP.pack(observation=seen, control=control, **shares))
        n, nu = len(rows), task.system.nu
        bound.n_observations, bound.n_outputs = len(task.observations), nu
        bound.n_parameters, bound.n_memory = 3 * n + nu, 2 * n + 1
        shared = HEAD.pack(*rows, n_loops=n, n_outputs=nu, dt=task.system.dt, time=self.time)
        bound.law = ControllerLaw(pid, shared, n_scratch=n + nu)
        return bound


def _all_loops(task: Task) -> dict[str, list[str]]:
    names = [channel.name for channel in task.observations if channel.name != "bias"]
    errors = [name for name in names if "error" in name and not name.startswith("cos_")]
    if not names:
        raise InvalidArgument("pid: the task has no observation that a loop could bring to zero")
    return dict.fromkeys(task.system.control_names, errors or names)


HEAD = Layout("n_loops", "n_outputs", "dt", "time")
LOOP = Layout("observation", "control", "per_scale", "period", "per_period")
"""A loop brings an ``observation`` to zero with a ``control``, both given by index.

``per_scale`` is 1 / the observation that counts as an error of 1; ``period`` (0: none) is that of the observation
times ``per_scale``.
"""


def pid(theta, memory, observation, raw, parameters, scratch):
    """Proportional, integral and derivative terms, then the outputs with anti-windup; see `Pid`."""
    n_loops, n_outputs = int(parameters[HEAD.n_loops]), int(parameters[HEAD.n_outputs])
    fraction = parameters[HEAD.dt] / parameters[HEAD.time]
    per_step = parameters[HEAD.time] / parameters[HEAD.dt]
    begun = memory[2 * n_loops]
    for i in range(n_outputs):
        raw[i] = theta[3 * n_loops + i]
        scratch[n_loops + i] = theta[3 * n_loops + i]
    for loop in range(n_loops):
        p = view(parameters, HEAD.size + loop * LOOP.size)
        control = int(p[LOOP.control])
        error = observation[int(p[LOOP.observation])] * p[LOOP.per_scale]
        change = error - memory[n_loops + loop]
        change = change - p[LOOP.period] * nearest(change * p[LOOP.per_period])
        immediate = theta[3 * loop] * error + theta[3 * loop + 2] * begun * change * per_step
        pushed = immediate + theta[3 * loop + 1] * (memory[loop] + error * fraction)
        scratch[n_loops + control] += pushed
        raw[control] += immediate
        memory[n_loops + loop] = error
        scratch[loop] = error
    for loop in range(n_loops):
        control = int(view(parameters, HEAD.size + loop * LOOP.size)[LOOP.control])
        error, ki = scratch[loop], theta[3 * loop + 1]
        output = scratch[n_loops + control]
        beyond = output if abs(output) > 1.0 else 0.0
        integral = memory[loop] + (0.0 if beyond * ki * error > 0.0 else error * fraction)
        memory[loop] = integral
        raw[control] += ki * integral
    for i in range(n_outputs):
        raw[i] = min(max(raw[i], -1.0), 1.0)
    memory[2 * n_loops] = splat(1.0)
