"""Fitting several families to one data set, each a cell of a run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from sysid_evo.data import Dataset
from sysid_evo.dynamics import DynamicsModel
from sysid_evo.experiment.cells import Observer, Outcome, cell_seed, run_cell
from sysid_evo.progress import Progress
from sysid_evo.registry import models
from sysid_evo.store import RunFolder, load_model, save_model


def make_with_preset(family: str, preset: str, parameters: Mapping[str, Any] | None = None) -> DynamicsModel:
    """Return an unfitted model: its defaults, then what ``preset`` changes, then ``parameters``."""
    factory: Any = models.get(family)
    model: DynamicsModel = factory(**{**factory.presets.get(preset, {}), **(parameters or {})})
    return model


def fit_models(
    run: RunFolder,
    families: Sequence[str],
    dataset: Dataset,
    *,
    seed: int,
    preset: str,
    observer: Observer,
    parameters: Mapping[str, Mapping[str, Any]] | None = None,
) -> dict[str, Outcome[DynamicsModel]]:
    """Fit every family to all of ``dataset``, store the models in ``run``, return them by family."""
    chosen = parameters or {}
    return {
        family: _fit(run, family, dataset, seed=seed, preset=preset, observer=observer, parameters=chosen.get(family))
        for family in families
    }


def _fit(
    run: RunFolder,
    family: str,
    dataset: Dataset,
    *,
    seed: int,
    preset: str,
    observer: Observer,
    parameters: Mapping[str, Any] | None,
) -> Outcome[DynamicsModel]:
    path, cell = run.model(family, seed), f"fit {family}"

    def work(progress: Progress) -> DynamicsModel:
        model = make_with_preset(family, preset, parameters)
        return model.fit(dataset, rng=np.random.default_rng(cell_seed(seed, cell)), progress=progress)

    return run_cell(
        run,
        cell,
        load=lambda: load_model(path),
        work=work,
        save=lambda model: save_model(model, path, seed=seed, data=dataset.fingerprint),
        observer=observer,
    )
