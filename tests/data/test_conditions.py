"""Conditions of recordings: named by patterns, kept when cut and stored, left out whole."""

from __future__ import annotations

from pathlib import Path

import pytest

from sysid_evo import ConditionFold, Dataset
from sysid_evo.data.conditions import parsed
from sysid_evo.errors import InvalidArgument, InvalidData
from sysid_evo.testing import example_dataset


@pytest.fixture
def days() -> Dataset:
    """Four drives on two floors and one elsewhere."""
    plain = example_dataset(episodes=5, steps=30)
    names = ["rain_1", "sun_1", "rain_2", "sun_2", "hall"]
    return Dataset.from_arrays(plain.system, [e.states for e in plain], [e.controls for e in plain], names=names)


def test_patterns_name_the_conditions_of_recordings_and_of_their_pieces(days: Dataset) -> None:
    known = days.with_episodes([days.episodes[0][0:10], *days.episodes[1:]]).labelled({"wet": "rain_*", "dry": "sun*"})
    assert [episode.condition for episode in known] == ["wet", "dry", "wet", "dry", ""]
    assert known.conditions == ("wet", "dry", "")
    assert known.of_condition("wet", "").names == ("rain_1[0:10]", "rain_2", "hall")
    assert known.split(0.5)[0].conditions == known.conditions


def test_a_stored_data_set_keeps_its_conditions_and_its_fingerprint(days: Dataset, tmp_path: Path) -> None:
    known = days.labelled({"wet": "rain_*"})
    loaded = Dataset.load(known.save(tmp_path / "data"))
    assert [episode.condition for episode in loaded] == ["wet", "", "wet", "", ""]
    assert loaded.fingerprint == days.fingerprint


def test_every_condition_is_left_out_once_and_whole(days: Dataset) -> None:
    known = days.labelled({"wet": "rain_*", "dry": "sun_*"})
    folds = [(learned.tolist(), held.tolist()) for learned, held in ConditionFold().split(known)]
    assert folds == [([1, 3, 4], [0, 2]), ([0, 2, 4], [1, 3]), ([0, 1, 2, 3], [4])]
    assert ConditionFold().get_n_splits(known) == 3
    with pytest.raises(InvalidData, match="expected recordings of two or more conditions, got 1"):
        list(ConditionFold().split(days))


def test_a_pattern_that_fits_nothing_or_what_another_fits_is_refused(days: Dataset) -> None:
    with pytest.raises(InvalidArgument, match=r"no episode fits 'snow\*'"):
        days.labelled({"white": "snow*"})
    with pytest.raises(InvalidArgument, match="'rain_1' fits the pattern of 'wet' as well"):
        days.labelled({"wet": "rain_*", "first": "*_1"})
    with pytest.raises(InvalidArgument, match="there are ''"):
        days.of_condition("wet")
    assert parsed("--condition", ["wet=rain_*"]) == {"wet": "rain_*"}
    with pytest.raises(InvalidArgument, match="--condition: expected NAME=PATTERN"):
        parsed("--condition", ["wet"])
