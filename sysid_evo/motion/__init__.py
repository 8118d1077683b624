"""Motions: how states move a pose. The only place that knows about frames and their rotation."""

from sysid_evo.motion.contract import Motion, motion_from_dict
from sysid_evo.motion.planar_body import PlanarBody, frame_change, rotate

__all__ = ["Motion", "PlanarBody", "frame_change", "motion_from_dict", "rotate"]
