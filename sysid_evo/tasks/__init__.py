"""Tasks for which controllers are evolved."""

from sysid_evo.tasks.point_to_point import PointToPoint
from sysid_evo.tasks.task import Scene, Target, Task, TaskState

__all__ = ["PointToPoint", "Scene", "Target", "Task", "TaskState"]
