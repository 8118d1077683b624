from .compiled.open_loop import kernel_step
from .results import Rollouts, behaviour_names
from .rollout import DynamicsRunner, Engine, Runner, as_runners, rollout

__all__ = [
    "DynamicsRunner",
    "as_runners",
    "Engine",
    "Rollouts",
    "Runner",
    "behaviour_names",
    "kernel_step",
    "rollout",
]
