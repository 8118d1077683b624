"""Which states and controls drive and steer a planar car: what families with a car's physics share."""

from __future__ import annotations

from typing import TypeAlias

from sysid_evo.dynamics import DynamicsModel, require_planar
from sysid_evo.errors import IncompatibleSystem
from sysid_evo.motion import PlanarBody
from sysid_evo.system import System

CarRoles: TypeAlias = tuple[int, int | None, int, int, int]
"""Where forward speed, lateral speed (None without one), yaw rate, drive and steer stand."""


def require_car(model: DynamicsModel, family: str, system: System, drive: str, steer: str) -> None:
    """Raise `IncompatibleSystem` unless ``system`` is a planar body with controls of these names."""
    require_planar(model, system)
    for role, name in (("drive", drive), ("steer", steer)):
        if name not in system.control_names:
            raise IncompatibleSystem(
                f"{family} needs a control for the role {role}: there is no {name!r} among "
                f"{', '.join(system.control_names) or 'no controls'}; name it with {role}=..."
            )


def car_roles(system: System, drive: str, steer: str) -> CarRoles:
    """Return the places of the roles in ``system``, a planar body."""
    assert isinstance(system.motion, PlanarBody)
    names = system.control_names
    return (*system.motion.indices(system.state_names), names.index(drive), names.index(steer))
