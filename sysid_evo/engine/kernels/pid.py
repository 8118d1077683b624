"""PID loops over lanes: every lane has gains of its own."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sysid_evo.kernels import LANES, ControllerKernel, KernelSource, Layout, nearest, view

if TYPE_CHECKING:
    from sysid_evo.controllers.pid import Loop

HEAD = Layout("n_loops", "n_outputs", "dt", "time")
LOOP = Layout("observation", "control", "per_scale", "period", "per_period")


def pid_kernel(loops: tuple[Loop, ...], n_outputs: int, dt: float, time: float) -> ControllerKernel:
    """Return the compiled form of `Pid`."""
    rows = [
        LOOP.pack(
            observation=loop.observation,
            control=loop.control,
            per_scale=1.0 / loop.scale,
            period=loop.period,
            per_period=1.0 / loop.period if loop.period else 0.0,
        )
        for loop in loops
    ]
    parameters = HEAD.pack(*rows, n_loops=len(loops), n_outputs=n_outputs, dt=dt, time=time)
    return ControllerKernel(KernelSource(pid), parameters, len(loops) + n_outputs)


def pid(theta, memory, observation, raw, parameters, scratch):
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
