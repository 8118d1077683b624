"""A way to adapt that one block shows to be no good is given up, unless its mean with a correction still may be."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
import pytest

from sysid_evo.data import Dataset
from sysid_evo.models import DynamicsModel
from sysid_evo.models.adaptation.selection import FURTHER
from sysid_evo.models.base import make_model
from sysid_evo.validation.acceptance import AND
from tests.fixtures.systems import FloorCar, drive


def polynomial(thrust: float) -> DynamicsModel:
    data = drive(FloorCar(thrust=thrust), seconds=30.0, seed=1)
    return make_model("narx", degree=2, terms=8, state_lags=0, control_lags=0).fit(data, rng=np.random.default_rng(0))


@pytest.mark.parametrize(
    ("thrust", "blocks", "of_way", "of_mean"),
    [
        (5.0, 1, False, False),  # the wrong way: neither it nor the mean is better in the first block
        (0.5, 3, False, True),  # too far: farther off than the model was, but the mean is in the middle
        (1.6, 3, True, True),
    ],
)
def test_a_way_is_given_up_after_a_block_in_which_neither_it_nor_its_mean_is_better(
    thrust: float, blocks: int, of_way: bool, of_mean: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    model, further, called = polynomial(3.0), polynomial(thrust), Counter[int]()

    def trained_further(self: Any, dataset: Dataset, updates: int, *, rng: Any) -> DynamicsModel:
        called[updates] += 1
        return further

    monkeypatch.setattr(type(model), "trained_further", trained_further)
    adapted: Any = model.adapt(drive(FloorCar(thrust=1.7), seconds=12.0, seed=3, noise=0.0), rng=0)
    shown = dict(zip(adapted.tried_, adapted.gate_, strict=True))
    for way in FURTHER:
        (mean,) = [name for name in shown if name.endswith(AND + way)]
        for name, better in ((way, of_way), (mean, of_mean)):
            assert len(shown[name]) == 1 + blocks
            assert (max(shown[name][1:]) < 0.95) == better, shown[name]
    chosen = [updates for way, updates in zip(FURTHER, called, strict=True) if way in adapted.chosen_]
    assert {updates: count - (updates in chosen) for updates, count in called.items()} == dict.fromkeys(called, blocks)
