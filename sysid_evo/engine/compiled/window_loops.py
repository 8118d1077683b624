"""The loops over recorded windows, as kernel functions: the error after the last step, or all states on the way."""

from __future__ import annotations

from sysid_evo.engine.compiled.loops import clip
from sysid_evo.kernels import DYNAMICS, LANES, NUMBER, WHOLES, Layout, Signature

OPEN = Layout("windows", "steps", "n_carry", "nx", "nu", "n_parameters")


def open_loop(
    dynamics, sizes, parameters_of, start, controls, truth, first, last,
    weight, carry, control, noise, parameters, scratch, error,
):  # fmt: skip
    """Simulate every window under recorded controls for candidates ``first`` to ``last``.

    ``error`` of a candidate is the mean over windows and states of the square difference
    after the last step times the state's ``weight``; not a number where a simulation diverged.
    """
    windows, steps, n_carry = sizes[OPEN.windows], sizes[OPEN.steps], sizes[OPEN.n_carry]
    nx, nu, n_parameters = sizes[OPEN.nx], sizes[OPEN.nu], sizes[OPEN.n_parameters]
    for candidate in range(first, last):
        for i in range(n_parameters):
            parameters[i] = parameters_of[candidate * n_parameters + i]
        total = 0.0
        for block in range((windows + LANES - 1) // LANES):
            used = min(LANES, windows - block * LANES)
            for lane in range(LANES):
                window = min(block * LANES + lane, windows - 1)
                for row in range(n_carry):
                    carry[row * LANES + lane] = start[window * n_carry + row]
            for k in range(steps):
                for lane in range(LANES):
                    window = min(block * LANES + lane, windows - 1)
                    for row in range(nu):
                        control[row * LANES + lane] = controls[(window * steps + k) * nu + row]
                dynamics(carry, control, noise, parameters, scratch)
            for row in range(nx):
                for lane in range(used):
                    off = carry[row * LANES + lane] - truth[(block * LANES + lane) * nx + row]
                    total += off * off * weight[row]
        error[candidate] = total / float(windows * nx)


def free_runs(
    dynamics, sizes, parameters_of, start, controls, envelope, first, last,
    carry, control, noise, parameters, scratch, states,
):  # fmt: skip
    """Simulate every window for candidates ``first`` to ``last``, each from carries of its own, and keep all states.

    ``start`` is (candidates, windows, n_carry), ``states`` (candidates, windows, steps, nx), clipped to the envelope.
    """
    windows, steps, n_carry = sizes[OPEN.windows], sizes[OPEN.steps], sizes[OPEN.n_carry]
    nx, nu, n_parameters = sizes[OPEN.nx], sizes[OPEN.nu], sizes[OPEN.n_parameters]
    for candidate in range(first, last):
        for i in range(n_parameters):
            parameters[i] = parameters_of[candidate * n_parameters + i]
        for block in range((windows + LANES - 1) // LANES):
            used = min(LANES, windows - block * LANES)
            for lane in range(LANES):
                window = min(block * LANES + lane, windows - 1)
                for row in range(n_carry):
                    carry[row * LANES + lane] = start[(candidate * windows + window) * n_carry + row]
            for k in range(steps):
                for lane in range(LANES):
                    window = min(block * LANES + lane, windows - 1)
                    for row in range(nu):
                        control[row * LANES + lane] = controls[(window * steps + k) * nu + row]
                dynamics(carry, control, noise, parameters, scratch)
                clip(carry, envelope, nx)
                for lane in range(used):
                    at = ((candidate * windows + block * LANES + lane) * steps + k) * nx
                    for row in range(nx):
                        states[at + row] = carry[row * LANES + lane]


OPEN_LOOP = Signature.of(open_loop, dynamics=DYNAMICS, sizes=WHOLES, first=NUMBER, last=NUMBER)
FREE_RUNS = Signature.of(free_runs, dynamics=DYNAMICS, sizes=WHOLES, first=NUMBER, last=NUMBER)
