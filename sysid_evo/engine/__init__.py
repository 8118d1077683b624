"""Closed-loop rollouts of many candidates in many trials.

`rollout` runs P candidates in E trials on a dynamics, in one of two forms. The *reference* form is NumPy in float64
and accepts any object that follows the contracts. The *compiled* form runs dynamics, controller and task as kernels,
if all three have one, and is tested against the reference. `Rollouts.engine` names the form that ran;
`sysid_evo.processors.resolve` returns the form for "auto". See `sysid_evo.kernels` for how to write a kernel.
"""

from sysid_evo.engine.results import Rollouts, behaviour_names
from sysid_evo.engine.rollout import DynamicsRunner, Runner, as_runners, rollout

__all__ = ["DynamicsRunner", "Rollouts", "Runner", "as_runners", "behaviour_names", "rollout"]
