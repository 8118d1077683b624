"""Physics with unknown parameters: an equation written in plain numbers, fitted, compiled, with standard errors."""

from model_zoo.grey_box.model import GreyBox
from model_zoo.grey_box.parameters import HiddenState, Parameter

__all__ = [
    "GreyBox",
    "HiddenState",
    "Parameter",
]
