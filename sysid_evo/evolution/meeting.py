"""What candidates meet in evolution: models that are doubted, with noise, observed late."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

from sysid_evo.engine import DynamicsRunner, Runner
from sysid_evo.errors import InvalidArgument
from sysid_evo.wrappers import DelayedEstimate, Discounted, disturbed

if TYPE_CHECKING:
    from sysid_evo.evolution.controllers import ControllerEvolution


def met(runners: Mapping[str, Runner], settings: ControllerEvolution) -> dict[str, Runner]:
    """Return ``runners`` as candidates meet them by ``settings``.

    Raises `InvalidArgument` for what is no model, if something is to be added to it.
    """
    noise, caution, delay = settings.make_noise(), settings.make_caution(), settings.estimator_delay
    if noise is None and caution is None and delay == 0.0:
        return dict(runners)
    models = _models(runners)
    found: dict[str, Runner] = {}
    for label, runner in models.items():
        dynamics = runner.dynamics
        if caution is not None:
            dynamics = caution.about(dynamics, [other.dynamics for name, other in models.items() if name != label])
        if noise is not None:
            dynamics = disturbed(dynamics, noise, delay)
        elif delay:
            dynamics = DelayedEstimate(dynamics, delay)
        alone = replace(runner, dynamics=dynamics)
        found[label] = alone if caution is None else Discounted(alone, caution.most)
    return found


def _models(runners: Mapping[str, Runner]) -> dict[str, DynamicsRunner]:
    found = {label: runner for label, runner in runners.items() if isinstance(runner, DynamicsRunner)}
    others = [label for label in runners if label not in found]
    if others:
        raise InvalidArgument(
            f"evolution: {', '.join(others)} is not a model: noise, caution and late states can only be added to models"
        )
    return found
