"""PID loops on named channels, with anti-windup; the gains are evolved."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from sysid_evo.controllers.controller import Controller, View, controlled, observed, period_of, size_of
from sysid_evo.controllers.program import (
    Program,
    Statement,
    apply,
    choose,
    constant,
    dot,
    limited,
    observation,
    remembered,
    take,
)
from sysid_evo.errors import InvalidArgument
from sysid_evo.kernels import LANES, ControllerKernel, KernelSource, Layout, nearest, view
from sysid_evo.registry.registry import register_controller
from sysid_evo.tasks.task import Task
from sysid_evo.types import Array, check_shape


@dataclass(frozen=True)
class Loop:
    """One loop: the ``observation`` it brings to zero and the ``control`` it moves, by their places.

    ``scale`` is what counts as an error of 1; ``period`` (0: none) is that of the observation, in such errors.
    """

    observation: int
    control: int
    scale: float
    period: float


@register_controller("pid")
class Pid(Controller):
    """Every loop brings one observation to zero with one control; loops on the same control add up.

    ::

        y = b + sum of K_p e + K_i (integral of e) / T + K_d T (change of e) / dt,    e = o / scale

    limited to [-1, 1]. ``loops`` maps a control to an observation or a list of them: ``{heater: error}``. By
    default every control has a loop on every observation of the task called an error (where it is shown as sine and
    cosine, on the sine), or, where there is none, on every observation but the bias. An error of 1 is the largest
    value that the observation can take, 1 of its unit where it has no limits, or what ``scales`` says; T is ``time``
    (s). So gains of about 1 are a fair start for any robot. Integrals stand still while the output is beyond its
    limits and they would drive it further (anti-windup). Angles change the shortest way round.

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
        observed("pid: scales", tuple(self.scales or ()), task)
        observations = observed("pid", [name for _, name in pairs], task)
        controls = controlled("pid", [control for control, _ in pairs], task)
        made = []
        for seen, control in zip(observations, controls, strict=True):
            channel = task.observations[seen]
            scale = (self.scales or {}).get(channel.name, size_of(channel))
            made.append(Loop(seen, control, scale, (period_of(channel) or 0.0) / scale))
        bound.made = tuple(made)
        bound.n_observations = len(task.observations)
        bound.dt, bound.n_outputs = task.system.dt, task.system.nu
        bound.n_parameters = 3 * len(made) + bound.n_outputs
        bound.n_memory = 2 * len(made) + 1
        return bound

    made: tuple[Loop, ...]
    n_observations: int
    dt: float
    n_outputs: int

    @property
    def adds_to(self) -> Array:
        """1 where a loop moves a control, else 0, (loops, n_outputs)."""
        table = np.zeros((len(self.made), self.n_outputs))
        table[np.arange(len(self.made)), [loop.control for loop in self.made]] = 1.0
        return table

    def act(self, parameters: Array, memory: Array, view: View) -> tuple[Array, Array]:
        check_shape("parameters", parameters, (None, self.n_parameters))
        n = len(self.made)
        kp, ki, kd = parameters[:, : 3 * n].reshape(-1, n, 3).transpose(2, 0, 1)[:, :, None]
        bias = parameters[:, None, 3 * n :]
        integral, last, begun = memory[..., :n], memory[..., n : 2 * n], memory[..., 2 * n :]
        places, controls = [loop.observation for loop in self.made], [loop.control for loop in self.made]
        scale, period = (np.array([getattr(loop, name) for loop in self.made]) for name in ("scale", "period"))
        error = view.observation[..., places] / scale
        change = error - last
        change = change - period * np.round(change / np.where(period > 0.0, period, 1.0))
        immediate = kp * error + kd * begun * change * (self.time / self.dt)
        grown = integral + error * (self.dt / self.time)
        adds_to = self.adds_to
        output = bias + (immediate + ki * grown) @ adds_to
        beyond = np.where(np.abs(output) > 1.0, output, 0.0)[..., controls]
        kept = np.where(beyond * ki * error > 0.0, integral, grown)
        raw = np.clip(bias + (immediate + ki * kept) @ adds_to, -1.0, 1.0)
        return raw, np.concatenate([kept, error, np.ones_like(begun)], axis=-1)

    def kernel(self) -> ControllerKernel:
        rows = [
            LOOP.pack(
                observation=loop.observation,
                control=loop.control,
                per_scale=1.0 / loop.scale,
                period=loop.period,
                per_period=1.0 / loop.period if loop.period else 0.0,
            )
            for loop in self.made
        ]
        parameters = HEAD.pack(*rows, n_loops=len(self.made), n_outputs=self.n_outputs, dt=self.dt, time=self.time)
        return ControllerKernel(KernelSource(act_lanes), parameters, len(self.made) + self.n_outputs)

    def program(self, parameters: Array) -> Program:
        n = len(self.made)
        gains = parameters[: 3 * n].reshape(n, 3).T
        kp, ki, kd = (constant(name, row) for name, row in zip(("K_P", "K_I", "K_D"), gains, strict=True))
        bias, adds_to = constant("BIAS", parameters[3 * n :]), self.adds_to.T
        integral, last, begun = remembered("integral", n), remembered("last", n), remembered("begun", 1)
        scale, period = (np.array([getattr(loop, name) for loop in self.made]) for name in ("scale", "period"))
        places = [loop.observation for loop in self.made]
        seen = take("ERROR_AT", observation(self.n_observations), *places)
        error = Statement("error", seen / constant("SCALE", scale), "what each loop brings to zero")
        change = error.value - last
        if period.any():
            difference = Statement("difference", change)
            turns = apply("round", difference.value / constant("TURN", np.where(period > 0.0, period, 1.0)))
            shortest = Statement(
                "change", difference.value - constant("PERIOD", period) * turns, "the shortest way round"
            )
            before: tuple[Statement, ...] = (error, difference, shortest)
        else:
            shortest = Statement("change", change, "since the last sample")
            before = (error, shortest)
        rate = kd * begun * shortest.value * (self.time / self.dt)
        immediate = Statement("immediate", kp * error.value + rate, "proportional and derivative terms")
        grown = Statement("grown", integral + error.value * (self.dt / self.time), "integrals, if they all grow")
        pushed = Statement("pushed", immediate.value + ki * grown.value)
        output = Statement("output", bias + dot("ADDS_TO", adds_to, pushed.value), "before the limits")
        beyond = Statement("beyond", choose(apply("abs", output.value), ">", 1.0, output.value, 0.0))
        out = Statement("out", take("MOVES", beyond.value, *(loop.control for loop in self.made)))
        kept = Statement(
            "kept",
            choose(out.value * ki * error.value, ">", 0.0, integral, grown.value),
            "an integral that would drive its output further beyond stands still",
        )
        final = Statement("final", immediate.value + ki * kept.value)
        raw = Statement("raw", limited(bias + dot("ADDS_TO", adds_to, final.value)), "outputs in [-1, 1]")
        one = Statement("one", apply("abs", begun * 0.0 + 1.0))
        return Program(
            (*before, immediate, grown, pushed, output, beyond, out, kept, final, raw, one),
            raw.value,
            {"integral": kept.value, "last": error.value, "begun": one.value},
        )


def _all_loops(task: Task) -> dict[str, list[str]]:
    names = [channel.name for channel in task.observations if channel.name != "bias"]
    errors = [name for name in names if "error" in name and not name.startswith("cos_")]
    if not names:
        raise InvalidArgument("pid: the task shows nothing that a loop could bring to zero")
    return dict.fromkeys(task.system.control_names, errors or names)


HEAD = Layout("n_loops", "n_outputs", "dt", "time")
LOOP = Layout("observation", "control", "per_scale", "period", "per_period")


def act_lanes(theta, memory, observation, raw, parameters, scratch):
    """Proportional, integral and derivative terms, then the outputs with integrals that do not wind up; see `Pid`."""
    n_loops, n_outputs = int(parameters[HEAD.n_loops]), int(parameters[HEAD.n_outputs])
    fraction = parameters[HEAD.dt] / parameters[HEAD.time]
    per_step = parameters[HEAD.time] / parameters[HEAD.dt]
    output, begun = view(scratch, n_loops * LANES), view(memory, 2 * n_loops * LANES)
    for i in range(n_outputs * LANES):
        raw[i] = theta[3 * n_loops * LANES + i]
        output[i] = raw[i]
    for loop in range(n_loops):
        p = view(parameters, HEAD.size + loop * LOOP.size)
        seen, error = view(observation, int(p[LOOP.observation]) * LANES), view(scratch, loop * LANES)
        total, final = view(output, int(p[LOOP.control]) * LANES), view(raw, int(p[LOOP.control]) * LANES)
        integral, last = view(memory, loop * LANES), view(memory, (n_loops + loop) * LANES)
        kp, ki, kd = (
            view(theta, 3 * loop * LANES),
            view(theta, (3 * loop + 1) * LANES),
            view(theta, (3 * loop + 2) * LANES),
        )
        for lane in range(LANES):
            error[lane] = seen[lane] * p[LOOP.per_scale]
            change = error[lane] - last[lane]
            change = change - p[LOOP.period] * nearest(change * p[LOOP.per_period])
            immediate = kp[lane] * error[lane] + kd[lane] * begun[lane] * change * per_step
            total[lane] += immediate + ki[lane] * (integral[lane] + error[lane] * fraction)
            final[lane] += immediate
            last[lane] = error[lane]
    for loop in range(n_loops):
        p = view(parameters, HEAD.size + loop * LOOP.size)
        total, final = view(output, int(p[LOOP.control]) * LANES), view(raw, int(p[LOOP.control]) * LANES)
        integral, error, ki = (
            view(memory, loop * LANES),
            view(scratch, loop * LANES),
            view(theta, (3 * loop + 1) * LANES),
        )
        for lane in range(LANES):
            beyond = total[lane] if abs(total[lane]) > 1.0 else 0.0
            held = beyond * ki[lane] * error[lane] > 0.0
            integral[lane] += 0.0 if held else error[lane] * fraction
            final[lane] += ki[lane] * integral[lane]
    for i in range(n_outputs * LANES):
        raw[i] = min(max(raw[i], -1.0), 1.0)
    for lane in range(LANES):
        begun[lane] = 1.0
