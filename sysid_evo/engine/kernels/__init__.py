"""The kernel library: predictors, and the shells that make a model's step of them."""

from sysid_evo.engine.kernels.angles import with_angles
from sysid_evo.engine.kernels.command_networks import command_network_predictor
from sysid_evo.engine.kernels.gaussian import gaussian_predictor
from sysid_evo.engine.kernels.neighbours import neighbour_predictor
from sysid_evo.engine.kernels.networks import network_predictor, separate_networks_predictor
from sysid_evo.engine.kernels.polynomial import polynomial_predictor
from sysid_evo.engine.kernels.runge_kutta import runge_kutta_predictor
from sysid_evo.engine.kernels.shells import added, on_top, turning_frame, within
from sysid_evo.engine.kernels.stepping import stepping_kernel
from sysid_evo.kernels import Predictor

__all__ = [
    "Predictor",
    "added",
    "command_network_predictor",
    "gaussian_predictor",
    "network_predictor",
    "neighbour_predictor",
    "on_top",
    "polynomial_predictor",
    "runge_kutta_predictor",
    "separate_networks_predictor",
    "stepping_kernel",
    "turning_frame",
    "with_angles",
    "within",
]
