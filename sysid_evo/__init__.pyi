from .controllers import Controller, RecurrentNetwork, View
from .cross_validation import ConditionFold, EpisodeFold
from .data import Dataset, Trajectory, Transitions, Windows
from .dynamics import Dynamics, DynamicsModel, PlainDynamics
from .engine import DynamicsRunner, Rollouts, Runner, rollout
from .environments import make_env, make_vector_env
from .errors import SysidEvoError
from .evolution import (
    Champion,
    ControllerEvolution,
    EvolutionStrategy,
    MuPlusLambda,
    Schedule,
    Stage,
    evolve,
    evolve_controller,
)
from .interoperation import to_control
from .motion import Motion, PlanarBody
from .randomness import trial_seeds
from .registry import (
    Spec,
    load_plugin,
    make_aggregate,
    make_controller,
    make_model,
    make_robot,
    make_strategy,
    make_task,
    register_aggregate,
    register_controller,
    register_model,
    register_motion,
    register_probe,
    register_reader,
    register_robot,
    register_strategy,
    register_task,
)
from .store import CheckpointFile, load_champion, load_model, save_champion, save_model
from .system import Channel, System
from .tasks import PointToPoint, Task, TaskState, register_reward
from .version import __version__

__all__ = [
    "__version__",
    "Champion",
    "Channel",
    "CheckpointFile",
    "ConditionFold",
    "Controller",
    "ControllerEvolution",
    "Dataset",
    "Dynamics",
    "DynamicsModel",
    "DynamicsRunner",
    "EpisodeFold",
    "EvolutionStrategy",
    "Motion",
    "MuPlusLambda",
    "PlainDynamics",
    "PlanarBody",
    "PointToPoint",
    "RecurrentNetwork",
    "Rollouts",
    "Runner",
    "Schedule",
    "Spec",
    "Stage",
    "System",
    "SysidEvoError",
    "Task",
    "TaskState",
    "Trajectory",
    "Transitions",
    "View",
    "Windows",
    "evolve",
    "evolve_controller",
    "load_champion",
    "load_model",
    "load_plugin",
    "make_aggregate",
    "make_controller",
    "make_env",
    "make_model",
    "make_robot",
    "make_strategy",
    "make_task",
    "make_vector_env",
    "register_aggregate",
    "register_controller",
    "register_model",
    "register_motion",
    "register_probe",
    "register_reader",
    "register_reward",
    "register_robot",
    "register_strategy",
    "register_task",
    "rollout",
    "save_champion",
    "save_model",
    "to_control",
    "trial_seeds",
]
