"""The plane through neighbours among so many points that groups of buckets are asked first."""

from __future__ import annotations

import numpy as np
import pytest

from model_zoo import neighbours_kernel
from sysid_evo.data import Dataset
from tests.model_zoo.test_k_neighbours_kernel import compiled_step, fitted, queries


@pytest.mark.parametrize("neighbours", [1, 20])
def test_asking_groups_of_buckets_first_finds_the_same_neighbours(
    neighbours: int, proportional: Dataset, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(neighbours_kernel, "MANY", 1)
    model = fitted(proportional, neighbours)
    step = compiled_step(model)
    for away in (0.1, 0.5, 3.0, 100.0):
        carry, control = queries(model, rng, away)
        np.testing.assert_allclose(step(carry, control), model.step(carry, control), rtol=1e-9, atol=1e-9)


def test_a_query_that_is_not_a_number_ends(
    proportional: Dataset, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(neighbours_kernel, "MANY", 1)
    model = fitted(proportional, 20)
    carry, control = queries(model, rng, 0.1)
    expected = model.step(carry, control)
    carry[0], carry[1] = np.nan, 1e30
    np.testing.assert_allclose(compiled_step(model)(carry, control)[2:], expected[2:], rtol=1e-9, atol=1e-9)
