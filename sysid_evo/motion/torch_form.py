"""A motion on tensors: what models trained by gradients through time integrate with."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from sysid_evo.errors import IncompatibleSystem

if TYPE_CHECKING:
    from torch import Tensor

    from sysid_evo.system import System


class TorchMotion(Protocol):
    """States (..., nx) as tensors, differentiable."""

    def integrate(self, state: Tensor, change: Tensor, dt: float) -> Tensor:
        """Return the state ``dt`` later: `Motion.integrate` with ``change`` = acceleration dt."""

    def turned(self, state: Tensor, rate: Tensor) -> Tensor:
        """Return rate + w(x), see `Motion.turning`."""


class Straight:
    """Of a system without a motion: no frame turns."""

    def integrate(self, state: Tensor, change: Tensor, dt: float) -> Tensor:
        return state + change

    def turned(self, state: Tensor, rate: Tensor) -> Tensor:
        return rate


def torch_motion(system: System) -> TorchMotion:
    """Return the system's motion on tensors, `Straight` without a motion.

    Raises `IncompatibleSystem` if its motion has no such form.
    """
    if system.motion is None:
        return Straight()
    form = system.motion.torch_form(system.state_names)
    if form is None:
        raise IncompatibleSystem(
            f"motion {system.motion.kind} has no torch form, which families trained on free runs need: "
            "write its torch_form, or take another family"
        )
    return form
