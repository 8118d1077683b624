"""Conformance kits: the contract of each kind of thing as sentences that plugin authors run, and CI runs.

``check_KIND(name)`` raises `ContractViolation` listing every broken sentence; ``run_KIND_checks(name)``
yields each sentence with its verdict (for models it is called `run_checks`). The kits of probes and of
robots are `evaluation.testing` and `hardware.testing`.
"""

from sysid_evo.testing.examples import ExampleDynamics, example_dataset, example_systems
from sysid_evo.testing.models import CHECKS, check_model, run_checks
from sysid_evo.testing.verdicts import CheckResult

__all__ = [
    "CHECKS",
    "CheckResult",
    "ExampleDynamics",
    "check_model",
    "example_dataset",
    "example_systems",
    "run_checks",
]
