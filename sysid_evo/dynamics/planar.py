"""Families that describe a body on a plane and nothing else."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sysid_evo.errors import IncompatibleSystem

if TYPE_CHECKING:
    from sysid_evo.dynamics.model import DynamicsModel
    from sysid_evo.system import System


def require_planar(model: DynamicsModel, system: System) -> None:
    """Raise `IncompatibleSystem` unless the states of ``system`` move a planar body."""
    if system.motion is None or system.motion.kind != "planar_body":
        raise IncompatibleSystem(
            f"{type(model).__name__} describes a planar body, but the system has "
            f"{'no motion' if system.motion is None else 'the motion ' + system.motion.kind}"
        )
