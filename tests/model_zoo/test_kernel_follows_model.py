"""The compiled form of a model is that of its present parameters, whatever was asked before."""

from __future__ import annotations

import numpy as np
import pytest

from sysid_evo.data import Dataset
from sysid_evo.engine.compiled.open_loop import kernel_step
from sysid_evo.models import DynamicsModel
from sysid_evo.models.base import make_model
from sysid_evo.testing import example_dataset

FAMILIES = ("nearest_neighbour", "k_neighbours", "linear")


def fitted(family: str, dataset: Dataset) -> DynamicsModel:
    model: DynamicsModel = make_model(family)
    return model.fit(dataset, rng=np.random.default_rng(0))


def agrees(model: DynamicsModel, dataset: Dataset) -> bool:
    """Whether kernel and NumPy step give the same next states from recorded ones, at rest and moving."""
    state_lags, control_lags = model.lags
    some = dataset.transitions(state_lags=state_lags, control_lags=control_lags)
    carry, control = some.carry[:40].copy(), some.control[:40]
    carry[:5], control[:5] = 0.0, 0.0
    carry[:5, :3] = 1e-3
    kernel = model.kernel()
    assert kernel is not None
    compiled = kernel_step(kernel, carry, control, precision="float64")
    return bool(np.allclose(compiled, model.step(carry, control), atol=1e-9))


@pytest.mark.parametrize("family", FAMILIES)
def test_after_set_params_the_kernel_is_made_anew(family: str, switched: Dataset) -> None:
    model = fitted(family, switched)
    assert agrees(model, switched)
    model.set_params(rest_hold=True)
    assert agrees(model, switched)


@pytest.mark.parametrize("family", FAMILIES)
def test_after_a_second_fit_the_kernel_is_made_anew(family: str, switched: Dataset) -> None:
    model = fitted(family, switched)
    assert agrees(model, switched)
    model.fit(example_dataset(seed=8, episodes=1), rng=np.random.default_rng(0))
    assert agrees(model, switched)


@pytest.mark.parametrize(("family", "precision"), [("linear", "float32"), ("k_neighbours", "float64")])
def test_a_kernel_asks_for_the_precision_that_its_family_needs(family: str, precision: str, switched: Dataset) -> None:
    kernel = fitted(family, switched).kernel()
    assert kernel is not None
    assert kernel.precision == precision
