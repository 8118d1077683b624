"""Tasks for which controllers are evolved."""

from sysid_evo.tasks.point_to_point import PointToPoint
from sysid_evo.tasks.references import Balance, SetPoint, SwingUp, TrackReference
from sysid_evo.tasks.reward import NamedReward, Reward, register_reward
from sysid_evo.tasks.task import Scene, Target, Task, TaskState, learn_task, make_task
from sysid_evo.tasks.walled_track import WalledTrack

__all__ = [
    "Balance",
    "NamedReward",
    "PointToPoint",
    "Reward",
    "Scene",
    "SetPoint",
    "SwingUp",
    "Target",
    "Task",
    "TaskState",
    "TrackReference",
    "WalledTrack",
    "learn_task",
    "make_task",
    "register_reward",
]
