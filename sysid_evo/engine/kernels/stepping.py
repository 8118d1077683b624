"""From a prediction to the next carry: integration, frame rotation, lags. The shell of most model kernels.

A *predictor* is a block function ``predict(x, u, p, y, scratch)``: it reads rows of the carry ``x``
and of the control ``u``, its own parameters ``p``, and writes ``nx`` rows to ``y``; ``scratch`` is
room of its own. A function ``prepare(u, p, scratch)`` may fill the head of that room once a step, before
an integrator asks several times under the same control.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.engine.compiled.dialect import KernelSource
from sysid_evo.engine.compiled.kernel import DynamicsKernel
from sysid_evo.engine.compiled.lanes import LANES, view
from sysid_evo.motion import PlanarBody
from sysid_evo.system import System

Output: TypeAlias = Literal["next_state", "acceleration"]

NX, NU, STATE_LAGS, CONTROL_LAGS, MODE, DT, FORWARD, LATERAL, YAW_RATE, REST, OWN = range(11)
HEADER = 16  # numbers: a cache line, so that what a predictor aligns in its parameters stays aligned
NEXT_STATE, PLAIN, PLANAR = range(3)


@dataclass(frozen=True)
class Predictor:
    """A block function, its flat parameters, the rows of scratch it needs, and what prepares them."""

    function: Any
    parameters: Array
    n_scratch: int
    prepare: Any = None

    @property
    def bindings(self) -> dict[str, Any]:
        """What a shell binds: ``predict`` and ``prepare``."""
        return {"predict": self.function, "prepare": self.prepare or nothing_to_prepare}


def nothing_to_prepare(u, p, scratch):
    """Leave the scratch as it is."""
    return


def stepping_kernel(
    predictor: Predictor,
    system: System,
    *,
    output: Output,
    lags: tuple[int, int] = (0, 0),
    rest_band: Array | None = None,
) -> DynamicsKernel:
    """Return the kernel of a model whose predictor gives the next state or an acceleration.

    The carry is that of `DynamicsModel`: state, earlier states, earlier controls (``lags``). With
    ``rest_band`` (nx,), a state that near neutral stays at neutral under neutral control, the earlier
    controls in the carry included.
    """
    header = np.zeros(HEADER)
    header[[NX, NU, STATE_LAGS, CONTROL_LAGS, DT]] = system.nx, system.nu, *lags, system.dt
    if output == "acceleration":
        header[MODE] = PLAIN
        if isinstance(system.motion, PlanarBody):
            forward, lateral, yaw_rate = system.motion.indices(system.state_names)
            if lateral is not None:
                header[[MODE, FORWARD, LATERAL, YAW_RATE]] = PLANAR, forward, lateral, yaw_rate
    rest = np.empty(0)
    if rest_band is not None:
        header[REST] = 1.0
        rest = np.concatenate([rest_band, system.neutral_state, system.neutral_control])
        rest = np.pad(rest, (0, -len(rest) % HEADER))
    header[OWN] = HEADER + len(rest)
    return DynamicsKernel(
        KernelSource(step, predictor.bindings),
        np.concatenate([header, rest, np.ravel(predictor.parameters)]),
        system.nx + 1 + predictor.n_scratch,
    )


def step(carry, control, noise, parameters, scratch):
    """Predict, integrate, and shift the lags."""
    nx, nu = int(parameters[NX]), int(parameters[NU])
    rows = nx * LANES
    moving = view(scratch, rows)
    own, room = view(parameters, int(parameters[OWN])), view(moving, LANES)
    prepare(control, own, room)
    predict(carry, control, own, scratch, room)
    mode, dt = int(parameters[MODE]), parameters[DT]
    if mode != NEXT_STATE:
        for i in range(rows):
            scratch[i] = carry[i] + dt * scratch[i]
    if mode == PLANAR:
        forward, lateral = int(parameters[FORWARD]) * LANES, int(parameters[LATERAL]) * LANES
        turn_back(view(scratch, forward), view(scratch, lateral), view(carry, int(parameters[YAW_RATE]) * LANES), dt)
    state_lags, control_lags = int(parameters[STATE_LAGS]), int(parameters[CONTROL_LAGS])
    past = view(carry, (1 + state_lags) * rows)
    if parameters[REST] > 0.0:
        hold(carry, control, past, control_lags, view(parameters, HEADER), nx, nu, moving, scratch)
    for back in range(state_lags, 0, -1):
        copy(view(carry, (back - 1) * rows), view(carry, back * rows), rows)
    size = nu * LANES
    for back in range(control_lags - 1, 0, -1):
        copy(view(past, (back - 1) * size), view(past, back * size), size)
    if control_lags > 0:
        copy(control, past, size)
    copy(scratch, carry, rows)


def hold(carry, control, past, control_lags, p, nx, nu, moving, after):
    """Put the lanes that rest under neutral control back to neutral; p: band, neutral state, neutral control."""
    for lane in range(LANES):
        moving[lane] = 0.0
    for row in range(nu):
        here, neutral = view(control, row * LANES), p[2 * nx + row]
        for lane in range(LANES):
            moving[lane] = moving[lane] if here[lane] == neutral else 1.0
    for lag in range(control_lags):
        for row in range(nu):
            here, neutral = view(past, (lag * nu + row) * LANES), p[2 * nx + row]
            for lane in range(LANES):
                moving[lane] = moving[lane] if here[lane] == neutral else 1.0
    for row in range(nx):
        here, neutral, band = view(carry, row * LANES), p[nx + row], p[row]
        for lane in range(LANES):
            moving[lane] = moving[lane] if abs(here[lane] - neutral) <= band else 1.0
    for row in range(nx):
        there, neutral = view(after, row * LANES), p[nx + row]
        for lane in range(LANES):
            there[lane] = there[lane] if moving[lane] > 0.0 else neutral


def turn_back(along, across, yaw_rate, dt):
    """Take the frame's own rotation out of the velocities: R(-r dt), see `PlanarBody`."""
    for lane in range(LANES):
        angle = yaw_rate[lane] * dt
        c, s = math.cos(angle), math.sin(angle)
        forward, lateral = along[lane], across[lane]
        along[lane] = c * forward + s * lateral
        across[lane] = c * lateral - s * forward


def copy(source, target, count):
    """Copy ``count`` numbers."""
    for i in range(count):
        target[i] = source[i]
