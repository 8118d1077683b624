"""What to record next: where a controller drives in its models, and the recording that they were fitted to is not."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from rich.padding import Padding
from rich.text import Text

from sysid_evo.cli.console import out

if TYPE_CHECKING:
    from evaluation.exploitability import Region
    from sysid_evo.data import Trajectory
    from sysid_evo.data.support import Support
    from sysid_evo.dynamics import Dynamics
    from sysid_evo.evolution import Champion

TRIALS = 10


def regions_of(
    champion: Champion, models: Mapping[str, Dynamics], support: Support | None = None
) -> tuple[Region, ...]:
    """Return where ``champion`` drives outside the data, in all of ``models`` that were fitted to some.

    Without ``support`` the data are those of the first model.
    """
    from evaluation.exploitability import what_to_record
    from evaluation.transfer import transfer_seeds
    from sysid_evo.data.support import Support, split_pairs
    from sysid_evo.dynamics import DynamicsModel
    from sysid_evo.engine import DynamicsRunner
    from sysid_evo.evolution import observed_late
    from sysid_evo.registry import make_controller, make_task

    fitted = {
        label: model
        for label, model in models.items()
        if isinstance(model, DynamicsModel) and getattr(model, "pairs_", None) is not None
    }
    if not fitted:
        return ()
    first = next(iter(fitted.values()))
    if support is None:
        support = Support.of(first.system, *split_pairs(first.system, first.pairs_))
    task, law, seeds = make_task(champion.task), make_controller(champion.controller), transfer_seeds(0, TRIALS)
    driven: list[Trajectory] = []
    for label, model in fitted.items():
        runner = observed_late(label, DynamicsRunner(model), champion.estimator_delay)
        driven += runner.run(law, champion.parameters[None], task, seeds, record=True).trajectories
    return what_to_record(support, driven)


def print_regions(name: str, regions: tuple[Region, ...]) -> None:
    """Print them, one a line; nothing if there are none."""
    if not regions:
        return
    out.print(f"what to record next: {name} drives most where there are no data", style="bold", highlight=False)
    for region in regions:
        out.print(Padding(Text(region.sentence), (0, 0, 0, 2)))


def inspected(controller: Path, support: Support) -> tuple[str, tuple[Region, ...]]:
    """Return the name of the controller in a file of a run, and where it drives outside the data in its models.

    Raises `InvalidArgument` if the models that it was evolved in are not in its run.
    """
    from sysid_evo.cli.achieving import owner_of
    from sysid_evo.cli.columns import dynamics_of, find_column
    from sysid_evo.errors import InvalidArgument
    from sysid_evo.plan import Store
    from sysid_evo.store import load_champion

    champion = load_champion(controller)
    champion.check_system(support.system)
    folder = owner_of(controller)
    if folder is None:
        raise InvalidArgument(
            f"--controller: expected a file in controllers/ of a run, which holds its models too, got {controller}"
        )
    store = Store(folder)
    models = {label: dynamics_of(store, find_column(store, label)) for label in champion.against}
    return champion.name, regions_of(champion, models, support)
