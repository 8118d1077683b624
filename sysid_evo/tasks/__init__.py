"""Tasks: what a controller is evolved for."""

from sysid_evo.tasks.point_to_point import PointToPoint
from sysid_evo.tasks.scene import Scene, Target
from sysid_evo.tasks.set_point import SetPoint
from sysid_evo.tasks.task import Task, TaskState
from sysid_evo.tasks.track_reference import TrackReference
from sysid_evo.tasks.upright import Balance, SwingUp

__all__ = [
    "Balance", "PointToPoint", "Scene", "SetPoint", "SwingUp", "Target", "Task", "TaskState", "TrackReference",
]  # fmt: skip
