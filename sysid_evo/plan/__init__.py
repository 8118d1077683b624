"""Work as cells: what each needs, what its result depends on, and who computes it."""

from sysid_evo.plan.again import Again
from sysid_evo.plan.cell import CONTRACT, Cell, Work
from sysid_evo.plan.execution import execute
from sysid_evo.plan.jobs import number_of_jobs
from sysid_evo.plan.ledger import Observer, Silent
from sysid_evo.plan.plan import Plan
from sysid_evo.plan.scheduler import Scheduler
from sysid_evo.plan.seeds import cell_seed
from sysid_evo.plan.store import CHECKPOINT, Outcome, Record, Store, StoredCell, blocked_by

__all__ = [
    "Again",
    "CHECKPOINT",
    "CONTRACT",
    "Cell",
    "Observer",
    "Outcome",
    "Plan",
    "Record",
    "Scheduler",
    "Silent",
    "Store",
    "StoredCell",
    "Work",
    "blocked_by",
    "cell_seed",
    "execute",
    "number_of_jobs",
]
