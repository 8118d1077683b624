"""Tasks: what a controller is evolved for."""

from sysid_evo.tasks.point_to_point import PointToPoint
from sysid_evo.tasks.registered_reward import NamedReward, register_reward
from sysid_evo.tasks.reward import Reward
from sysid_evo.tasks.scene import Scene, Target
from sysid_evo.tasks.set_point import SetPoint
from sysid_evo.tasks.task import Task, TaskState
from sysid_evo.tasks.track_reference import TrackReference
from sysid_evo.tasks.upright import Balance, SwingUp
from sysid_evo.tasks.walled_track import WalledTrack

__all__ = [
    "Balance", "NamedReward", "PointToPoint", "Reward", "Scene", "SetPoint", "SwingUp", "Target", "Task", "TaskState",
    "TrackReference", "WalledTrack", "register_reward",
]  # fmt: skip
