"""The kernel library: predictors, and wrappers that turn them into the step of a model."""

from sysid_evo.kernels import Predictor
from sysid_evo.models.kernels.gaussian import gaussian_predictor
from sysid_evo.models.kernels.neighbours import neighbour_predictor
from sysid_evo.models.kernels.networks import command_network_predictor, network_predictor
from sysid_evo.models.kernels.polynomials import polynomial_predictor
from sysid_evo.models.kernels.shells import added, on_top, turning_frame, with_angles, within
from sysid_evo.models.kernels.stepping import runge_kutta_predictor, stepping_kernel

__all__ = [
    "Predictor",
    "added",
    "command_network_predictor",
    "gaussian_predictor",
    "neighbour_predictor",
    "network_predictor",
    "on_top",
    "polynomial_predictor",
    "runge_kutta_predictor",
    "stepping_kernel",
    "turning_frame",
    "with_angles",
    "within",
]
