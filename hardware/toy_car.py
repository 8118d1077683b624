"""The toy car of the paper as a system (section 3), common to the real one and the emulated one."""

from __future__ import annotations

from sysid_evo.motion import PlanarBody
from sysid_evo.system import Channel, System

CAR = System(
    states=(
        Channel("forward_speed", "m/s"),
        Channel("lateral_speed", "m/s"),
        Channel("yaw_rate", "rad/s"),
    ),
    controls=(Channel("drive", levels=(-1.0, 0.0, 1.0)), Channel("steer", levels=(-1.0, 0.0, 1.0))),
    dt=0.05,
    motion=PlanarBody(),
    name="toy car",
)
