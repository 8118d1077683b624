"""Budgets by name: how long a run may think."""

from __future__ import annotations

from sysid_evo.errors import UnknownName
from sysid_evo.evolution import ControllerEvolution

CONTROLLER_PRESETS: dict[str, ControllerEvolution] = {
    "quick": ControllerEvolution(generations=150, trials=10, runs=1),
    "standard": ControllerEvolution(generations=300, trials=10, runs=3),
    "paper": ControllerEvolution(generations=300, trials=10, runs=2),
}
"""Families state their own budgets as `DynamicsModel.presets`."""


def controller_preset(name: str) -> ControllerEvolution:
    """Return the budget ``name`` of controller evolution. Raises `UnknownName`."""
    if name not in CONTROLLER_PRESETS:
        raise UnknownName(f"no preset is called {name!r}; there are {', '.join(CONTROLLER_PRESETS)}")
    return CONTROLLER_PRESETS[name]
