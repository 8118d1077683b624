"""Conformance kits: the contract of each kind of thing as sentences that plugin authors run, and CI runs.

``check_KIND(name)`` raises `ContractViolation` listing every broken sentence; ``run_KIND_checks(name)``
yields each sentence with its verdict (for models it is called `run_checks`). The kit of robots stands beside
what it checks: `hardware.testing`.
"""

from sysid_evo.testing.closed_loop import check_controller, check_task, run_controller_checks, run_task_checks
from sysid_evo.testing.contract import CheckResult
from sysid_evo.testing.evolution import check_strategy, run_strategy_checks
from sysid_evo.testing.examples import ExampleDynamics, example_dataset, example_systems
from sysid_evo.testing.models import CHECKS, check_model, run_checks
from sysid_evo.testing.readers import check_reader, run_reader_checks

__all__ = [
    "CHECKS",
    "CheckResult",
    "ExampleDynamics",
    "check_controller",
    "check_model",
    "check_reader",
    "check_strategy",
    "check_task",
    "example_dataset",
    "example_systems",
    "run_checks",
    "run_controller_checks",
    "run_reader_checks",
    "run_strategy_checks",
    "run_task_checks",
]
