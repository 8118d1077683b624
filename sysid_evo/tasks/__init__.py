"""Tasks: what a controller is evolved for."""

from sysid_evo.tasks.point_to_point import PointToPoint
from sysid_evo.tasks.scene import Scene
from sysid_evo.tasks.task import Task, TaskState

__all__ = ["PointToPoint", "Scene", "Task", "TaskState"]
