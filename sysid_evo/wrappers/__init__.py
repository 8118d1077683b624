"""Dynamics around dynamics: what a controller meets on a robot and not in a model."""

from sysid_evo.wrappers.delayed_estimate import DelayedEstimate

__all__ = ["DelayedEstimate"]
