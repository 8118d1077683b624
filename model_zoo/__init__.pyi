from .auto.candidates import fit_seconds
from .grey_box.model import GreyBox
from .grey_box.parameters import HiddenState, Parameter
from .networks.torch_ode import TorchOde
from .polynomial.sindy import Sindy

__all__ = [
    "GreyBox",
    "HiddenState",
    "Parameter",
    "Sindy",
    "TorchOde",
    "fit_seconds",
]
