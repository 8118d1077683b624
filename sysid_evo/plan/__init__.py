"""Work as cells: what each needs, what its result depends on, and who computes it."""

from sysid_evo.plan.cell import CONTRACT, Cell, Work
from sysid_evo.plan.execution import Observer, Silent, execute
from sysid_evo.plan.plan import Plan
from sysid_evo.plan.seeds import cell_seed
from sysid_evo.plan.store import CHECKPOINT, Outcome, Record, Store, StoredCell, blocked_by

__all__ = [
    "CHECKPOINT",
    "CONTRACT",
    "Cell",
    "Observer",
    "Outcome",
    "Plan",
    "Record",
    "Silent",
    "Store",
    "StoredCell",
    "Work",
    "blocked_by",
    "cell_seed",
    "execute",
]
