from .closed_loop import CONTROLLER, TASK, check_controller, check_task
from .contract import CheckResult, Contract
from .evolution import STRATEGY, check_strategy
from .examples import ExampleDynamics, example_dataset, example_systems
from .models import ADAPTER, MODEL, check_adapter, check_model
from .readers import READER, check_reader

__all__ = [
    "ADAPTER",
    "CONTROLLER",
    "MODEL",
    "READER",
    "STRATEGY",
    "TASK",
    "CheckResult",
    "Contract",
    "ExampleDynamics",
    "check_adapter",
    "check_controller",
    "check_model",
    "check_reader",
    "check_strategy",
    "check_task",
    "example_dataset",
    "example_systems",
]
