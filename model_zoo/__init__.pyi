from .grey_box.model import GreyBox
from .grey_box.parameters import Hidden, Parameter
from .networks.torch_ode import TorchOde
from .polynomial.sindy import Sindy

__all__ = [
    "GreyBox",
    "Hidden",
    "Parameter",
    "Sindy",
    "TorchOde",
]
