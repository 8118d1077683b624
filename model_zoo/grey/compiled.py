"""The compiled form of a structure: its law over lanes, integrated, with delay and limits."""

from __future__ import annotations

import numpy as np

from model_zoo.grey.structure import Structure, delay_shares
from model_zoo.kernels.grey import LawOverLanes
from sysid_evo.arrays import Array
from sysid_evo.engine.kernels import Predictor, added, runge_kutta_predictor, stepping_kernel, turning_frame
from sysid_evo.kernels import DynamicsKernel


def structure_kernel(
    structure: Structure, p: Array, *, rest_band: Array | None = None, extra: Predictor | None = None
) -> DynamicsKernel | None:
    """Return the kernel of a structure with parameters (n,); None if the motion has no compiled form.

    With ``rest_band`` (n,), an extended state that rests stays at rest; ``extra`` is added to the rates
    of the measured ones.
    """
    system, rows = structure.extended, structure.actuator_rows
    law = LawOverLanes(
        structure.law,
        structure.law_rows,
        structure.rate_rows,
        structure.known,
        structure.controls,
        tuple(range(rows.start, rows.stop)),
        len(structure.own),
        system.nx,
        system.nu,
        structure.delay,
    )
    own = Predictor(law, kernel_parameters(structure, p[None])[0], 0)
    rate = turning_frame(own if extra is None else added(own, extra, structure.system.nx), system)
    if rate is None:
        return None
    after = runge_kutta_predictor(rate, system, substeps=structure.substeps, n_carry=structure.layout.size)
    return stepping_kernel(after, system, output="next_state", lags=(0, structure.delay), rest_band=rest_band)


def kernel_parameters(structure: Structure, p: Array) -> Array:
    """Return what `LawOverLanes` reads (P, m), from parameters (P, n): 1 / lag, and shares of the delay."""
    n, lags = len(structure.own), len(structure.controls) if structure.lagged else 0
    parts = [p[:, :n], 1.0 / p[:, n : n + lags]]
    if structure.delay:
        parts.append(np.stack(delay_shares(p[:, -1], structure.delay), axis=1))
    own = np.concatenate(parts, axis=1)
    return own if own.shape[1] else np.zeros((len(p), 1))
