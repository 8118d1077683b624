"""Closed-loop rollouts of many candidates in many trials.

`rollout` runs P candidates in E trials on a dynamics. It has two forms with one signature. The *reference*
form is NumPy in float64; it takes any object that keeps the contracts, and the other form is tested against
it. The *compiled* form runs dynamics, controller and task as kernels, where all three have one.
`Rollouts.engine` says which ran.
How a kernel is written stands in `sysid_evo.kernels`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
