from .control import to_control

__all__ = ["to_control"]
