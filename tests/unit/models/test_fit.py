"""Habits of Python users: what `fit`, `score` and `simulate` take, and what they say to what they do not."""

import inspect
import sys
import time
from dataclasses import replace
from typing import ClassVar, Literal

import numpy as np
import pandas as pd
import pytest
from sklearn.base import clone
from sklearn.model_selection import GridSearchCV

from sysid_evo import EpisodeFold, progress
from sysid_evo.data import Dataset
from sysid_evo.data.dataset import from_samples
from sysid_evo.data.trajectory import Trajectory
from sysid_evo.errors import DataWarning, IncompatibleSystem, InvalidArgument, InvalidData, MissingExtra, ShapeError
from sysid_evo.models import DynamicsModel, load_model, save_model
from sysid_evo.models.base import make_model
from sysid_evo.models.parameters import above, at_least
from sysid_evo.system import Channel, System
from sysid_evo.testing import example_dataset

SYSTEM = System((Channel("a"), Channel("b")), (Channel("u", low=-1.0, high=1.0, neutral=0.5),), dt=0.1)


class Drawn(DynamicsModel):
    """x' = gain x + u: the gain is drawn, to tell generators apart."""

    limits: ClassVar = {"share": above(0, at_most=1), "sizes": at_least(1)}

    def __init__(  # annotated, since the types of the values are read from here
        self,
        *,
        share: float = 0.5,
        sizes: list[int] | None = None,
        way: Literal["plain", "other"] = "plain",
        loud: bool = False,
        state_lags: int = 0,
        control_lags: int = 0,
    ) -> None:
        self.share = share
        self.sizes = sizes
        self.way = way
        self.loud = loud
        self.state_lags = state_lags
        self.control_lags = control_lags

    def fit(self, dataset, *, rng, progress=None):
        assert isinstance(dataset, Dataset)
        self.gain_ = float(rng.uniform(0.1, 0.9))
        return self

    def next_state(self, carry, control):
        return self.gain_ * carry[:, -2:] + control


TIMES = 0.05 * np.arange(21)
X = np.stack([np.exp(-TIMES), np.cos(TIMES)], axis=1)
U = np.sin(3 * TIMES)[:, None]


def recording(gain=0.8, names=("one", "two", "three")):
    rng = np.random.default_rng(1)
    states, controls = [], []
    for _ in names:
        u, x = rng.uniform(-1, 1, (60, 1)), [rng.standard_normal(2)]
        for k in range(60):
            x.append(gain * x[-1] + u[k])
        states.append(np.array(x))
        controls.append(u)
    return Dataset.from_arrays(SYSTEM, states, controls, names=names)


DATA = recording()


def test_fit_takes_a_seed_a_generator_or_nothing_which_is_seed_0_and_no_other_thing():
    gains = [Drawn().fit(DATA, rng=rng).gain_ for rng in (None, 0, np.random.default_rng(0), np.int64(0), 1)]
    assert gains[0] == gains[1] == gains[2] == gains[3] != gains[4]
    assert Drawn().fit(DATA).gain_ == gains[0]
    taken = ["self", "dataset", "rng", "progress", "t", "u", "feature_names"]
    assert list(inspect.signature(Drawn.fit).parameters) == taken
    for rng in (-1, 0.5, "seed", True):
        with pytest.raises(InvalidArgument, match=r"rng: expected a seed \(a whole number >= 0\), a Generator or None"):
            Drawn().fit(DATA, rng=rng)


def test_progress_true_draws_a_bar_on_standard_error(capsys):
    Drawn().fit(DATA, progress=True)
    out, err = capsys.readouterr()
    assert (out, "fit Drawn" in err, "1 of 1" in err) == ("", True, True)
    Drawn().fit(DATA, progress=False)
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    ("given", "hint"),
    [
        (pd.DataFrame({"a": [1.0]}), r"got a DataFrame: make one from a table with Dataset\.from_pandas\(system, tab"),
        (
            np.zeros((3, 2)),
            r"got a ndarray: make one from arrays with Dataset\.from_arrays\(system, states, controls\)",
        ),
        ([np.zeros((3, 2))], r"got a list: make one from arrays with Dataset\.from_arrays"),
        (list(DATA), r"got a list: make a data set from episodes with Dataset\(system, episodes\)"),
        (DATA.episodes[0], r"got a Trajectory: make a data set from episodes"),
    ],
)
def test_fit_names_the_call_that_makes_a_data_set(given, hint):
    with pytest.raises(InvalidData, match=r"^Drawn\.fit: expected a Dataset, " + hint):
        Drawn().fit(given)
    with pytest.raises(InvalidData, match=r"^Drawn\.score: expected a Dataset, " + hint):
        Drawn().fit(DATA).score(given)


def test_several_data_sets_of_one_system_are_joined_and_of_two_refused():
    parts = [DATA[0], DATA[1:]]
    joined, whole = make_model("linear").fit(parts), make_model("linear").fit(DATA)
    np.testing.assert_array_equal(joined.coefficients_, whole.coefficients_)
    other = Dataset(SYSTEM.with_dt(0.2), [Trajectory(np.zeros((3, 2)), np.zeros((2, 1)), 0.2)])
    with pytest.raises(InvalidData, match="expected data sets of one system, got several systems"):
        Drawn().fit([DATA, other])
    with pytest.raises(IncompatibleSystem, match=r"Linear\.score: the model has the channels .*, the data have a, u"):
        joined.score(Dataset(System(["a"], ["u"], 0.1), [Trajectory(np.zeros((30, 1)), np.zeros((29, 1)), 0.1)]))


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"share": 0.0}, r"Drawn: share: expected a number > 0 and <= 1, got 0\.0"),
        ({"share": 1.5}, "got 1.5"),
        ({"share": float("nan")}, "got nan"),
        ({"share": True}, "share: expected a number > 0 and <= 1, got True"),
        ({"sizes": [4, 0]}, r"sizes: expected None or a list of whole numbers >= 1, got \[4, 0\]"),
        ({"sizes": 4}, "sizes: expected None or a list of whole numbers >= 1, got 4"),
        ({"way": "both"}, "way: expected one of 'plain', 'other', got 'both'"),
        ({"loud": 1}, "loud: expected True or False, got 1"),
        ({"state_lags": -1}, "state_lags: expected a whole number >= 0, got -1"),
        ({"control_lags": 1.0}, r"control_lags: expected a whole number >= 0, got 1\.0"),
        ({"shar": 0.5}, "Drawn: there is no parameter 'shar'. Did you mean 'share'. It has: share, sizes, way, loud"),
    ],
)
def test_a_wrong_parameter_is_refused_where_it_is_given(parameters, message):
    """By the constructor, by `set_params`, which then changes nothing, and by `fit`."""
    with pytest.raises(InvalidArgument, match=message):
        Drawn(**parameters)
    model = Drawn(share=0.25)
    before = model.get_params()
    with pytest.raises(InvalidArgument, match=message):
        model.set_params(**{"sizes": [2], **parameters})
    assert model.get_params() == before
    name, value = next(iter(parameters.items()))
    if name in before:
        setattr(model, name, value)
        with pytest.raises(InvalidArgument, match=message):
            model.fit(DATA)


def test_whole_numbers_and_numbers_of_numpy_are_numbers():
    assert clone(Drawn(share=1, sizes=[3, 4], state_lags=np.int64(2))).get_params()["state_lags"] == 2


def test_a_family_whose_package_is_missing_shows_how_to_install_it(monkeypatch):
    model = make_model("sindy", degree=2)
    monkeypatch.setitem(sys.modules, "pysindy", None)
    with pytest.raises(MissingExtra, match=r"Sindy needs the package 'pysindy'.*pip install \"sysid-evo\[sindy\]\""):
        model.fit(DATA)
    with pytest.raises(MissingExtra):
        type(model).check_installed()
    monkeypatch.setattr("sysid_evo.models.base.entry_points", lambda **_: pytest.fail("all plugins are looked at"))
    make_model("linear").fit(DATA)


def test_score_is_minus_the_relative_error_of_one_second_of_simulation():
    perfect = Drawn().fit(DATA)
    perfect.gain_ = 0.8
    assert perfect.score(DATA) == pytest.approx(0.0, abs=1e-12)
    standing = Drawn().fit(DATA)
    standing.gain_ = 0.0
    windows = DATA.windows(10, stride=4)  # ten steps of 0.1 s
    simulated = np.broadcast_to(windows.controls, windows.states.shape)
    error = np.sqrt(np.mean((simulated - windows.states) ** 2, axis=0)) / windows.states.std(axis=(0, 1))
    assert standing.score(DATA) == pytest.approx(-error.mean())


def test_grid_search_over_a_data_set_of_episodes_finds_the_better_ridge():
    for given in (DATA, [DATA[i] for i in range(3)]):
        search = GridSearchCV(make_model("linear"), {"ridge": [10.0, 0.0]}, cv=EpisodeFold(3)).fit(given)
        assert search.best_params_ == {"ridge": 0.0}
        assert search.best_score_ == pytest.approx(0.0, abs=1e-6)
        assert search.score(DATA) > -1e-6


def test_episode_fold_holds_out_every_recording_once_with_all_its_parts():
    dataset = recording(names=("a[0:60]", "b", "a[60:120]", "c"))
    folds = [(list(learned), list(held)) for learned, held in EpisodeFold(3).split(dataset)]
    assert folds == [([1, 3], [0, 2]), ([0, 2, 3], [1]), ([0, 1, 2], [3])]
    with pytest.raises(InvalidData, match="expected at least 4 recordings, got 3"):
        next(EpisodeFold(4).split(dataset))
    with pytest.raises(InvalidArgument, match="expected n_splits >= 2, got 1"):
        EpisodeFold(1)


def test_one_run_needs_only_a_state_and_controls():
    """A state and controls; a history; a trajectory: each is the batch of one."""
    model = Drawn(state_lags=1, control_lags=2).fit(DATA)
    run, lags = DATA.episodes[0], 2
    past, u = run.states[: lags + 1], run.controls[lags:]
    batch = model.simulate(past[None], run.controls[None, :lags], u[None])[0]
    np.testing.assert_array_equal(model.simulate(run), batch)
    np.testing.assert_array_equal(model.simulate(past, run.controls[:lags], u), batch)
    np.testing.assert_array_equal(model.simulate(past, run.controls[:lags, 0], u[:, 0]), batch)
    assert model.simulate(past, u, samples=3).shape == (3, len(u), 2)


def test_a_short_history_is_padded_with_its_first_state_and_neutral_controls():
    model = Drawn(state_lags=2, control_lags=1).fit(DATA)
    x0, x1, u = np.array([1.0, 2.0]), np.array([3.0, 4.0]), np.zeros((4, 1))
    neutral = np.full((1, 2, 1), 0.5)
    np.testing.assert_array_equal(model.simulate(x0, u), model.simulate(np.array([[x0, x0, x0]]), neutral, u[None])[0])
    by_hand = model.simulate(np.array([[x0, x0, x1]]), neutral, u[None])[0]
    np.testing.assert_array_equal(model.simulate(np.array([x0, x1]), u[:, 0]), by_hand)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([0.0, 0.0, 0.0], np.zeros((4, 1))), r"states: expected one state \(2,\) or a history \(any, 2\), got \(3,\)"),
        (([0.0, 0.0], np.zeros((4, 2))), r"controls: expected shape \(any, 1\), got \(4, 2\)"),
        ((np.zeros((2, 2)), np.zeros((3, 1)), np.zeros((4, 1))), "past_controls: expected 1, one fewer than"),
    ],
)
def test_a_plain_run_names_the_array_of_the_wrong_shape(arguments, message):
    with pytest.raises(ShapeError, match=message):
        Drawn().fit(DATA).simulate(*arguments)


def test_a_plain_run_needs_controls_and_states_enough_to_start():
    with pytest.raises(InvalidArgument, match="expected a state and controls, or a Trajectory; got no controls"):
        Drawn().fit(DATA).simulate([0.0, 0.0])
    short = Trajectory(np.zeros((3, 2)), np.zeros((2, 1)), 0.1, name="short")
    with pytest.raises(InvalidData, match="Drawn needs 3 states to start, 'short' has no more than these"):
        Drawn(control_lags=2).fit(DATA).simulate(short)


def test_the_way_in_which_pysindy_simulates_is_answered_with_that_of_this_library():
    """Times would else be taken for the controls before the run."""
    for arguments, keywords in (((0.1 * np.arange(5), np.zeros((5, 1))), {}), ((), {"t": 0.1, "u": np.zeros(5)})):
        with pytest.raises(
            InvalidArgument, match=r"expected simulate\(x0, u\) with one row of u for each step of 0.1 s"
        ):
            Drawn().fit(DATA).simulate([0.0, 0.0], *arguments, **keywords)


@pytest.mark.parametrize("name", ["linear", "nearest_neighbour", "gaussian_process"])
def test_numbers_too_large_to_be_multiplied_are_refused_before_anything_is_learned(name):
    data = example_dataset(episodes=1, steps=100)
    (episode,) = data
    states = episode.states.copy()
    states[50, 1] = 1e200
    broken = data.with_episodes([replace(episode, states=states)])
    with pytest.raises(InvalidData, match=r"numbers up to 1e\+30, got 1e\+200 in 'lateral_speed'"):
        make_model(name).fit(broken)


def test_a_few_samples_or_constant_states_warn_that_the_error_is_meaningless():
    data = example_dataset(episodes=1, steps=100)
    (episode,) = data
    few = data.with_episodes([episode[:8]])
    still = data.with_episodes([replace(episode, states=np.full_like(episode.states, 0.3))])
    model = make_model("linear").fit(data)  # a warning would be an error
    assert model.score(data) < 0.0
    for use, tried in (("fitted to", make_model("linear").fit), ("scored on", model.score)):
        with pytest.warns(DataWarning, match=f"Linear is {use} 8 steps, too few for 5 states and controls: expected"):
            tried(few)
        with pytest.warns(DataWarning, match=f"Linear is {use} a recording in which no state changes"):
            tried(still)


def test_columns_are_numbered_and_the_step_is_that_of_the_times():
    data = from_samples(X, TIMES, U)
    assert (data.system.state_names, data.system.control_names) == (("x0", "x1"), ("u0",))
    assert data.system.dt == pytest.approx(0.05)
    np.testing.assert_array_equal(data.episodes[0].states, X)
    np.testing.assert_array_equal(data.episodes[0].controls, U[:-1])


def test_a_fit_to_arrays_is_the_fit_to_their_data_set():
    there = make_model("linear").fit(X, t=0.05, u=U)
    here = make_model("linear").fit(Dataset.from_arrays(there.system, X, U))
    np.testing.assert_array_equal(there.coefficients_, here.coefficients_)


def test_names_may_be_given_as_to_pysindy():
    """Of the states, then of the controls; a data set has its own."""
    times = 0.05 * np.arange(81)
    x, u = np.stack([np.exp(-times), np.cos(times)], axis=1), np.sin(3 * times)
    model = make_model("narx", degree=1, terms=4, state_lags=0, control_lags=0)
    model.fit(x, t=times, u=u, feature_names=["decay", "swing", "push"])
    assert (model.system.state_names, model.system.control_names) == (("decay", "swing"), ("push",))
    decay, swing = model.equations()
    assert decay.startswith("decay[+1] = ")
    assert model.coefficients().shape == (2, len(model.exponents_))
    for row, line in zip(model.coefficients(), (decay, swing), strict=True):
        assert all(f"{abs(one):.4g}" in line for one in row if one)
    with pytest.raises(InvalidArgument, match="feature_names: expected 3 names, for x0, x1, u0, got 2"):
        from_samples(x, 0.05, u, ["decay", "swing"])
    with pytest.raises(InvalidArgument, match="a Dataset has its own"):
        model.fit(from_samples(x, 0.05, u), feature_names=["decay", "swing", "push"])


def test_a_list_holds_one_array_for_each_trajectory_or_the_numbers_of_one_flat_state():
    for u, nu in ((None, 0), ([U, U[:9, 0]], 1)):
        data = from_samples([X, X[:9]], [TIMES, TIMES[:9]], u)
        assert ([len(episode) for episode in data], data.system.nu) == ([20, 8], nu)
    assert from_samples([0.0, 1.0, 3.0], np.float32(0.5)).episodes[0].states.tolist() == [[0.0], [1.0], [3.0]]


def test_uneven_times_and_arrays_that_do_not_fit_are_refused():
    uneven = TIMES.copy()
    uneven[10:] += 0.02
    with pytest.raises(InvalidData, match=r"equally spaced times, got a mean step of 0.051 s and one of 0.07 s"):
        from_samples(X, uneven)
    with pytest.raises(InvalidData, match=r"one time for each sample \(21, 9\).*got 21, 8"):
        from_samples([X, X[:9]], [TIMES, TIMES[:8]])
    with pytest.raises(ShapeError, match=r"x: expected \(samples, columns\).*got \(2, 3, 4\)"):
        from_samples(np.zeros((2, 3, 4)), 0.05)
    nearly = TIMES + 1e-6 * np.sin(np.arange(21))
    assert from_samples(X, nearly).system.dt == pytest.approx(0.05, rel=1e-4)


def test_a_data_set_needs_no_times_and_controls_alone_do_not_do():
    data = from_samples(X, 0.05)
    for given in (data, [data]):
        with pytest.raises(InvalidArgument, match="a Dataset has its own times and controls: expected no t"):
            make_model("linear").fit(given, t=0.05)
    with pytest.raises(InvalidArgument, match=r"Linear\.fit: expected the time step.*fit\(x, t=0.05, u=u\)"):
        make_model("linear").fit(X, u=U)


class Slow(DynamicsModel):
    """Works for a hundredth of a second for each part that it reports."""

    presets: ClassVar = {"quick": {"parts": 5}}

    parts: int = 10**6
    control_lags: int | None = None

    def fit(self, dataset, *, rng, progress=None):
        for done in range(5):
            until = time.process_time() + 0.01
            while time.process_time() < until:
                pass
            progress(done, self.parts)
        return self

    def acceleration(self, carry, control):
        return np.zeros((len(carry), self.system.nx))


def test_a_fit_that_takes_long_warns_early_with_a_remedy(monkeypatch):
    monkeypatch.setattr(progress, "MIN_SECONDS", 0.005)
    much = r"Slow may take \d+ min more; .* makes it shorter: parts=5, control_lags=0 .of .* 2 states and 1 controls"
    with pytest.warns(DataWarning, match=much) as given:
        Slow().fit(DATA)
    assert len(given) == 1
    Slow(parts=5).fit(DATA)  # a warning would be an error


class Counting(DynamicsModel):
    """Learns how many steps it was given."""

    max_steps: int | None = 300

    def fit(self, dataset, *, rng, progress=None):
        self.given_ = dataset.n_steps
        return self

    def acceleration(self, carry, control):
        return np.zeros((len(carry), self.system.nx))


def test_a_family_with_max_steps_reports_how_many_steps_it_uses():
    data = example_dataset(episodes=2, steps=200)
    model = Counting()
    with pytest.warns(DataWarning, match=r"Counting uses \d+ of 400 steps, blocks of time"):
        model.fit(data, rng=0)
    assert 200 <= model.given_ <= 300
    assert model.fit_note.startswith(f"uses {model.given_} of 400 steps")
    highest = max(episode.states[:, 0].max() for episode in data)
    assert model.state_bounds_[1, 0] >= highest, "the range is that of all the data"
    model.set_params(max_steps=None).fit(data, rng=0)
    assert (model.given_, model.fit_note) == (400, "")


def test_the_note_on_its_data_is_stored_with_a_model(tmp_path):
    data = example_dataset(episodes=2, steps=200)
    with pytest.warns(DataWarning):
        model = make_model("backprop27", epochs=10, max_steps=150).fit(data, rng=0)
    assert load_model(save_model(model, tmp_path / "model")).fit_note == model.fit_note != ""
