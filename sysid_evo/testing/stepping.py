"""What must hold for anything that steps: models, emulated robots."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sysid_evo.arrays import Array, IntArray
from sysid_evo.dynamics import Dynamics, clip_state
from sysid_evo.errors import ContractViolation
from sysid_evo.testing.arrays import copied, rows_off, twice

CHAINED_STEPS = 10
COMPILED_TOLERANCE = {"float64": 1e-7, "float32": 1e-3}
"""Of a number and of the largest in its column."""


@dataclass(frozen=True)
class Inputs:
    """What a step is given: carries (B, n_carry), controls (B, nu) and noise (B, n_noise) or None."""

    carry: Array
    control: Array
    noise: Array | None

    def rows(self, rows: IntArray | slice) -> Inputs:
        """Return some of the rows."""
        return Inputs(self.carry[rows], self.control[rows], None if self.noise is None else self.noise[rows])

    def followed_by(self, carry: Array, control: Array) -> Inputs:
        """Return these inputs and further ones, with the noise of the first rows."""
        noise = None if self.noise is None else np.concatenate([self.noise, self.noise[: len(carry)]])
        return Inputs(np.concatenate([self.carry, carry]), np.concatenate([self.control, control]), noise)


def step(dynamics: Dynamics, inputs: Inputs) -> Array:
    """Return the next carry (B, n_carry); ``inputs`` stay as they are, whatever a step does to its arguments."""
    return dynamics.step(*copied((inputs.carry, inputs.control, inputs.noise)))


def expect_shape_and_type(dynamics: Dynamics, inputs: Inputs) -> None:
    """Raise `ContractViolation` unless a step gives finite carries of the same shape, in float64."""
    carry, after = inputs.carry, step(dynamics, inputs)
    if carry.shape[1] != dynamics.n_carry:
        raise ContractViolation(f"start gives a carry of {carry.shape[1]} numbers, n_carry says {dynamics.n_carry}")
    if after.shape != carry.shape or after.dtype != np.float64:
        raise ContractViolation(f"expected {carry.shape} float64, got {after.shape} {after.dtype}")
    if not np.isfinite(after).all():
        raise ContractViolation("a step from a training state is not finite")


def expect_independent_rows(dynamics: Dynamics, inputs: Inputs) -> None:
    """Raise `ContractViolation` if the row of a batch depends on the others."""
    together = step(dynamics, inputs)
    alone = np.concatenate([step(dynamics, inputs.rows(slice(i, i + 1))) for i in range(len(inputs.carry))])
    back = np.arange(len(inputs.carry))[::-1]
    backwards = step(dynamics, inputs.rows(back))[back]
    alike = np.allclose(together, alone, rtol=1e-9, atol=1e-12, equal_nan=True)
    if not (alike and np.allclose(together, backwards, rtol=1e-9, equal_nan=True)):
        raise ContractViolation("a row's result changes with the other rows of its batch")


def expect_pure(dynamics: Dynamics, inputs: Inputs) -> None:
    """Raise `ContractViolation` if a step changes its arguments or its own later results."""
    twice("step", dynamics.step, inputs.carry, inputs.control, inputs.noise)


def expect_compiled_alike(dynamics: Dynamics, inputs: Inputs) -> None:
    """Raise `ContractViolation` if the compiled form, where there is one, steps otherwise than `step`."""
    kernel = dynamics.kernel()
    if kernel is None:
        return
    from sysid_evo.engine.compiled.single_step import kernel_step

    carry, control, noise = inputs.carry, inputs.control, inputs.noise
    stepped = step(dynamics, inputs)
    compiled = kernel_step(kernel, carry, control, noise, precision="float64")
    off = rows_off(compiled, stepped, COMPILED_TOLERANCE["float64"])
    if off.any():
        raise ContractViolation(f"{off.sum()} of {len(off)} rows differ after one step in float64")
    compiled = stepped = carry
    for _ in range(CHAINED_STEPS):
        compiled = kernel_step(kernel, compiled, control, noise, precision=kernel.precision)
        compiled, _ = clip_state(compiled, dynamics.envelope)
        stepped, _ = clip_state(dynamics.step(stepped, control, noise), dynamics.envelope)
    off = rows_off(compiled, stepped, COMPILED_TOLERANCE[kernel.precision])
    if off.mean() > 0.1:  # a few may: two neighbours as near as each other
        raise ContractViolation(
            f"{off.sum()} of {len(off)} rows differ after {CHAINED_STEPS} steps in {kernel.precision}"
        )
