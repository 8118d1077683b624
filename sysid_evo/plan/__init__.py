"""Work as cells: their inputs, their results in a store, and the executors that compute them."""

from sysid_evo.plan.cell import CELL_KINDS, CONTRACT, Cell, CellContext, CellKind, CellSettings, ResultType
from sysid_evo.plan.dask_executor import Scheduler
from sysid_evo.plan.executors import execute, number_of_jobs
from sysid_evo.plan.plan import Plan, cell_seed
from sysid_evo.plan.run_cell import Observer
from sysid_evo.plan.store import CHECKPOINT, CellOutcome, CellRecord, Store, blocked_reason, stored

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
