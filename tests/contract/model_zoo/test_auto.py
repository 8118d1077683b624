"""`auto` and `average`: acceptance, weights, what is tried for a budget, and the mean of what is kept."""

import importlib.util
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from sklearn.linear_model import Ridge
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from model_zoo.auto.candidates import NUMBERS, SHIPPED, STEPS, Candidate, candidates_for, candidates_named, unusable
from model_zoo.auto.fitting import LARGE_LIBRARIES, FitTask, FitWork, fitted, load
from model_zoo.auto.model import PROCESSORS, SHARE, Auto
from model_zoo.auto.selection import (
    BASE_BEHIND,
    REPLACED,
    UNTRIED,
    CandidateSelection,
    affordable,
    chosen,
    class_leaders,
    structure_of,
    weights_of,
)
from model_zoo.average import Average
from model_zoo.linear import Linear
from model_zoo.regressor import Regressor
from sysid_evo.data import Dataset
from sysid_evo.errors import IncompatibleSystem, InvalidArgument, InvalidData, SysidEvoError
from sysid_evo.models import DynamicsModel, load_model, save_model
from sysid_evo.models.adaptation import held_out_error, selection
from sysid_evo.models.adaptation.selection import NEW_FIT, adaptation
from sysid_evo.models.adapters import as_spec
from sysid_evo.models.base import make_model
from sysid_evo.processors import use_processors
from sysid_evo.registry import Spec, make_robot, models
from sysid_evo.system import Channel, System
from sysid_evo.testing import example_dataset
from sysid_evo.validation.folds import make_folds
from sysid_evo.validation.simulation_error import HeldOutTest, Scorer
from tests.fixtures.systems import FloorCar, drive

pytestmark = pytest.mark.filterwarnings("ignore::sysid_evo.errors.DataWarning")  # some recordings stand still

DATA = example_dataset()
FEW = ["narx(terms=12, state_lags=0, control_lags=2)", "linear(state_lags=1)", "linear(state_lags=0)"]


@pytest.fixture(scope="module")
def data():
    return DATA


@cache
def learned(**settings):
    model = make_model("auto", candidates=FEW, **settings).fit(DATA, rng=0)
    assert isinstance(model, Auto)
    return model


def mean_of(*specs, **settings):
    """Return the mean of these families, the first of which counts half."""
    parts = [make_model(spec).fit(DATA, rng=0) for spec in specs]
    rest = 0.5 / (len(parts) - 1)
    found = learned().variant(**settings)
    found.become(parts, np.array([0.5, *[rest] * (len(parts) - 1)]))
    return found


def test_the_mean_of_next_states_is_the_mean_of_accelerations():
    """Members with lags of their own and without any step from the same state, step after step."""
    mean = mean_of("linear(state_lags=1, control_lags=2)", "linear(ridge=300.0)", "linear")
    data = example_dataset(seed=5)
    system, windows = data.system, data.windows(6, stride=25, history=mean.n_lags)
    carry = mean.start(windows.past_states, windows.past_controls)
    states = [windows.past_states[:, lag] for lag in range(3)]
    controls = [windows.past_controls[:, lag] for lag in range(2)]
    for k in range(6):
        state, control = carry[:, : system.nx], windows.controls[:, k]
        past, commands = np.stack(states[-3:], axis=1), np.stack(controls[-2:], axis=1)
        accelerations = []
        for member in mean.members_:
            own = member.start(past[:, 2 - member.n_lags :], commands[:, 2 - member.n_lags :])
            accelerations.append(system.acceleration(state, member.step(own, control)[:, : system.nx]))
        expected = system.integrate(state, np.tensordot([0.5, 0.25, 0.25], accelerations, axes=1))
        carry = mean.step(carry, control)
        np.testing.assert_allclose(carry[:, : system.nx], expected, rtol=1e-9, atol=1e-12)
        states.append(carry[:, : system.nx])
        controls.append(control)


class Remembering(DynamicsModel):
    """What is told is the sum of all controls so far, which stands behind the state, and half of its noise."""

    n_noise = 1

    def fit(self, dataset, *, rng, progress=None):
        return self

    @property
    def n_carry(self):
        return self.system.nx + 1

    def start(self, states, controls, draws=None):
        return np.concatenate([states[:, -1], np.zeros((len(states), 1))], axis=1)

    def step(self, carry, control, noise=None):
        total = carry[:, 3:] + control[:, :1]
        own = 0.0 if noise is None else 0.5 * noise
        return np.concatenate([carry[:, :3] + total + own, total], axis=1)


def test_a_member_with_a_memory_and_noise_of_its_own_keeps_both(data):
    """Its state is the mean's, what it remembers and the noise that it is given are its own."""
    mean = learned().variant()
    mean.become([Remembering().fit(data, rng=0)] * 2, np.array([0.25, 0.75]))
    assert (mean.n_carry, mean.n_noise, mean.kernel()) == (3 + 2 * 4, 2, None)
    carry, noise = mean.start(np.zeros((1, 1, 3)), np.zeros((1, 0, 2))), np.array([[0.4, 0.8]])
    for total in (1.0, 2.0):
        before = carry[0, 0]
        carry = mean.step(carry, np.array([[1.0, 0.0]]), noise)
        assert carry[0, 0] == pytest.approx(before + total + 0.25 * 0.2 + 0.75 * 0.4)
        assert carry[0, [6, 10]].tolist() == [total, total]


def test_the_weight_of_a_model_class_is_the_root_of_its_size_and_is_shared_equally():
    found = weights_of(["network", "polynomial", "network", "neighbours", "network", "network"])
    np.testing.assert_allclose(found, [1 / 8, 1 / 4, 1 / 8, 1 / 4, 1 / 8, 1 / 8])


@pytest.mark.parametrize(
    ("spec", "model_class"),
    [
        ("neural_ode(hidden=[2], one_step_updates=1, updates=1)", "network without lags"),
        ("neural_ode(hidden=[2], one_step_updates=1, updates=1, control_lags=1)", "network with lags"),
        ("narx(terms=3, state_lags=0, control_lags=1)", "polynomial"),
        ("nearest_neighbour", "neighbours"),
        ("parametrised(generations=1)", "physics"),
        ("linear_state_space(iterations=1, folds=1, order=3)", "state space"),
        ("average(families=[nearest_neighbour, nearest_neighbour])", "neighbours"),
        ("average(families=[nearest_neighbour, linear])", "several structures"),
    ],
)
def test_every_model_belongs_to_a_model_class(spec, model_class):
    assert structure_of(make_model(spec).fit(example_dataset(episodes=1), rng=0)) == model_class


def test_candidates_far_worse_than_the_best_or_diverging_are_dropped_with_the_reason():
    model = make_model("auto", candidates=[*FEW, "nearest_neighbour", "narx(state_lags=500, control_lags=0)"])
    model.fit(DATA, rng=0)
    rows = {row["candidate"]: row for row in model.candidate_ranking()}
    assert rows[FEW[0]]["weight"] == "1.00"
    assert rows["linear(state_lags=0)"]["remark"].endswith("x the lowest error in the first of 3 folds")
    assert "of its simulations diverge" in rows["nearest_neighbour"]["remark"]
    assert "no episode is longer than 500 steps" in rows["narx(state_lags=500, control_lags=0)"]["remark"]
    assert "mean of 1 of 4 candidates" in model.fit_note
    assert "all other candidates were dropped after the first fold" in model.fit_note


class Far(Linear):
    """Predicts the same state always, 1.5 standard deviations from the mean."""

    def fit(self, dataset, **settings):
        fitted = super().fit(dataset, **settings)
        states = np.concatenate([episode.states for episode in dataset])
        fitted.coefficients_ = 0.0 * fitted.coefficients_
        fitted.intercept_ = states.mean(axis=0) + 1.5 * states.std(axis=0)
        return fitted


def test_a_candidate_worse_than_no_change_and_a_linear_model_is_dropped_unless_all_are(register):
    """However wide the cutoff is; where all are, the best of them stay."""
    register(models, "far", Far)
    register(models, "farther", type("Farther", (Far,), {"__doc__": "The same again."}))
    model = make_model("auto", candidates=[FEW[1], "far"], cutoff=1e6, folds=2).fit(DATA, rng=0)
    rows = {row["candidate"]: row for row in model.candidate_ranking()}
    assert rows["far"]["remark"].startswith("is worse than both no change (persistence) and a linear model")
    assert (rows[FEW[1]]["weight"], rows["far"]["weight"]) == ("1.00", "")
    alone = make_model("auto", candidates=["far", "farther"], cutoff=1e6, folds=2).fit(DATA, rng=0)
    assert [row["weight"] for row in alone.candidate_ranking()] == ["0.50", "0.50"]


def test_a_candidate_far_behind_in_the_first_fold_is_fitted_once_and_otherwise_in_every_fold():
    """With a wide cutoff the same candidate is judged in all folds."""
    for cutoff, remark in ((1.25, "5.7 x the lowest error in the first of 3 folds"), (5.0, "above")):
        model = make_model("auto", candidates=FEW, cutoff=cutoff)
        model.fit(DATA, rng=0)
        row = next(row for row in model.candidate_ranking() if row["candidate"] == "linear(state_lags=0)")
        assert row["remark"].startswith(remark)
    assert "second best candidate differ significantly" in model.fit_note


@pytest.mark.parametrize(
    ("steps", "neighbour"),
    [(130, "2.1 x the lowest error in simulations of up to 125"), (260, "2.2 x the lowest error in the first of")],
)
def test_a_candidate_that_may_be_behind_by_chance_is_judged_in_every_fold(steps, neighbour):
    """In the first fold of 130 steps one candidate has 1.3 times the lowest error, another 1.7 times, by chance."""
    near = "linear(state_lags=1, control_lags=2)"
    model = make_model("auto", candidates=["linear(state_lags=0)", near, "nearest_neighbour"], cutoff=1.0)
    model.fit(example_dataset(seed=1, episodes=1, steps=steps), rng=0)
    remarks = {row["candidate"]: row["remark"] for row in model.candidate_ranking()}
    assert "folds" not in remarks[near]
    assert remarks["nearest_neighbour"].startswith(neighbour)


@pytest.mark.parametrize(
    ("candidates", "error", "said"),
    [
        (
            ["narx(state_lags=500, control_lags=0)"],
            InvalidData,
            r"got none: narx\(state_lags=500.*no episode is longer",
        ),
        (["linear", "auto"], InvalidArgument, "would contain itself"),
    ],
)
def test_candidates_of_which_none_can_be_fitted_or_one_is_itself_are_refused(candidates, error, said, data):
    with pytest.raises(error, match=said):
        make_model("auto", candidates=candidates).fit(data, rng=0)


def test_if_no_candidate_can_describe_the_system_the_reasons_are_given():
    turning = System((Channel("angle", "rad", period=2.0 * np.pi),), (Channel("u", low=-1.0, high=1.0),), dt=0.05)
    data = Dataset.from_arrays(turning, [np.zeros((50, 1))], [np.zeros((49, 1))])
    assert not unusable(candidates_named([lambda x, u: -np.sin(x)])[0], turning)
    with pytest.raises(IncompatibleSystem, match=r"got none: linear.*it does not support periodic states .angle"):
        make_model("auto", candidates=["linear"]).fit(data, rng=0)


def test_the_cutoff_is_reduced_if_the_mean_of_more_candidates_is_worse():
    errors = [0.30, 0.20, 0.24, 0.9]
    for mean_error, kept, cutoff in (
        ((0.20, 0.20), [0, 1, 2], 1.5),
        ((0.21, 0.19), [1, 2], 1.25),
        ((0.25, 0.25), [1], 1.125),
    ):
        group, passed = chosen(errors, 1.5, lambda group, e=mean_error: e[0 if len(group) == 3 else 1])
        assert (group, passed.cutoff) == (kept, cutoff)
        assert dict(passed.compared) == {1.5: mean_error[0], 1.25: mean_error[1], 1.125: 0.20, 1.0: 0.20}


def test_candidates_not_significantly_worse_than_the_best_are_kept_within_the_widest_cutoff():
    group, _ = chosen([0.30, 0.20, 0.24, 0.9], 1.5, lambda group: 0.1 * len(group), ties=[1, 2, 3])
    assert group == [1, 2], "the last is outside the widest cutoff"


def test_the_best_candidate_of_each_class_is_kept_within_the_class_cutoff():
    errors, classes = [0.24, 0.20, 0.29, 0.28, 0.5], ["polynomial", "network", "physics", "polynomial", "neighbours"]
    each = np.array(errors)[:, None]
    assert class_leaders(errors, each, classes, 1.4) == [0, 1]
    assert class_leaders(errors, each, classes, 1.5) == [0, 1, 2]
    assert chosen(errors, 1.25, lambda group: 0.2 * len(group))[0] == [1]
    for error, kept in ((0.209, [0, 1, 2]), (0.211, [1])):  # of the mean; 0.2 alone
        group, passed = chosen(errors, 1.25, lambda group, e=error: e + 0.1 * (len(group) == 2), leaders=[0, 1, 2])
        assert (group, passed.cutoff) == (kept, 1.25 if len(kept) == 3 else 1.125)


def test_the_best_of_a_class_is_left_out_if_it_is_near_the_best_only_because_that_fails_in_one_fold():
    """The first polynomial is near in each fold, the second better in one and far worse in two."""
    for polynomial, kept in (([0.21, 0.07, 0.06], [0, 1]), ([0.12, 0.12, 0.16], [0])):
        each = np.array([[0.16, 0.05, 0.04], polynomial])
        assert class_leaders([0.10, 0.135], each, ["state space", "polynomial"], 1.5) == kept


@pytest.mark.parametrize(
    ("class_cutoff", "remark"), [(9.0, "x the lowest error"), (1.0, "x the lowest error in the first of 3 folds")]
)
def test_the_best_of_a_class_continues_after_the_first_fold_but_others_of_its_class_do_not(class_cutoff, remark):
    """That of the neighbours is too high for the mean."""
    names = [FEW[0], "k_neighbours(neighbours=4)", "linear(state_lags=0)"]
    model = make_model("auto", candidates=names, class_cutoff=class_cutoff).fit(DATA, rng=0)
    rows = {row["candidate"]: row for row in model.candidate_ranking()}
    assert [rows[name]["weight"] for name in names] == ["1.00", "", ""]
    assert rows[names[1]]["remark"].endswith(remark)
    assert rows[names[2]]["remark"].endswith("x the lowest error in the first of 3 folds")


def test_a_plugin_that_declares_a_model_class_is_a_candidate(register, data):
    class Zero(DynamicsModel):
        """The state stays as it is."""

        model_class = "nothing moves"

        def fit(self, dataset, *, rng, progress=None):
            return self

        def acceleration(self, carry, control):
            return 0.0 * carry

    register(models, "made_up_zero", Zero)
    assert candidates_for(data.system)[0][0].spec.name == "made_up_zero"
    model = make_model("auto", candidates=["made_up_zero"]).fit(data, rng=0)
    assert structure_of(model.members_[0]) == "nothing moves"


def test_with_noise_the_intervals_contain_most_held_out_samples():
    model = learned(stochastic=True)
    assert model.n_noise == 3
    assert model.kernel() is None
    windows = example_dataset(seed=9).windows(20, stride=20, history=model.n_lags)
    drawn = model.simulate(windows.past_states, windows.past_controls, windows.controls, samples=60, rng=1)
    low, high = np.quantile(drawn[:, :, -1], [0.05, 0.95], axis=0)
    inside = ((windows.states[:, -1] >= low) & (windows.states[:, -1] <= high)).mean()
    assert 0.75 < inside <= 1.0


def test_what_progress_raises_is_no_failure_of_a_candidate():
    class Enough(Exception):
        pass

    once = iter([Enough()])

    def progress(done, total, note=""):
        if done and (stop := next(once, None)) is not None:
            raise stop

    with pytest.raises(Enough):
        make_model("auto", candidates=["sindy(lag_search=few)", *FEW]).fit(DATA, rng=0, progress=progress)


def test_a_process_that_fits_candidates_loads_what_is_installed_and_does_without_the_rest(monkeypatch):
    asked = []
    monkeypatch.setattr("model_zoo.auto.fitting.importlib.import_module", asked.append)
    load([*LARGE_LIBRARIES, "no_such_library"], [], {})
    assert asked == [name for name in LARGE_LIBRARIES if importlib.util.find_spec(name)]
    assert "numba" in asked


@pytest.mark.nightly
def test_objects_from_python_are_fitted_in_other_processes_too(data):
    pytest.importorskip("skops")
    pipe = make_pipeline(StandardScaler(), Ridge())
    spec = as_spec(Regressor(estimator=pipe, state_lags=0, control_lags=0))
    tasks = [FitTask((number, 0), spec.name, dict(spec.parameters), data, number, 20.0) for number in range(2)]
    try:
        use_processors(2)
        outcomes = FitWork(None, 40.0).outcomes(tasks)
    finally:
        use_processors(0)
    assert [outcome.reason for outcome in outcomes.values()] == ["", ""]


@pytest.mark.nightly
def test_the_model_is_the_same_for_any_number_of_processes(data):
    spec = make_model("neural_ode", hidden=[6], one_step_updates=30, updates=10, horizon=5)
    tasks = [FitTask((number, 0), "neural_ode", spec.get_params(), data, number, 20.0) for number in range(2)]
    try:
        use_processors(2)
        side_by_side = FitWork(None, 40.0).outcomes(tasks)
    finally:
        use_processors(0)
    for task in tasks:
        here, there = fitted(task).model, side_by_side[task.key].model
        assert here is not None
        assert there is not None
        for mine, other in zip(here.weights_, there.weights_, strict=True):
            np.testing.assert_array_equal(mine, other)


@pytest.mark.parametrize("chooses", [True, False])
def test_a_family_that_chooses_among_others_is_not_refitted_for_an_adaptation(chooses, data, monkeypatch):
    class Choosing(Linear):
        pass

    Choosing.chooses_families = chooses
    few = data.with_episodes([data.episodes[0][:200]])
    model = Choosing().fit(few, rng=0)
    monkeypatch.setattr(selection, "KINDS", ("linear",))
    tried = [trial.name for trial in adaptation(model, few, rng=np.random.default_rng(0)).decision.trials]
    assert tried
    assert (NEW_FIT in tried) == (not chooses)
    assert Auto.chooses_families


def test_the_held_out_error_is_known_and_within_it_nothing_is_adapted(tmp_path, data):
    """The mean of what learned without each fold runs free there, with the weights of the whole."""
    model = learned()
    means = []
    for seen, held in make_folds(data, model.folds):
        parts = [make_model(spec).fit(seen, rng=0) for spec in FEW]
        kept = [part for part, share in zip(parts, shares_of(model), strict=True) if share > 0.0]
        means.append((model.of(kept, weights_of([structure_of(part) for part in kept])), held))
    expected = held_out_error(means)
    assert expected is not None
    assert model.held_out_error_ is not None
    np.testing.assert_allclose(model.held_out_error_, expected, rtol=1e-6)
    stored = load_model(save_model(model, tmp_path / "auto", seed=0))
    np.testing.assert_array_equal(stored.held_out_error_, model.held_out_error_)
    adapted = stored.adapt(data.with_episodes([data.episodes[0][:400]]), rng=0)
    assert adapted.fit_note.startswith("not adapted: the 1 s simulation error is at most")
    assert learned(stochastic=True).held_out_error_ is not None


def shares_of(model):
    """Return the weights of the candidates that it had, in the order in which they were named."""
    return [float(model.shares_[model.candidates_.index(name)]) for name in FEW]


def test_without_held_out_data_the_held_out_error_is_unknown(data):
    short = data.with_episodes([data.episodes[0][:40]])
    assert make_folds(short, 3)[0][0] is short
    model = make_model("auto", candidates=["linear"], horizons=[5]).fit(short, rng=0)
    assert model.held_out_error_ is None


@pytest.fixture(scope="module")
def average(data):
    return make_model("average(families=[linear, narx(terms=4)])").fit(data, rng=0)


def test_it_predicts_the_mean_of_what_its_families_predict(average, data):
    windows = data.windows(1, history=average.n_lags)
    predicted = average.simulate(windows.past_states, windows.past_controls, windows.controls)
    members = [
        model.simulate(windows.past_states, windows.past_controls, windows.controls)
        for model in (make_model("linear").fit(data, rng=0), make_model("narx(terms=4)").fit(data, rng=0))
    ]
    np.testing.assert_allclose(predicted, np.mean(members, axis=0), atol=1e-9)
    assert not np.allclose(members[0], members[1], atol=1e-3)


def test_it_is_stored_with_its_members_and_names_what_it_uses(average, data, tmp_path):
    loaded = load_model(save_model(average, tmp_path / "average"))
    assert loaded.score(data) == average.score(data)
    assert average.families_used() == ("linear", "narx")
    assert make_model("average").families_used() == ("narx", "k_neighbours")


def test_fitted_models_are_combined_with_the_widest_state_bounds():
    slow, fast = (
        make_model("linear").fit(drive(FloorCar(thrust=thrust), seconds=20.0, seed=1), rng=0) for thrust in (1.0, 3.0)
    )
    made = Average.made_of([slow, fast])
    np.testing.assert_array_equal(made.state_bounds_[0], np.minimum(slow.state_bounds_[0], fast.state_bounds_[0]))
    np.testing.assert_array_equal(made.state_bounds_[1], np.maximum(slow.state_bounds_[1], fast.state_bounds_[1]))
    assert made.state_bounds_[1, 0] > slow.state_bounds_[1, 0]
    np.testing.assert_array_equal(made.weights_, [0.5, 0.5])
    assert made.system == slow.system


def test_the_noise_of_the_mean_matches_its_errors():
    learned, test = (drive(FloorCar(), seconds=40.0, seed=seed, noise=0.05) for seed in (1, 2))
    model = make_model("average(families=[linear, narx(terms=4)], stochastic=true)").fit(learned, rng=0)
    windows = test.windows(20, stride=9, history=model.n_lags)
    drawn = model.simulate(windows.past_states, windows.past_controls, windows.controls, samples=60, rng=3)
    low, high = np.quantile(drawn[:, :, -1], [0.05, 0.95], axis=0)
    held = ((windows.states[:, -1] >= low) & (windows.states[:, -1] <= high)).mean()
    assert 0.8 < held < 0.98


@pytest.mark.parametrize(
    ("families", "said"),
    [
        ([], "families: expected at least one family, got none"),
        (["narx", "average"], "families: expected other families, got average, which would contain itself"),
        (["nrax"], "narx"),
        (["narx(term=4)"], "term"),
    ],
)
def test_wrong_families_are_refused_at_once(families, said):
    with pytest.raises(SysidEvoError, match=said):
        make_model("average", families=families)


def test_a_family_that_does_not_fit_the_system_is_named():
    with pytest.raises(IncompatibleSystem, match=r"families: linear does not support periodic states .angle"):
        make_model("average(families=[narx, linear])").check_system(make_robot("pendulum").system)
    with pytest.raises(IncompatibleSystem, match="Parametrised describes a planar body"):
        make_model("average", families=["parametrised"]).check_system(make_robot("thermal").system)


def test_without_noise_neither_the_mean_nor_its_members_draw_any(data):
    members = [make_model("linear", stochastic=stochastic).fit(data, rng=0) for stochastic in (True, False)]
    mean = Average.made_of(members)
    assert mean.n_noise == 3
    quiet = mean.without_noise()
    assert quiet.n_noise == 0
    np.testing.assert_allclose(quiet.simulate(data.episodes[0]), members[1].simulate(data.episodes[0]), atol=1e-9)
    assert mean.score(data) == quiet.score(data)
    assert quiet.without_noise() is quiet
    noisy = make_model("average(families=[linear], stochastic=true)").fit(data, rng=0)
    assert noisy.n_noise == 3
    assert noisy.without_noise().n_noise == 0


NARX = "narx(terms=12, state_lags=0, control_lags=2)"


def test_all_that_is_shipped_is_offered_to_a_car():
    found, left_out = candidates_for(DATA.system)
    assert [one.spec for one in found] == [one.spec for one in SHIPPED]
    assert not left_out


@pytest.mark.parametrize(("outputs", "budget"), [(1, 60.0), (2, 60.0), (3, 120.0)])
def test_networks_with_hidden_states_are_tried_for_few_outputs_with_any_budget(outputs, budget):
    names = [f"{kind}{i}" for kind in "yu" for i in range(outputs)]
    system = System(tuple(names[:outputs]), tuple(names[outputs:]), dt=0.1)
    found, _ = candidates_for(system)
    costs = {number: one.cost(system, 1500, 3) for number, one in enumerate(found)}
    tried = [found[number].spec.name for number in affordable(costs, PROCESSORS * SHARE * budget)]
    assert "nonlinear_state_space" in tried


@pytest.mark.parametrize(
    ("states", "controls", "steps", "preset", "latent"),
    [(1, 1, 1500, "quick", True), (3, 2, 7200, "quick", False), (3, 2, 7200, "standard", True)],
)
def test_every_preset_tries_a_network_without_lags_and_latent_ode_where_its_time_permits(
    states, controls, steps, preset, latent
):
    """At most two minutes of two processors with `standard`."""
    budget = make_model("auto", **Auto.presets.get(preset, {})).budget
    assert budget <= 120.0
    system = System(tuple(f"y{i}" for i in range(states)), tuple(f"u{i}" for i in range(controls)), dt=0.05)
    found, _ = candidates_for(system)
    costs = {number: one.cost(system, steps, 3) for number, one in enumerate(found)}
    tried = {found[number].name for number in affordable(costs, PROCESSORS * SHARE * budget)}
    assert {"neural_ode(input_noise=0.5)", "narx(lag_search=few, terms=32, degree=none)", "k_neighbours"} <= tried
    assert any(name.startswith("latent_ode") for name in tried) == latent


@pytest.mark.parametrize(("roughly", "seconds"), [({"members": 2}, 5.0), ({"members": 4}, 8.0), ({}, 8.0)])
def test_a_fit_that_only_judges_is_expected_to_take_less_only_where_it_has_fewer_members(roughly, seconds):
    """A quarter of the time of four members is not theirs."""
    one = Candidate(Spec("mlp_ensemble", {"members": 4}), 8.0, 0.0, roughly)
    system = DATA.system
    size = (system.nx + system.nu) / NUMBERS
    assert one.seconds_for(system, 100, rough=True) == pytest.approx(size * seconds)
    assert one.seconds_for(system, 100, rough=False) == pytest.approx(size * 8.0)


def test_a_small_system_takes_less_time_by_the_share_that_goes_with_its_states_and_controls():
    """With one state and one control instead of three and two."""
    system, car = System(("y",), ("u",), dt=0.1), System(("a", "b", "c"), ("u", "v"), dt=0.1)
    for share, less in ((0.0, 1.0), (0.3, 0.82), (1.0, 0.4)):
        one = Candidate(Spec("linear"), 8.0, 0.0, by_channels=share)
        assert one.seconds_for(car, 100, rough=False) == pytest.approx(8.0)
        assert one.seconds_for(system, 100, rough=False) == pytest.approx(8.0 * less)


def test_networks_are_expected_to_take_nearly_as_long_with_one_output_and_state_spaces_far_less():
    system = System(("y",), ("u",), dt=0.1)
    shares = {one.spec.name: one.seconds_for(system, round(STEPS), rough=False) / one.seconds for one in SHIPPED}
    assert shares["mlp_ensemble"] > 0.75
    assert shares["nonlinear_state_space"] < 0.5


def choice_among(candidates, budget=100.0):
    """Return what becomes of these candidates, judged after ten steps."""
    data = DATA
    pairs = make_folds(data, 3)
    judge = Scorer.of(data, [HeldOutTest.of(held, [10], 3) for _, held in pairs])
    seeds = np.zeros((len(candidates), 4), dtype=np.int64)
    choosing = CandidateSelection(data, pairs, judge, candidates, seeds, budget, FitWork(None, budget))
    return choosing.choice(1.25, 1.0, Average.made_of)


@pytest.mark.parametrize(("budget", "tried"), [(2.0, "a"), (8.0, "abd"), (8.7, "abc"), (99.0, "abcd")])
def test_a_budget_is_spent_by_expected_time_and_dropped_candidates_make_room_for_others(budget, tried):
    """Each is expected to take so many seconds four times: in three folds and for all data; b falls behind in one."""
    specs = {"a": (NARX, 1.0), "b": ("linear(state_lags=0)", 1.0)}
    specs |= {"c": ("linear(state_lags=1, ridge=0.1)", 0.9), "d": ("linear(state_lags=2)", 0.7)}
    candidates = [Candidate(Spec.parse(f"{name}={text}"), cost, 0.0) for name, (text, cost) in specs.items()]
    choice = choice_among(candidates, budget)
    assert "".join(one.name for one, error in zip(candidates, choice.errors, strict=True) if error) == tried
    untried = [reason for error, reason in zip(choice.errors, choice.reasons, strict=True) if error is None]
    assert all(reason == UNTRIED for reason in untried)


BEHIND, PLAIN, BROKEN = "linear(state_lags=0)", "narx(terms=6, state_lags=0, control_lags=2)", "narx(state_lags=500)"
BY_CHANCE = "narx(terms=7, state_lags=0, control_lags=2)"
"""Its error is 1 % above that of PLAIN, which is not significant."""


@pytest.mark.parametrize(
    ("rough", "better", "budget", "left", "reasons"),
    [
        (PLAIN, PLAIN, 100.0, "ac", ["", REPLACED, ""]),
        (PLAIN, BY_CHANCE, 100.0, "ac", ["", REPLACED, ""]),
        (PLAIN, NARX, 100.0, "abc", ["", "", ""]),
        (NARX, PLAIN, 100.0, "ac", ["", REPLACED, ""]),
        (PLAIN, BEHIND, 100.0, "ab", ["", "", "x the lowest error in the first of 3 folds"]),
        (PLAIN, BROKEN, 100.0, "ab", ["", "", "no episode is longer than 500 steps"]),
        (BEHIND, PLAIN, 100.0, "a", ["", "x the lowest error in the first of 3 folds", BASE_BEHIND]),
        (PLAIN, PLAIN, 9.0, "ab", ["", "", UNTRIED]),
        (PLAIN, PLAIN, 5.0, "a", ["", UNTRIED, BASE_BEHIND]),
    ],
)
def test_a_refinement_is_tried_if_its_shorter_version_is_near_the_best_and_replaces_it_unless_it_is_significantly_worse(
    rough, better, budget, left, reasons
):
    """The best is a; c refines b; each is expected to take a second four times."""
    first, second = (Candidate(Spec.parse(text), 1.0, 0.0) for text in (f"a={PLAIN}", f"b={rough}"))
    choice = choice_among(
        [first, second, Candidate(Spec.parse(f"c={better}"), 1.0, 0.0, successor_of=second.name)], budget
    )
    assert "".join("abc"[number] for number in choice.kept) == left
    for expected, reason in zip(reasons, choice.reasons, strict=True):
        assert expected in reason
        assert bool(reason) == bool(expected)


@pytest.mark.parametrize(
    ("shorter", "seconds", "budget", "tried"),
    [("a", 1.0, 12.0, "abd"), ("a", 1.1, 12.0, "abc"), ("b", 1.0, 12.0, "abc"), ("b", 1.0, 9.0, "abd")],
)
def test_the_refinement_of_a_leading_candidate_is_tried_before_all_others_and_another_before_what_is_left(
    shorter, seconds, budget, tried, monkeypatch
):
    """Each is expected to take 4; a leads; b falls behind in the first fold, so that it takes 1, but may be refined.

    With a budget of 12, half of the 8 that a leaves are enough for d, unless it takes longer.
    """
    monkeypatch.setattr("model_zoo.auto.selection.REFINE_FACTOR", 100.0)
    specs = {"a": PLAIN, "b": BEHIND, "c": BY_CHANCE, "d": NARX}
    *others, d = (Candidate(Spec.parse(f"{name}={text}"), 1.0, 0.0) for name, text in specs.items())
    d = replace(d, seconds=seconds, successor_of=others["ab".index(shorter)].name)
    choice = choice_among([*others, d], budget)
    assert "".join(name for name, error in zip(specs, choice.errors, strict=True) if error) == tried


@pytest.mark.parametrize(("cutoff", "folds"), [(3.0, [0, 1, 2]), (1.25, [0, 2])])
def test_a_committee_has_the_weight_of_one_model_and_contains_the_good_fold_models(monkeypatch, cutoff, folds, data):
    """Both are polynomials, so each weighs a half; the second is a committee."""
    tried = [Candidate(Spec.parse(f"{name}={PLAIN}"), 1.0, keep_fold_models=name == "b") for name in "ab"]
    monkeypatch.setattr("model_zoo.auto.model.candidates_for", lambda _: (tried, []))
    model = make_model("auto", cutoff=cutoff).fit(data, rng=0)
    assert isinstance(model, Auto)
    size = len(folds) + 1
    np.testing.assert_allclose(model.weights_, [0.5, *[0.5 / size] * size])
    assert [row["weight"] for row in model.candidate_ranking()] == ["0.50", "0.50"]
    windows, parts = data.windows(1, history=2), [data, data, *(make_folds(data, 3)[fold][0] for fold in folds)]
    for member, part in zip(model.members_, parts, strict=True):
        again = make_model(PLAIN).fit(part, rng=0)
        now = [one.simulate(windows.past_states, windows.past_controls, windows.controls) for one in (member, again)]
        np.testing.assert_allclose(*now)


def test_a_named_refinement_is_tried():
    assert any(one.successor_of for one in SHIPPED)
    found = candidates_named(["nonlinear_state_space"])
    assert len(found) == 2
    assert not any(one.successor_of for one in found)


def test_an_average_that_is_named_alone_is_that_of_its_own_families():
    (found,) = candidates_named(["average"])
    assert found.spec.parameters == {}
    assert any(one.spec.name == "average" and one.successor_of for one in SHIPPED)


def test_a_refinement_follows_its_shorter_version_in_the_list():
    names = [one.name for one in SHIPPED]
    assert len(set(names)) == len(names)
    for number, one in enumerate(SHIPPED):
        assert not one.successor_of or one.successor_of in names[:number]
