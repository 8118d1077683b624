from .cell import CELL_KINDS, CONTRACT, Cell, CellContext, CellKind, CellSettings, Observer, ResultType
from .dask_executor import Scheduler
from .executors import execute, number_of_jobs
from .plan import Plan, cell_seed
from .store import CHECKPOINT, CellOutcome, CellRecord, Store, blocked_reason, stored

__all__ = [
    "CELL_KINDS",
    "CHECKPOINT",
    "CONTRACT",
    "Cell",
    "CellContext",
    "CellKind",
    "CellOutcome",
    "CellRecord",
    "CellSettings",
    "Observer",
    "Plan",
    "ResultType",
    "Scheduler",
    "Store",
    "blocked_reason",
    "cell_seed",
    "execute",
    "number_of_jobs",
    "stored",
]
