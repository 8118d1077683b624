"""What the control loop demands of a system, so that it can be refused before a robot moves."""

from __future__ import annotations

from sysid_evo.errors import IncompatibleSystem
from sysid_evo.system import System

TIME_TO_LIVE = 0.15  # s for which a command is valid: a robot whose host has died stops that soon
LATEST = 0.05  # s that a command may be late without the robot stopping in between
SLOWEST = TIME_TO_LIVE - LATEST  # s: the longest sampling time
PLANAR = 3  # numbers of a pose that the gate can judge
TOLERANCE = 1e-9  # s


def check_loop(system: System) -> None:
    """Raise `IncompatibleSystem` unless the loop can command ``system`` in time and see where it is."""
    if system.nu == 0:
        raise IncompatibleSystem("the control loop: expected a system with at least one control, got none")
    if system.n_pose != PLANAR:
        raise IncompatibleSystem(
            "the control loop: expected a system whose motion gives a planar pose (x, y, heading), got "
            + ("no motion" if system.motion is None else f"the motion {system.motion.kind}")
        )
    if system.dt > SLOWEST + TOLERANCE:
        raise IncompatibleSystem(
            f"the control loop: expected a sampling time dt of at most {SLOWEST:g} s, got {system.dt:g} s. A command "
            f"is valid for {TIME_TO_LIVE:g} s and the next may be {LATEST:g} s late, so that at a longer dt the robot "
            "would fall back to neutral between two commands; give the system a shorter dt"
        )
