"""Conditions of recordings: named by patterns, kept when cut and stored, left out whole."""

from dataclasses import replace

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from sysid_evo import ConditionFold, Dataset
from sysid_evo.cli.recordings import patterns_of
from sysid_evo.data import prepare
from sysid_evo.errors import InvalidArgument, InvalidData, ShapeError
from sysid_evo.testing import example_dataset


@pytest.fixture
def days():
    """Four drives on two floors and one elsewhere."""
    plain = example_dataset(episodes=5, steps=30)
    names = ["rain_1", "sun_1", "rain_2", "sun_2", "hall"]
    return Dataset.from_arrays(plain.system, [e.states for e in plain], [e.controls for e in plain], names=names)


def test_patterns_name_the_conditions_of_recordings_and_of_their_parts(days):
    known = days.with_episodes([days.episodes[0][0:10], *days.episodes[1:]]).label_conditions(
        {"wet": "rain_*", "dry": "sun*"}
    )
    assert [episode.condition for episode in known] == ["wet", "dry", "wet", "dry", ""]
    assert known.conditions == ("wet", "dry", "")
    assert known.of_condition("wet", "").names == ("rain_1[0:10]", "rain_2", "hall")
    assert known.split(0.5)[0].conditions == known.conditions


def test_a_stored_data_set_keeps_its_conditions_and_its_fingerprint(days, tmp_path):
    known = days.label_conditions({"wet": "rain_*"})
    loaded = Dataset.load(known.save(tmp_path / "data"))
    assert [episode.condition for episode in loaded] == ["wet", "", "wet", "", ""]
    assert loaded.fingerprint == days.fingerprint


def test_every_condition_is_left_out_once_and_whole(days):
    known = days.label_conditions({"wet": "rain_*", "dry": "sun_*"})
    folds = [(learned.tolist(), held.tolist()) for learned, held in ConditionFold().split(known)]
    assert folds == [([1, 3, 4], [0, 2]), ([0, 2, 4], [1, 3]), ([0, 1, 2, 3], [4])]
    assert ConditionFold().get_n_splits(known) == 3
    with pytest.raises(InvalidData, match="expected recordings of two or more conditions, got 1"):
        list(ConditionFold().split(days))


def test_a_pattern_that_fits_nothing_or_what_another_fits_is_refused(days):
    with pytest.raises(InvalidArgument, match=r"no episode matches 'snow\*'"):
        days.label_conditions({"white": "snow*"})
    with pytest.raises(InvalidArgument, match="'rain_1' also matches the pattern of 'wet'"):
        days.label_conditions({"wet": "rain_*", "first": "*_1"})
    with pytest.raises(InvalidArgument, match="there are ''"):
        days.of_condition("wet")
    assert patterns_of(["wet=rain_*"]) == {"wet": "rain_*"}
    with pytest.raises(InvalidArgument, match="--condition: expected NAME=PATTERN"):
        patterns_of(["wet"])


FLOORS = np.array(["tiles"] * 80 + ["carpet"] * 120 + [""])


@pytest.mark.parametrize("kind", ["csv", "parquet"])
def test_a_column_names_the_condition_of_each_row_and_splits_the_log_where_it_changes(
    kind, table, write_csv, columns_file, tmp_path
):
    named = {**table, "floor": FLOORS}
    path = tmp_path / "log.parquet"
    if kind == "parquet":
        pq.write_table(pa.table(named), path)
    else:
        path = write_csv(named)
        path.write_text(path.read_text().replace("'", ""))
    data = Dataset.read(path, columns=columns_file(), condition_column="floor")
    assert {e.name: (e.condition, len(e)) for e in data} == {
        "log[0:79]": ("tiles", 79),
        "log[80:199]": ("carpet", 119),
    }
    assert any("0 steps outside 25 to 75 ms and 2 changes of condition split it into 2 parts" in n for n in data.notes)
    np.testing.assert_array_equal(data.episodes[1].states[:, 0], table["u"][80:200])
    by_map = columns_file(('name = "test car"', 'name = "test car"\ncondition = "floor"'), name="floors.toml")
    assert Dataset.read(path, columns=by_map).conditions == ("tiles", "carpet")


def test_numbers_name_conditions_too_and_a_missing_column_is_named(table, write_csv, columns_file, tmp_path):
    path = tmp_path / "log.parquet"
    pq.write_table(pa.table({**table, "day": np.repeat([1.0, 2.0], [100, 101])}), path)
    data = Dataset.read(path, columns=columns_file(), condition_column="day")
    assert data.conditions == ("1", "2")
    with pytest.raises(InvalidData, match=r"log\.csv, row 1: column 'floor' is missing"):
        Dataset.read(write_csv(table), columns=columns_file(), condition_column="floor")
    stored = data.save(tmp_path / "data")
    with pytest.raises(InvalidArgument, match="name its conditions when the logs are imported"):
        Dataset.read(stored, condition_column="day")


def test_a_fast_log_is_filtered_within_each_condition_alone(make_drive):
    drive = make_drive()
    log = drive.log()
    floors = np.where(log.time < 3.0, "tiles", "carpet")
    system = example_dataset().system
    known = prepare(replace(log, condition=floors), system)
    assert [episode.condition for episode in known.episodes] == ["tiles", "carpet"]
    assert any("split at 1 changes of condition" in note for note in known.notes)
    alone = prepare(log, system).episodes[0]
    assert known.episodes[0].duration + known.episodes[1].duration < alone.duration
    with pytest.raises(ShapeError, match=r"condition of 'drive': expected shape \(1201,\), got \(3,\)"):
        replace(log, condition=floors[:3])
