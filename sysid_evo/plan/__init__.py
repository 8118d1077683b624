"""Work as cells: what each needs, what its result depends on, and who computes it."""

from sysid_evo.plan.cell import CONTRACT, Cell, Work
from sysid_evo.plan.dask_executor import Scheduler
from sysid_evo.plan.executors import execute, number_of_jobs
from sysid_evo.plan.plan import Again, Plan, cell_seed
from sysid_evo.plan.run_state import Observer
from sysid_evo.plan.store import CHECKPOINT, Outcome, Record, Store, StoredCell, blocked_by

__all__ = [
    "CHECKPOINT",
    "CONTRACT",
    "Again",
    "Cell",
    "Observer",
    "Outcome",
    "Plan",
    "Record",
    "Scheduler",
    "Store",
    "StoredCell",
    "Work",
    "blocked_by",
    "cell_seed",
    "execute",
    "number_of_jobs",
]
