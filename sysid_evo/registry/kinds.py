"""The registries: one for every kind of thing that can be added by one file and one line."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

from sysid_evo.registry.registry import Registry
from sysid_evo.registry.spec import Spec

if TYPE_CHECKING:
    from sysid_evo.controllers.controller import Controller
    from sysid_evo.dynamics import DynamicsModel
    from sysid_evo.evolution.aggregates import Aggregate
    from sysid_evo.evolution.strategy import EvolutionStrategy
    from sysid_evo.motion import Motion
    from sysid_evo.tasks.task import Task


class AggregateRegistry(Registry[Any]):
    """Functions of the fitness (models, candidates, trials); their further arguments are the parameters of a spec."""

    def make(self, spec: str | Spec, /, **parameters: Any) -> Aggregate:
        """Return the function that ``spec`` names, with its parameters. Raises what it does with their values."""
        import numpy as np

        found = self.check(spec, **parameters)
        aggregate = partial(self.get(found.name), **found.parameters)
        aggregate(np.zeros((1, 1, 1)))  # a wrong value is found before anything is run
        return aggregate


models: Registry[DynamicsModel] = Registry("model", "sysid_evo.models")
tasks: Registry[Task] = Registry("task", "sysid_evo.tasks")
controllers: Registry[Controller] = Registry("controller", "sysid_evo.controllers")
strategies: Registry[EvolutionStrategy] = Registry(
    "strategy", "sysid_evo.strategies", given=frozenset({"n_parameters", "seed"})
)
aggregates = AggregateRegistry("aggregate", "sysid_evo.aggregates", given=frozenset({"fitness"}))
robots: Registry[Any] = Registry("robot", "sysid_evo.robots")
trackers: Registry[Any] = Registry("tracker", "sysid_evo.trackers")
readers: Registry[Any] = Registry("reader", "sysid_evo.readers")
probes: Registry[Any] = Registry("probe", "sysid_evo.probes")
motions: Registry[Motion] = Registry("motion", "sysid_evo.motions")

KINDS: dict[str, Registry[Any]] = {
    registry.kind: registry
    for registry in (
        models, tasks, controllers, strategies, aggregates, robots, trackers, readers, probes, motions,
    )
}  # fmt: skip

register_model = models.register
register_task = tasks.register
register_controller = controllers.register
register_strategy = strategies.register
register_aggregate = aggregates.register
register_robot = robots.register
register_tracker = trackers.register
register_reader = readers.register
register_probe = probes.register
register_motion = motions.register

make_model = models.make
make_task = tasks.make
make_controller = controllers.make
make_strategy = strategies.make
make_aggregate = aggregates.make
