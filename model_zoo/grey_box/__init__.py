"""Physics with unknown parameters: a law in plain numbers, fitted, compiled, and told how sure it is."""

from model_zoo.grey_box.model import GreyBox
from model_zoo.grey_box.parameters import HiddenState, Parameter

__all__ = [
    "GreyBox",
    "HiddenState",
    "Parameter",
]
