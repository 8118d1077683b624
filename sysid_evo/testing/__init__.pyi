from .closed_loop import check_controller, check_task, run_controller_checks, run_task_checks
from .contract import CheckResult
from .evolution import check_strategy, run_strategy_checks
from .examples import ExampleDynamics, example_dataset, example_systems
from .kits import KITS
from .models import CHECKS, check_model, run_checks
from .readers import check_reader, run_reader_checks

__all__ = [
    "CHECKS",
    "KITS",
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
