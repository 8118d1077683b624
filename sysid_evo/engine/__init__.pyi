from .behaviour import behaviour_names
from .compiled.single_step import kernel_step
from .kernels import (
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
from .rollouts import DynamicsRunner, Engine, Rollouts, Runner, as_runners, available_processors, rollout

__all__ = [
    "DynamicsRunner",
    "as_runners",
    "Engine",
    "Rollouts",
    "Runner",
    "added",
    "available_processors",
    "behaviour_names",
    "command_network_predictor",
    "gaussian_predictor",
    "kernel_step",
    "neighbour_predictor",
    "network_predictor",
    "polynomial_predictor",
    "rollout",
    "runge_kutta_predictor",
    "separate_networks_predictor",
    "stepping_kernel",
    "turning_frame",
    "with_angles",
    "within",
]
