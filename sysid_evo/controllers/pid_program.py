"""PID loops as a program that can be written in other languages."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.export.program import (
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

if TYPE_CHECKING:
    from sysid_evo.controllers.pid import Pid


def pid_program(pid: Pid, parameters: Array) -> Program:
    """Return a bound `Pid` with these parameters (n_parameters,) as a program."""
    n = len(pid.made)
    gains = parameters[: 3 * n].reshape(n, 3).T
    kp, ki, kd = (constant(name, row) for name, row in zip(("K_P", "K_I", "K_D"), gains, strict=True))
    bias, adds_to = constant("BIAS", parameters[3 * n :]), pid.adds_to.T
    integral, last, begun = remembered("integral", n), remembered("last", n), remembered("begun", 1)
    scale, period = (np.array([getattr(loop, name) for loop in pid.made]) for name in ("scale", "period"))
    places = [loop.observation for loop in pid.made]
    seen = take("ERROR_AT", observation(pid.n_observations), *places)
    error = Statement("error", seen / constant("SCALE", scale), "what each loop brings to zero")
    change = error.value - last
    if period.any():
        difference = Statement("difference", change)
        turns = apply("round", difference.value / constant("TURN", np.where(period > 0.0, period, 1.0)))
        shortest = Statement("change", difference.value - constant("PERIOD", period) * turns, "the shortest way round")
        before: tuple[Statement, ...] = (error, difference, shortest)
    else:
        shortest = Statement("change", change, "since the last sample")
        before = (error, shortest)
    rate = kd * begun * shortest.value * (pid.time / pid.dt)
    immediate = Statement("immediate", kp * error.value + rate, "proportional and derivative terms")
    grown = Statement("grown", integral + error.value * (pid.dt / pid.time), "integrals, if they all grow")
    pushed = Statement("pushed", immediate.value + ki * grown.value)
    output = Statement("output", bias + dot("ADDS_TO", adds_to, pushed.value), "before the limits")
    beyond = Statement("beyond", choose(apply("abs", output.value), ">", 1.0, output.value, 0.0))
    out = Statement("out", take("MOVES", beyond.value, *(loop.control for loop in pid.made)))
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
