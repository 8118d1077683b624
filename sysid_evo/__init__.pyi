from .artefacts import CheckpointFile, is_stored_artefact, read_artefact
from .controllers.controller import Controller, View, make_controller
from .controllers.networks import RecurrentNetwork
from .data.dataset import Dataset, Transitions
from .data.trajectory import Trajectory, Windows
from .engine.results import Rollouts
from .engine.rollout import DynamicsRunner, Runner, rollout
from .environments.environments import make_env, make_vector_env
from .errors import SysidEvoError
from .evolution.aggregates import make_aggregate
from .evolution.champion import Champion, load_champion, save_champion
from .evolution.controller_evolution import ControllerEvolution, evolve_controller
from .evolution.loop import Objective, evolve
from .evolution.strategies.mu_plus_lambda import MuPlusLambda
from .evolution.strategies.strategy import EvolutionStrategy, make_strategy
from .interoperation import to_control
from .models.adapters import Adapter, as_model
from .models.base import DynamicsModel, make_model
from .models.dynamics import Dynamics, PlainDynamics
from .models.storage import load_model, save_model
from .motion import Motion, PlanarBody
from .progress import Progress
from .randomness import trial_seeds
from .registry.grammar import Spec
from .registry.plugins import load_plugin
from .registry.registry import (
    make_robot,
    register_adapter,
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
from .rigid_body import RigidBody
from .system import Channel, System
from .tasks.point_to_point import PointToPoint
from .tasks.reward import register_reward
from .tasks.task import Task, TaskState, learn_task, make_task
from .validation.folds import ConditionFold, EpisodeFold
from .version import __version__

__all__ = [
    "__version__",
    "Adapter",
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
    "Objective",
    "PlainDynamics",
    "PlanarBody",
    "PointToPoint",
    "Progress",
    "RecurrentNetwork",
    "RigidBody",
    "Rollouts",
    "Runner",
    "Spec",
    "System",
    "SysidEvoError",
    "Task",
    "TaskState",
    "Trajectory",
    "Transitions",
    "View",
    "Windows",
    "as_model",
    "evolve",
    "evolve_controller",
    "is_stored_artefact",
    "learn_task",
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
    "read_artefact",
    "register_adapter",
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
