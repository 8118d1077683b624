"""What `DynamicsModel.adapt` does: the same robot elsewhere, and a model made for it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from sysid_evo.data import Dataset
from sysid_evo.dynamics.model import DynamicsModel
from sysid_evo.errors import IncompatibleSystem
from sysid_evo.progress import Progress
from sysid_evo.registry import models
from sysid_evo.system import System


def adapted(
    model: DynamicsModel,
    dataset: Dataset,
    *,
    training: Dataset | None = None,
    rng: np.random.Generator | int | None = None,
    progress: Progress | bool | None = None,
) -> DynamicsModel:
    """Return a model of the family ``adapted`` around ``model``, see `DynamicsModel.adapt`."""
    system = model.system
    old = None if training is None else as_of(system, training)
    family: Any = models.get("adapted")
    found: DynamicsModel = family(base=None).given(model, old).fit(as_of(system, dataset), rng=rng, progress=progress)
    return found


def as_of(system: System, dataset: Dataset) -> Dataset:
    """Return ``dataset`` as a recording of ``system``, whose limits of continuous channels it need not share.

    Raises `IncompatibleSystem` if channels, dt or motion are others.
    """
    if dataset.system == system:
        return dataset
    other = dataset.system
    same = len(other.controls) == len(system.controls) and len(other.states) == len(system.states)
    differences = other.differences(system)
    if same:
        controls = tuple(
            replace(theirs, low=own.low, high=own.high, neutral=own.neutral) if theirs.levels is None else theirs
            for own, theirs in zip(system.controls, other.controls, strict=True)
        )
        differences = system.differences(replace(other, controls=controls))
    if differences:
        raise IncompatibleSystem(f"adapt: the data are of another system: {'; '.join(differences)}")
    return Dataset(system, dataset.episodes, dataset.notes)
