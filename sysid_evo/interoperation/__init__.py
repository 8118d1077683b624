"""Models in the tools that users know already."""

from sysid_evo.interoperation.control import to_control

__all__ = ["to_control"]
