"""Data sets as tables of pandas."""

import numpy as np
import pandas as pd
import pytest

from sysid_evo.data import Dataset, Trajectory
from sysid_evo.errors import InvalidData
from sysid_evo.system import Channel, System

LINE = System((Channel("place", "m"), "speed"), (Channel("push", "N"),), 0.1, name="line")


def two_runs():
    rng = np.random.default_rng(3)
    lengths = {"long": 5, "short": 2}
    return Dataset(
        LINE,
        [
            Trajectory(rng.normal(size=(n + 1, 2)), rng.normal(size=(n, 1)), 0.1, None, name, condition=name[0])
            for name, n in lengths.items()
        ],
    )


def test_a_table_holds_every_sample_with_its_time_and_becomes_the_same_data_set_again():
    data = two_runs()
    frame = data.to_pandas()
    assert list(frame) == ["episode", "time", "place", "speed", "push"]
    assert list(frame["episode"]) == ["long"] * 6 + ["short"] * 3
    np.testing.assert_allclose(frame["time"], [0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.0, 0.1, 0.2])
    assert np.flatnonzero(frame["push"].isna()).tolist() == [5, 8]
    again = Dataset.from_pandas(LINE, frame, episode="episode")
    assert again.fingerprint == data.fingerprint


UNEVEN = [0.0, 0.1, 0.2, 0.4, 0.5]
DAY = pd.Timestamp("2026-03-01")


@pytest.mark.parametrize(
    "timed",
    [
        lambda frame: frame.assign(time=UNEVEN),
        lambda frame: frame.assign(time=[DAY + pd.Timedelta(seconds=one) for one in UNEVEN]),
        lambda frame: frame.assign(time=[DAY.tz_localize("UTC") + pd.Timedelta(seconds=one) for one in UNEVEN]),
        lambda frame: frame.set_index(pd.to_timedelta(UNEVEN, unit="s")),
        lambda frame: frame.set_index(pd.DatetimeIndex([DAY + pd.Timedelta(seconds=one) for one in UNEVEN])),
    ],
)
def test_a_table_whose_times_contradict_dt_is_refused(timed):
    frame = pd.DataFrame({"place": np.arange(5.0), "speed": 0.0, "push": 0.0})
    said = r"episode 'episode-0' has 1 of 4 steps that are not dt = 0\.1 s long, the first after row 2, 0\.2 s"
    with pytest.raises(InvalidData, match=said):
        Dataset.from_pandas(LINE, timed(frame))


def test_a_table_whose_times_are_nearly_even_or_no_times_is_taken():
    frame = pd.DataFrame({"place": np.arange(4.0), "speed": 0.0, "push": 0.0})
    for times in ([0.0, 0.1, 0.204, 0.3], ["first", "second", "third", "last"]):
        assert len(Dataset.from_pandas(LINE, frame.assign(time=times)).episodes[0]) == 3
    with pytest.raises(InvalidData, match="2 of 3 steps that are not dt"):
        Dataset.from_pandas(LINE, frame.assign(time=[0.0, 0.1, 0.206, 0.3]))
    clock = System(("time",), (), 0.1)
    assert Dataset.from_pandas(clock, pd.DataFrame({"time": [3.0, 7.0, 1.0]})).episodes[0].states[1, 0] == 7.0


def test_the_pose_goes_into_the_table_and_comes_back(car, rng):
    episode = Trajectory(
        rng.normal(size=(4, 3)), rng.integers(-1, 2, (3, 2)).astype(float), car.dt, rng.normal(size=(4, 3)), "a"
    )
    data = Dataset(car, [episode])
    frame = data.to_pandas()
    assert list(frame)[-3:] == ["x", "y", "heading"]
    assert Dataset.from_pandas(car, frame, episode="episode").fingerprint == data.fingerprint
    without = Dataset(car, [Trajectory(episode.states, episode.controls, car.dt, None, "a")]).to_pandas()
    assert without[["x", "y", "heading"]].isna().all(axis=None)


def test_a_channel_named_like_another_column_is_refused():
    data = Dataset.from_arrays(System(("time",), (), 0.1), np.arange(4.0))
    with pytest.raises(InvalidData, match=r"the channels time cannot become columns.*rename the channels"):
        data.to_pandas()
