"""How far a prediction may be off: on recordings that were never seen."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Self

import numpy as np
import pytest

from sysid_evo.data import Dataset
from sysid_evo.models import DynamicsModel
from sysid_evo.system import Channel, System
from sysid_evo.types import Array
from sysid_evo.validation.folds import unseen_parts, unseen_recordings
from sysid_evo.validation.intervals import (
    conformal_scale,
    growth_on_unseen_recordings,
    normalised_errors,
    rough_fits,
    with_noise,
)
from tests.benchmarks.coverage import coverage

pytestmark = pytest.mark.filterwarnings("ignore::sysid_evo.errors.DataWarning")  # the recordings stand still

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


def test_the_growth_is_the_geometric_mean_over_unseen_recordings_and_at_least_one() -> None:
    """Errors on the three are two, three and nine times those on blocks of what was seen."""
    dataset = resting(["a[0:240]", "b", "c"])
    np.testing.assert_allclose(growth_on_unseen_recordings(roughly, dataset), [54.0 ** (1 / 3), 1.0])
    assert rough_fits(dataset) == 5


def test_a_recording_alone_cannot_be_held_out() -> None:
    dataset = resting(["a[0:240]", "a[240:480]"])
    assert rough_fits(dataset) == 0
    np.testing.assert_array_equal(growth_on_unseen_recordings(roughly, dataset), [1.0, 1.0])
    assert len(unseen_parts(dataset)) == 3
    short = dataset.with_episodes([dataset.episodes[0][:40]])
    assert len(unseen_parts(short)) == 1, "where nothing can be held out, the same fit is not made three times"
    assert unseen_parts(short)[0][1] is short


@pytest.mark.parametrize("count", [2, 4, 11])
def test_every_recording_is_held_out_once_in_at_most_four_groups(count: int) -> None:
    parts = unseen_recordings(resting([f"log-{i}" for i in range(count)]))
    assert len(parts) == min(4, count)
    assert sorted(name for _, held in parts for name in held.names) == sorted(f"log-{i}" for i in range(count))
    assert all(not set(seen.names) & set(held.names) for seen, held in parts)


class Noisy(DynamicsModel):
    """A damped walk whose noise it underestimates; y pulls x along, so that the two scales depend on each other."""

    envelope = None

    def __init__(self, *, stochastic: bool = False) -> None:
        self.stochastic = stochastic

    @property
    def n_noise(self) -> int:
        return 2 if self.stochastic else 0

    def fit(self, dataset: Dataset, *, rng: np.random.Generator, progress: Any = None) -> Self:
        self.noise_scale_ = np.ones(2)
        return self

    def step(self, carry: Array, control: Array, noise: Array | None = None) -> Array:
        after = 0.9 * carry + 0.1 * carry[:, ::-1] * np.array([1.0, 0.0])
        return after if noise is None else after + 0.01 * self.noise_scale_ * noise


def test_the_scale_that_made_the_data_is_found_and_holds_nine_in_ten() -> None:
    """Two channels, one with three times and one with half the noise that the model believes in."""
    truth = np.array([3.0, 0.5])
    model = Noisy().fit(resting(["a"]), rng=np.random.default_rng(0))
    cut = resting([f"log-{i}" for i in range(60)]).windows(20, stride=20)
    generator = with_noise(model)
    generator.noise_scale_ = truth  # type: ignore[attr-defined]

    def lived(seed: int) -> Any:
        rng = np.random.default_rng(seed)
        return replace(cut, states=generator.simulate(cut.past_states, cut.past_controls, cut.controls, rng=rng))

    scale = conformal_scale([(model, lived(1)), (model, lived(2))], np.random.default_rng(5))
    np.testing.assert_allclose(scale, truth, rtol=0.2)
    noisy, fresh = with_noise(model), lived(3)
    noisy.noise_scale_ = scale  # type: ignore[attr-defined]
    drawn = noisy.simulate(fresh.past_states, fresh.past_controls, fresh.controls, samples=40)
    assert (np.abs(coverage(drawn[:, :, -1], fresh.states[:, -1]) - 0.9) < 0.07).all()
    assert not model.stochastic


def test_a_truth_on_the_edge_of_its_interval_has_a_normalised_error_of_one() -> None:
    """Of 99 equally spaced samples, 0.01 to 0.99, the central 90 % reach from 0.05 to 0.95."""
    samples = np.tile(np.arange(1, 100)[:, None, None] / 100.0, (1, 4, 1))
    truth = np.array([[0.05], [0.95], [0.5], [1.4]])
    np.testing.assert_allclose(normalised_errors(samples, truth)[:, 0], [1.0, 1.0, 0.0, 2.0], atol=1e-12)
    np.testing.assert_allclose(coverage(samples, np.array([[0.04], [0.06], [0.94], [0.96]])), [0.5])
