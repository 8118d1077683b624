"""Closed-loop rollouts of many candidates in many trials.

`rollout` runs P candidates in E trials on a dynamics. It has two forms with one signature. The *reference*
form is NumPy in float64; it takes any object that keeps the contracts, and the other form is tested against
it. The *compiled* form runs dynamics, controller and task as kernels, where all three have one.
`Rollouts.engine` says which ran; `resolve` says which form "auto" means.
How a kernel is written stands in `sysid_evo.kernels`.
"""

from sysid_evo.engine.compiled.open_loop import kernel_step
from sysid_evo.engine.results import Rollouts, behaviour_names
from sysid_evo.engine.rollout import DynamicsRunner, Runner, as_runners, rollout
from sysid_evo.processors import Engine, resolve

__all__ = [
    "DynamicsRunner", "Engine", "Rollouts", "Runner", "as_runners", "behaviour_names", "kernel_step", "resolve",
    "rollout",
]  # fmt: skip
