from .behaviour import behaviour_names
from .compiled.dialect import KernelSource, Lifted
from .compiled.kernel import (
    ADVANCE,
    CONTROLLER,
    DYNAMICS,
    OBSERVE,
    ControllerKernel,
    DynamicsKernel,
    TaskKernel,
)
from .compiled.lanes import LANES, load, splat, store, view, where_less
from .compiled.layout import Layout
from .compiled.signature import Signature
from .compiled.single_step import kernel_step
from .kernels import (
    Predictor,
    added,
    command_network_predictor,
    gaussian_predictor,
    neighbour_predictor,
    network_predictor,
    polynomial_predictor,
    runge_kutta_predictor,
    separate_networks_predictor,
    stepping_kernel,
    turning_frame,
    with_angles,
    within,
)
from .rollouts import DynamicsRunner, Engine, Rollouts, Runner, available_processors, rollout

__all__ = [
    "ADVANCE",
    "CONTROLLER",
    "ControllerKernel",
    "DYNAMICS",
    "DynamicsKernel",
    "DynamicsRunner",
    "Engine",
    "KernelSource",
    "LANES",
    "Layout",
    "Lifted",
    "OBSERVE",
    "Predictor",
    "Rollouts",
    "Runner",
    "Signature",
    "TaskKernel",
    "added",
    "available_processors",
    "behaviour_names",
    "command_network_predictor",
    "gaussian_predictor",
    "kernel_step",
    "load",
    "neighbour_predictor",
    "network_predictor",
    "polynomial_predictor",
    "rollout",
    "runge_kutta_predictor",
    "separate_networks_predictor",
    "splat",
    "stepping_kernel",
    "store",
    "turning_frame",
    "view",
    "where_less",
    "with_angles",
    "within",
]
