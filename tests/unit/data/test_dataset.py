"""Data sets: stored and loaded, split, cut into windows."""

import json
import tracemalloc

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sysid_evo.data import Dataset, Trajectory
from sysid_evo.data.dataset import subsample
from sysid_evo.data.trajectory import moving_rows
from sysid_evo.errors import ArtefactError, InvalidArgument, InvalidData, ShapeError
from sysid_evo.motion import PlanarBody
from sysid_evo.system import Channel, System
from sysid_evo.validation.simulation_error import error_windows

LINE = System((Channel("place", "m"),), (Channel("push"),), 0.1)


def numbered(lengths, system=LINE):
    """A data set whose states are 1000 * episode + sample and whose controls are the same, negative."""
    samples = [1000.0 * i + np.arange(length + 1)[:, None] for i, length in enumerate(lengths)]
    return Dataset.from_arrays(system, samples, [-s for s in samples], names=[f"e{i}" for i in range(len(lengths))])


@pytest.fixture
def car_data(car, rng):
    episodes = [
        Trajectory(
            rng.normal(size=(n + 1, 3)),
            rng.integers(-1, 2, (n, 2)).astype(float),
            car.dt,
            rng.normal(size=(n + 1, 3)),
            name,
        )
        for n, name in ((7, "first"), (1, "second[3:4]"))
    ]
    return Dataset(
        car, (*episodes, Trajectory(np.zeros((3, 3)), np.zeros((2, 2)), car.dt, None, "no pose")), ("a note",)
    )


def test_saving_and_loading_gives_the_same_bits(car_data, tmp_path):
    loaded = Dataset.load(car_data.save(tmp_path / "data"))
    assert loaded.system == car_data.system
    assert loaded.notes == ("a note",)
    assert loaded.names == ("first", "second[3:4]", "no pose")
    for a, b in zip(loaded, car_data, strict=True):
        np.testing.assert_array_equal(a.states, b.states)
        np.testing.assert_array_equal(a.controls, b.controls)
        assert (a.pose is None) == (b.pose is None)
        if b.pose is not None:
            np.testing.assert_array_equal(a.pose, b.pose)
    assert loaded.fingerprint == car_data.fingerprint


def test_read_also_takes_a_stored_data_set_but_no_column_map_for_it(car_data, tmp_path):
    folder = car_data.save(tmp_path / "data")
    assert Dataset.read(folder).fingerprint == car_data.fingerprint
    with pytest.raises(InvalidArgument, match="needs no column map"):
        Dataset.read(folder, columns="dart_20hz")
    with pytest.raises(InvalidArgument, match="a stored data set already; it cannot be imported again or mixed"):
        Dataset.read([folder, folder])


def test_a_changed_sample_is_noticed(car_data, tmp_path):
    folder = car_data.save(tmp_path / "data")
    table = pq.read_table(folder / "samples.parquet")
    values = table["yaw_rate"].to_numpy().copy()
    values[2] += 1e-12
    place = table.column_names.index("yaw_rate")
    pq.write_table(table.set_column(place, "yaw_rate", [values]), folder / "samples.parquet")
    with pytest.raises(ArtefactError, match="do not match the fingerprint"):
        Dataset.load(folder)


@pytest.mark.parametrize(
    "change",
    [
        lambda header: header.update(schema="sysid-evo/dataset/99"),
        lambda header: header["episodes"][0].update(steps=6),
        lambda header: header["episodes"][0].update(name="renamed"),
        lambda header: header["system"].update(dt=0.1),
        lambda header: header.pop("notes"),
        lambda header: header["system"]["states"].pop(),
    ],
)
def test_a_changed_header_is_refused(car_data, tmp_path, change):
    folder = car_data.save(tmp_path / "data")
    header = json.loads((folder / "dataset.json").read_text())
    change(header)
    (folder / "dataset.json").write_text(json.dumps(header))
    with pytest.raises(ArtefactError):
        Dataset.load(folder)


@pytest.mark.parametrize("missing", ["dataset.json", "samples.parquet"])
def test_a_missing_or_damaged_file_is_refused(car_data, tmp_path, missing):
    folder = car_data.save(tmp_path / "data")
    (folder / missing).write_bytes((folder / missing).read_bytes()[:40])
    with pytest.raises(ArtefactError, match="not a readable data set"):
        Dataset.load(folder)
    (folder / missing).unlink()
    with pytest.raises(ArtefactError, match=missing):
        Dataset.load(folder)


def test_a_header_that_is_no_table_is_refused(car_data, tmp_path):
    folder = car_data.save(tmp_path / "data")
    (folder / "dataset.json").write_text("[1]")
    with pytest.raises(ArtefactError, match=r"expected names and values in dataset\.json, got a list"):
        Dataset.load(folder)


def test_a_stored_data_set_with_damaged_pages_or_too_many_rows_is_refused(car_data, tmp_path, monkeypatch):
    folder = car_data.save(tmp_path / "data")
    monkeypatch.setenv("SYSID_EVO_MOST_ROWS", "10")
    with pytest.raises(ArtefactError, match=r"not a readable data set: samples.parquet: declares \d+ rows"):
        Dataset.load(folder)
    monkeypatch.delenv("SYSID_EVO_MOST_ROWS")
    content = bytearray((folder / "samples.parquet").read_bytes())
    content[len(content) // 4 : len(content) // 2] = bytes(len(content) // 2 - len(content) // 4)
    (folder / "samples.parquet").write_bytes(content)
    with pytest.raises(ArtefactError, match=r"not a readable data set: samples.parquet"):
        Dataset.load(folder)


@given(
    lengths=st.lists(st.integers(1, 12), min_size=1, max_size=4),
    horizon=st.integers(1, 6),
    stride=st.integers(1, 4),
    history=st.integers(0, 4),
)
def test_windows_never_cross_an_episode_and_none_is_left_out(lengths, horizon, stride, history):
    windows = numbered(lengths).windows(horizon, stride=stride, history=history)
    expected = [
        (i, start) for i, length in enumerate(lengths) for start in range(history, length - horizon + 1, stride)
    ]
    assert list(zip(windows.episode.tolist(), windows.start.tolist(), strict=True)) == expected
    at = 1000.0 * windows.episode + windows.start
    np.testing.assert_array_equal(windows.past_states[..., 0], at[:, None] + np.arange(-history, 1))
    np.testing.assert_array_equal(windows.states[..., 0], at[:, None] + np.arange(1, horizon + 1))
    np.testing.assert_array_equal(windows.controls[..., 0], -(at[:, None] + np.arange(horizon)))
    np.testing.assert_array_equal(windows.past_controls[..., 0], -(at[:, None] + np.arange(-history, 0)))


def test_transitions_carry_states_and_controls_newest_first():
    steps = numbered([5, 3]).transitions(state_lags=1, control_lags=2)
    np.testing.assert_array_equal(
        steps.carry, [[2, 1, -1, -0.0], [3, 2, -2, -1], [4, 3, -3, -2], [1002, 1001, -1001, -1000]]
    )
    np.testing.assert_array_equal(steps.control[:, 0], [-2, -3, -4, -1002])
    np.testing.assert_array_equal(steps.after[:, 0], [3, 4, 5, 1003])


def test_a_standstill_is_half_a_second_less_its_margins():
    system = System(
        (Channel("forward_speed"), Channel("lateral_speed"), Channel("yaw_rate")), (Channel("u"),), 0.1, PlanarBody()
    )
    states = np.zeros((20, 3))
    states[:2, 0] = 1.0  # moving
    states[9, 2] = 0.2  # rows 2-8: seven slow rows, 0.7 s; turning at row 9
    states[14:, 1] = -0.06  # rows 10-13: slow for only 0.4 s; then sliding
    margin = 2  # 0.25 s
    expected = np.ones(20, dtype=bool)
    expected[2 + margin : 9 - margin] = False
    np.testing.assert_array_equal(moving_rows(states, system), expected)
    np.testing.assert_array_equal(moving_rows(np.zeros((20, 3)), system), np.zeros(20, dtype=bool))
    assert moving_rows(np.zeros((20, 1)), LINE).all()


def test_windows_of_moving_rows_start_nowhere_in_a_standstill(car, rng):
    states = np.ones((60, 3))
    states[20:50] = 0.0
    data = Dataset.from_arrays(car, [states], [np.zeros((60, 2))])
    starts = data.windows(5, moving=True).start
    assert set(range(55)) - set(starts.tolist()) == set(range(25, 45))


def test_a_split_by_name_includes_every_part_of_an_episode():
    data = numbered([4, 4, 4])
    pieces = data.with_episodes(
        [
            data.episodes[0][:2],
            data.episodes[0][3:4],
            data.episodes[1],
            Trajectory(np.zeros((2, 1)), [[0.0]], 0.1, None, "e01"),
        ]
    )
    train, test = pieces.split(["e0"])
    assert test.names == ("e0[0:2]", "e0[3:4]")
    assert train.names == ("e1", "e01")


def test_a_split_by_time_takes_the_end_of_each_episode():
    train, test = numbered([10, 4]).split(0.3)
    np.testing.assert_array_equal(train.episodes[0].states[:, 0], np.arange(8.0))
    np.testing.assert_array_equal(test.episodes[0].states[:, 0], np.arange(7.0, 11.0))
    assert [len(episode) for episode in test] == [3, 1]
    assert test.names == ("e0[7:10]", "e1[3:4]")


@pytest.mark.parametrize("test", [["nobody"], ["e0", "e1"], [], 0.0, 1.0])
def test_an_impossible_split_is_refused(test):
    with pytest.raises(InvalidArgument, match="split"):
        numbered([4, 4]).split(test)


def test_an_episode_with_a_hole_in_it_is_refused_with_its_place():
    states = np.zeros((4, 1))
    states[2] = np.nan
    with pytest.raises(InvalidData, match=r"episode 'bad': state 0 at sample 2 is nan"):
        Trajectory(states, np.zeros((3, 1)), 0.1, None, "bad")


def test_a_split_takes_one_name_as_a_name_and_not_as_letters():
    train, test = numbered([4, 4, 4]).split("e1")
    assert (train.names, test.names) == (("e0", "e2"), ("e1",))
    with pytest.raises(InvalidArgument, match=r"no episode is called 'e'\. There are e0, e1, e2"):
        numbered([4, 4, 4]).split("e")


def test_a_system_without_controls_is_stored_and_loaded(tmp_path, rng):
    free = System(("angle", "rate"), (), 0.1)
    data = Dataset.from_arrays(free, [rng.normal(size=(5, 2)), rng.normal(size=(3, 2))])
    loaded = Dataset.load(data.save(tmp_path / "free"))
    assert loaded.fingerprint == data.fingerprint
    assert loaded.episodes[1].controls.shape == (2, 0)
    with pytest.raises(InvalidArgument, match=r"has the controls push, got none: Dataset.from_arrays\(system, states,"):
        Dataset.from_arrays(LINE, [np.zeros((3, 1))])


def test_one_array_is_one_episode_and_one_channel_may_be_flat():
    flat = Dataset.from_arrays(LINE, np.arange(5.0), np.arange(4.0))
    lists = Dataset.from_arrays(LINE, [[[0.0], [1.0], [2.0], [3.0], [4.0]]], [[0.0, 1.0, 2.0, 3.0]])
    assert flat.fingerprint == lists.fingerprint
    assert len(flat) == 1
    alone = Trajectory(np.arange(5.0), np.arange(4.0), 0.1, None, "episode-0")
    assert Dataset(LINE, [alone]).fingerprint == flat.fingerprint
    with pytest.raises(ShapeError, match=r"states of 'episode-0': expected shape \(any, 2\), got \(5, 1\)"):
        Dataset.from_arrays(System(("a", "b"), (), 0.1), np.arange(5.0))
    stacked = Dataset.from_arrays(LINE, np.zeros((3, 5, 1)), np.zeros((3, 4, 1)), names=["a", "b", "c"])
    assert stacked.names == ("a", "b", "c")


def test_samples_that_were_appended_to_a_list_are_one_episode(rng):
    system = System(["a", "b"], ["u"], dt=0.1)
    states, controls = rng.normal(size=(5, 2)), rng.normal(size=(4, 1))
    for listed in (list, np.ndarray.tolist):
        data = Dataset.from_arrays(system, listed(states), listed(controls))
        np.testing.assert_array_equal(data.episodes[0].states, states)
        np.testing.assert_array_equal(data.episodes[0].controls, controls)
    two = Dataset.from_arrays(system, [states[:2], states[2:4]], [controls[0], controls[1]])
    assert [len(episode) for episode in two] == [1, 1]


def test_a_table_gives_one_episode_for_each_name(rng):
    frame = pd.DataFrame({"run": ["a"] * 4 + ["b"] * 3, "place": np.arange(7.0), "push": -np.arange(7.0)})
    data = Dataset.from_pandas(LINE, frame, episode="run")
    assert data.names == ("a", "b")
    np.testing.assert_array_equal(data.episodes[1].states[:, 0], [4.0, 5.0, 6.0])
    np.testing.assert_array_equal(data.episodes[1].controls[:, 0], [-4.0, -5.0])
    with pytest.raises(InvalidData, match=r"missing columns place; it has run, x, push.*frame.rename"):
        Dataset.from_pandas(LINE, frame.rename(columns={"place": "x"}))


def test_wrong_arguments_give_an_error_with_the_correct_call():
    frame = pd.DataFrame({"place": [0.0, 1.0], "push": [0.0, 0.0]})
    with pytest.raises(InvalidArgument, match=r"System first, got DataFrame: Dataset.from_pandas\(system, frame\)"):
        Dataset.from_pandas(frame, LINE)
    with pytest.raises(InvalidArgument, match=r"pandas table, got ndarray.*Dataset.from_arrays\(system, states, con"):
        Dataset.from_pandas(LINE, np.zeros((4, 2)))
    with pytest.raises(InvalidData, match="table: expected two rows or more, one for each dt, got 0"):
        Dataset.from_pandas(LINE, frame.iloc[:0])
    with pytest.raises(InvalidArgument, match=r"System first, got ndarray: Dataset.from_arrays\(system, states, con"):
        Dataset.from_arrays(np.zeros((3, 1)), np.zeros((2, 1)), LINE)
    with pytest.raises(InvalidArgument, match=r"Trajectory objects as episodes, got ndarray.*Dataset.from_arrays"):
        Dataset(LINE, [np.zeros((3, 1))])
    with pytest.raises(InvalidArgument, match=r"System first, got DataFrame: Dataset\(system, episodes\)"):
        Dataset(frame, ())


@pytest.mark.parametrize("first, start", [(None, 3), (1, 3), (3, 3), (5, 5)])
def test_no_window_has_less_history_than_asked_for(first, start):
    windows = numbered([12, 2]).windows(2, history=3, first=first, stride=4)
    assert windows.start.tolist() == list(range(start, 11, 4))
    assert windows.past_states.shape[1:] == (4, 1)
    np.testing.assert_array_equal(windows.past_states[0, :, 0], start + np.arange(-3.0, 1.0))
    np.testing.assert_array_equal(windows.past_controls[0, :, 0], -(start + np.arange(-3.0, 0.0)))


def test_a_channel_named_like_a_column_of_the_file_is_refused_when_stored(tmp_path, rng):
    counted = Dataset.from_arrays(System(("step",), (), 0.1), rng.normal(size=5))
    with pytest.raises(
        InvalidData, match=r"the channels step cannot become columns, because episode, step.*rename the channels"
    ):
        counted.save(tmp_path / "data")
    assert not (tmp_path / "data").exists()


def test_windows_that_are_only_found_take_little_memory(car, rng):
    data = Dataset.from_arrays(car, rng.normal(size=(20_001, 3)), rng.integers(-1, 2, (20_000, 2)).astype(float))
    tracemalloc.start()
    try:
        places = data.find_windows(50, history=3)
        few = places[np.array([0, 5000, len(places) - 1])]
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 20_000 * 8 * 10
    every = data.windows(50, history=3)
    assert len(places) == len(every) == 20_000 - 50 - 3 + 1
    np.testing.assert_array_equal(few.states, every[np.array([0, 5000, len(every) - 1])].states)
    np.testing.assert_array_equal(places.last_states, every.states[:, -1])


def test_a_model_is_judged_by_at_most_ten_thousand_windows_over_all_of_the_data(car, rng):
    states = rng.normal(size=(60_001, 3))
    data = Dataset.from_arrays(car, [states[:30_001], states[30_000:]], [np.zeros((30_000, 2))] * 2)
    windows = error_windows(data, 0)
    assert 9_000 < len(windows) <= 10_000
    assert set(windows.episode) == {0, 1}
    short = data[0].split(0.9)[0]
    np.testing.assert_array_equal(np.diff(error_windows(short, 0).start), 4)


@pytest.fixture
def counted():
    """Three episodes whose state is the number of the sample; 25,000 steps in all."""
    system = System(("sample",), (Channel("u", low=0.0, high=1.0),), 0.1)
    samples = [np.arange(n + 1.0) + 100_000 * i for i, n in enumerate((20_000, 400, 4_600))]
    return Dataset.from_arrays(system, samples, [np.zeros(len(x) - 1) for x in samples], names=["a", "b", "c"])


def test_short_data_stay_as_they_are_and_no_random_number_is_used(counted):
    rng = np.random.default_rng(0)
    assert subsample(counted, 25_000, rng) is counted
    assert rng.random() == np.random.default_rng(0).random()


@pytest.mark.parametrize("most", [100, 1500, 12_000, 24_999])
def test_a_part_has_at_most_so_many_steps_and_nearly_as_many(counted, most):
    few = subsample(counted, most, np.random.default_rng(0))
    block = min(1000, max(100, most // 20))
    assert most - block <= few.n_steps <= most


def test_blocks_are_runs_of_the_recording_and_no_step_comes_twice(counted):
    few = subsample(counted, 12_000, np.random.default_rng(1))
    for episode in few:
        np.testing.assert_array_equal(np.diff(episode.states[:, 0]), 1.0)
        assert len(episode) >= 400
        assert episode.name.startswith(("a[", "b[", "c["))
    first = np.concatenate([episode.states[:-1, 0] for episode in few])
    assert len(np.unique(first)) == len(first)
    assert (np.diff(first) > 0).all()


def test_another_seed_takes_other_blocks_and_the_same_seed_the_same(counted):
    one, again, other = (subsample(counted, 5_000, np.random.default_rng(seed)) for seed in (0, 0, 1))
    assert one.fingerprint == again.fingerprint != other.fingerprint
