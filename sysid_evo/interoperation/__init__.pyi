from .python_control import to_control

__all__ = [
    "to_control",
]
