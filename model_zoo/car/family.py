"""What families with a car's physics share: which states and controls drive and steer a planar body."""

from __future__ import annotations

from typing import TypeAlias

from sysid_evo.arrays import Array
from sysid_evo.dynamics import DynamicsModel, require_planar
from sysid_evo.errors import IncompatibleSystem
from sysid_evo.motion import PlanarBody
from sysid_evo.system import System

CarRoles: TypeAlias = tuple[int, int | None, int, int, int]
"""Where forward speed, lateral speed (None without one), yaw rate, drive and steer stand."""


class CarFamily(DynamicsModel):
    """A family of planar cars; ``drive`` and ``steer`` name the controls with these roles."""

    drive: str = "drive"
    steer: str = "steer"

    def check_system(self, system: System) -> None:
        require_planar(self, system)
        for role, name in (("drive", self.drive), ("steer", self.steer)):
            if name not in system.control_names:
                raise IncompatibleSystem(
                    f"{type(self).__name__} needs a control for the role {role}: there is no {name!r} among "
                    f"{', '.join(system.control_names) or 'no controls'}; name it with {role}=..."
                )

    @property
    def roles(self) -> CarRoles:
        """Where forward speed, lateral speed, yaw rate, drive and steer stand."""
        assert isinstance(self.system.motion, PlanarBody)
        names = self.system.control_names
        of_states = self.system.motion.indices(self.system.state_names)
        return (*of_states, names.index(self.drive), names.index(self.steer))

    def kernel_parameters(self, oldest_command: int = 0) -> Array:
        """Return the head of the parameters of both kernels of a car."""
        from model_zoo.kernels.car import HEAD

        forward, lateral, yaw_rate, drive, steer = self.roles
        return HEAD.pack(
            forward=forward,
            lateral=-1 if lateral is None else lateral,
            yaw_rate=yaw_rate,
            drive=drive,
            steer=steer,
            nx=self.system.nx,
            dt=self.system.dt,
            oldest_command=oldest_command,
        )
