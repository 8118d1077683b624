"""Recordings: episodes, data sets, readers, preparation."""

from sysid_evo.data.dataset import Dataset, Transitions
from sysid_evo.data.trajectory import Trajectory
from sysid_evo.data.windows import Windows

__all__ = ["Dataset", "Trajectory", "Transitions", "Windows"]
