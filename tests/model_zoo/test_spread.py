"""How far a prediction may be off: on recordings that were never seen."""

from __future__ import annotations

from typing import Any, Self

import numpy as np
import pytest

from model_zoo.spread import growth_on_unseen_recordings, rough_fits, unseen_recordings, weighted_median
from sysid_evo.arrays import Array
from sysid_evo.data import Dataset
from sysid_evo.dynamics import DynamicsModel
from sysid_evo.system import Channel, System

SYSTEM = System((Channel("x"), Channel("y")), (Channel("u", low=-1.0, high=1.0),), dt=0.05)
UNSEEN = {"a": 0.2, "b": 0.3, "c": 0.9}


class Biased(DynamicsModel):
    """Drifts by a known amount in every step; x by the bias of the recordings it never saw, y always alike."""

    envelope = None  # all states are zero: nothing to clip to

    def fit(self, dataset: Dataset, *, rng: np.random.Generator, progress: Any = None) -> Self:
        seen = {name.split("[")[0] for name in dataset.names}
        self.bias_ = np.array([max((UNSEEN[name] for name in UNSEEN if name not in seen), default=0.1), 0.1])
        return self

    def next_state(self, carry: Array, control: Array) -> Array:
        return carry + self.bias_


def resting(names: list[str]) -> Dataset:
    return Dataset.from_arrays(
        SYSTEM, [np.zeros((241, 2))] * len(names), [np.zeros((240, 1))] * len(names), names=names
    )


def roughly(part: Dataset) -> DynamicsModel:
    return Biased().fit(part, rng=np.random.default_rng(0))


def test_the_growth_is_the_median_over_unseen_recordings_and_at_least_one() -> None:
    dataset = resting(["a[0:240]", "b", "c"])
    np.testing.assert_allclose(growth_on_unseen_recordings(roughly, dataset), [3.0, 1.0])
    assert rough_fits(dataset) == 5


def test_a_long_recording_weighs_more_than_a_short_one() -> None:
    dataset = resting(["a[0:240]", "b", "c", "a[240:480]", "a[480:720]"])
    np.testing.assert_allclose(growth_on_unseen_recordings(roughly, dataset), [2.0, 1.0])
    values, weights = np.array([[3.0, 1.0], [1.0, 2.0], [2.0, 3.0]]), np.array([1.0, 1.0, 5.0])
    np.testing.assert_array_equal(weighted_median(values, weights), [2.0, 3.0])
    np.testing.assert_array_equal(weighted_median(values, np.ones(3)), [2.0, 2.0])


def test_a_recording_alone_cannot_be_held_out() -> None:
    dataset = resting(["a[0:240]", "a[240:480]"])
    assert rough_fits(dataset) == 0
    np.testing.assert_array_equal(growth_on_unseen_recordings(roughly, dataset), [1.0, 1.0])


@pytest.mark.parametrize("count", [2, 4, 11])
def test_every_recording_is_held_out_once_in_at_most_four_groups(count: int) -> None:
    groups = unseen_recordings(resting([f"log-{i}" for i in range(count)]))
    assert len(groups) == min(4, count)
    assert sorted(name for group in groups for name in group) == sorted(f"log-{i}" for i in range(count))
