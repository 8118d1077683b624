"""One block of `ExampleDynamics`."""

from sysid_evo.kernels import LANES, Layout

HEAD = Layout("nx", "nu", "decay")


def decay_and_push(carry, control, noise, parameters, scratch):
    """x' = decay x + offset + B u; the offset (nx,) and B (nx, nu) follow the head."""
    nx, nu = int(parameters[HEAD.nx]), int(parameters[HEAD.nu])
    for i in range(nx):
        for lane in range(LANES):
            after = parameters[HEAD.decay] * carry[i * LANES + lane] + parameters[HEAD.size + i]
            for j in range(nu):
                after += control[j * LANES + lane] * parameters[HEAD.size + nx + i * nu + j]
            carry[i * LANES + lane] = after
