"""The three functions of a motion's compiled form in one step, so that they can be compared with those on arrays."""

from sysid_evo.engine.compiled.lanes import LANES, view
from sysid_evo.engine.compiled.layout import Layout

HEAD = Layout("nx", "dt")


def all_three(carry, control, noise, parameters, scratch):
    """Integrate the second nx rows, turn the third nx rows, and move the pose after them."""
    nx, dt, own = int(parameters[HEAD.nx]), parameters[HEAD.dt], view(parameters, HEAD.size)
    after, rate, pose = view(carry, nx * LANES), view(carry, 2 * nx * LANES), view(carry, 3 * nx * LANES)
    integrate(carry, after, nx, dt, own)
    turn_frame(carry, rate, own)
    move_pose(pose, carry, after, dt, own)
