from .control import to_control
from .regression import TransitionRegressor

__all__ = ["TransitionRegressor", "to_control"]
