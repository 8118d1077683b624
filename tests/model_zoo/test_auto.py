"""The family that is the zoo: folds, judging by free runs, gate, weights, and the mean of what is kept."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from model_zoo.auto.candidates import offered
from model_zoo.auto.fitting import LARGE, FitTask, FitWork, fitted, load
from model_zoo.auto.model import Auto
from model_zoo.auto.selection import chosen, structure_of, weights_of
from model_zoo.linear import Linear
from sysid_evo.data import Dataset
from sysid_evo.engine.compiled.open_loop import kernel_step
from sysid_evo.errors import IncompatibleSystem, InvalidArgument, InvalidData
from sysid_evo.models import DynamicsModel, load_model, save_model
from sysid_evo.models.adaptation import held_out_error
from sysid_evo.models.adaptation.selection import ANEW, adaptation
from sysid_evo.models.base import make_model
from sysid_evo.processors import use_processors
from sysid_evo.registry import models
from sysid_evo.system import Channel, System
from sysid_evo.testing import example_dataset
from sysid_evo.validation.bootstrap import paired_interval as interval
from sysid_evo.validation.folds import balanced, folds_of
from sysid_evo.validation.simulation_error import HeldOutTest, Judge, horizons_of

pytestmark = pytest.mark.filterwarnings("ignore::sysid_evo.errors.DataWarning")  # some recordings stand still

FEW = ["narx(terms=12, state_lags=0, control_lags=2)", "linear(state_lags=1)", "linear(state_lags=0)"]


@cache
def learned(**settings: Any) -> Auto:
    model = make_model("auto", candidates=FEW, **settings).fit(example_dataset(), rng=0)
    assert isinstance(model, Auto)
    return model


def mean_of(*specs: str, **settings: Any) -> Auto:
    """Return the mean of these families, the first of which counts half."""
    parts = [make_model(spec).fit(example_dataset(), rng=0) for spec in specs]
    rest = 0.5 / (len(parts) - 1)
    found = learned().variant(**settings)
    found.become(parts, np.array([0.5, *[rest] * (len(parts) - 1)]))
    return found


def test_the_mean_of_next_states_is_the_mean_of_accelerations_and_its_compiled_form_is_the_same() -> None:
    """Members with lags of their own and without any step from the same state, step after step."""
    mean = mean_of("linear(state_lags=1, control_lags=2)", "linear(ridge=300.0)", "linear", rest_hold=True)
    data = example_dataset(seed=5)
    system, windows = data.system, data.windows(6, stride=25, history=mean.n_lags)
    kernel = mean.kernel()
    assert kernel is not None
    carry = compiled = mean.start(windows.past_states, windows.past_controls)
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
        compiled = kernel_step(kernel, compiled, control, precision="float64")
        np.testing.assert_allclose(carry[:, : system.nx], expected, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(compiled, carry, rtol=1e-7, atol=1e-9)
        states.append(carry[:, : system.nx])
        controls.append(control)


class Remembering(DynamicsModel):
    """What is told is the sum of all controls so far, which stands behind the state, and half of its noise."""

    n_noise = 1

    def fit(self, dataset: Any, *, rng: Any, progress: Any = None) -> Any:
        return self

    @property
    def n_carry(self) -> int:
        return self.system.nx + 1

    def start(self, states: Any, controls: Any, draws: Any = None) -> Any:
        return np.concatenate([states[:, -1], np.zeros((len(states), 1))], axis=1)

    def step(self, carry: Any, control: Any, noise: Any = None) -> Any:
        total = carry[:, 3:] + control[:, :1]
        own = 0.0 if noise is None else 0.5 * noise
        return np.concatenate([carry[:, :3] + total + own, total], axis=1)


def test_a_member_with_a_memory_and_noise_of_its_own_keeps_both() -> None:
    """Its state is the mean's, what it remembers and the noise that it is given are its own."""
    data = example_dataset()
    mean = learned().variant()
    mean.become([Remembering().fit(data, rng=0)] * 2, np.array([0.25, 0.75]))
    assert (mean.n_carry, mean.n_noise, mean.kernel()) == (3 + 2 * 4, 2, None)
    carry, noise = mean.start(np.zeros((1, 1, 3)), np.zeros((1, 0, 2))), np.array([[0.4, 0.8]])
    for total in (1.0, 2.0):
        before = carry[0, 0]
        carry = mean.step(carry, np.array([[1.0, 0.0]]), noise)
        assert carry[0, 0] == pytest.approx(before + total + 0.25 * 0.2 + 0.75 * 0.4)
        assert carry[0, [6, 10]].tolist() == [total, total]


def test_a_class_of_structure_weighs_as_the_root_of_how_many_are_in_it_and_these_weigh_alike() -> None:
    found = weights_of(["network", "polynomial", "network", "neighbours", "network", "network"])
    np.testing.assert_allclose(found, [1 / 8, 1 / 4, 1 / 8, 1 / 4, 1 / 8, 1 / 8])


@pytest.mark.parametrize(
    ("spec", "structure"),
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
def test_every_model_has_a_class_of_structure(spec: str, structure: str) -> None:
    assert structure_of(make_model(spec).fit(example_dataset(episodes=1), rng=0)) == structure


def test_what_is_far_worse_than_the_best_or_diverges_is_dropped_with_the_reason() -> None:
    model = make_model("auto", candidates=[*FEW, "nearest_neighbour", "narx(state_lags=500, control_lags=0)"])
    model.fit(example_dataset(), rng=0)
    rows = {row["candidate"]: row for row in model.standing()}
    assert rows[FEW[0]]["weight"] == "1.00"
    assert rows["linear(state_lags=0)"]["remark"].endswith("x the best in the first of 3 turns")
    assert "of its free runs diverge" in rows["nearest_neighbour"]["remark"]
    assert "no episode is longer than 500 steps" in rows["narx(state_lags=500, control_lags=0)"]["remark"]
    assert "kept 1 of 4 candidates" in model.fit_note
    assert "every other candidate fell out in the first turn" in model.fit_note


def test_what_is_far_behind_in_the_first_turn_is_fitted_once_and_else_in_every_turn() -> None:
    """With a wide gate the same candidate is judged in all turns."""
    for gate, remark in ((1.25, "5.2 x the best in the first of 3 turns"), (5.0, "above")):
        model = make_model("auto", candidates=FEW, gate=gate)
        model.fit(example_dataset(), rng=0)
        row = next(row for row in model.standing() if row["candidate"] == "linear(state_lags=0)")
        assert row["remark"].startswith(remark)
    assert "do differ significantly" in model.fit_note


def test_what_may_be_behind_by_chance_is_judged_in_every_turn() -> None:
    """In the first turn of few data one candidate is 1.3 times as far off as the best, another 1.7 times, by chance."""
    near = "linear(state_lags=1, control_lags=2)"
    model = make_model("auto", candidates=["linear(state_lags=0)", near, "nearest_neighbour"], gate=1.0)
    model.fit(example_dataset(seed=1, episodes=1, steps=130), rng=0)
    remarks = {row["candidate"]: row["remark"] for row in model.standing()}
    assert remarks[near] == "1.3 x the best in the first of 3 turns"
    assert remarks["nearest_neighbour"] == "above 1.00 x the best"


def test_if_nothing_can_be_fitted_the_reasons_are_told() -> None:
    with pytest.raises(InvalidData, match=r"got none: narx\(state_lags=500.*no episode is longer"):
        make_model("auto", candidates=["narx(state_lags=500, control_lags=0)"]).fit(example_dataset(), rng=0)


def test_if_no_candidate_can_describe_the_system_the_reasons_are_told() -> None:
    turning = System((Channel("angle", "rad", period=2.0 * np.pi),), (Channel("u", low=-1.0, high=1.0),), dt=0.05)
    data = Dataset.from_arrays(turning, [np.zeros((50, 1))], [np.zeros((49, 1))])
    with pytest.raises(IncompatibleSystem, match=r"got none: linear.*it is not periodic, and angle comes round"):
        make_model("auto", candidates=["linear"]).fit(data, rng=0)


def test_auto_is_no_candidate_of_itself() -> None:
    with pytest.raises(InvalidArgument, match="would try itself"):
        make_model("auto", candidates=["linear", "auto"]).fit(example_dataset(), rng=0)


def test_the_gate_is_narrowed_where_the_mean_of_more_is_worse() -> None:
    errors = [0.30, 0.20, 0.24, 0.9]
    for mean_error, kept, gate in (
        ((0.20, 0.20), [0, 1, 2], 1.5),
        ((0.21, 0.19), [1, 2], 1.25),
        ((0.25, 0.25), [1], 1.125),
    ):
        group, passed = chosen(errors, 1.5, lambda group, e=mean_error: e[0 if len(group) == 3 else 1])
        assert (group, passed.gate) == (kept, gate)
        assert dict(passed.compared) == {1.5: mean_error[0], 1.25: mean_error[1], 1.125: 0.20, 1.0: 0.20}


def test_what_is_as_good_as_the_best_for_all_that_is_known_is_kept_by_every_gate_but_the_widest() -> None:
    group, _ = chosen([0.30, 0.20, 0.24, 0.9], 1.5, lambda group: 0.1 * len(group), ties=[1, 2, 3])
    assert group == [1, 2], "the last is outside the widest gate"


def test_whole_recordings_are_held_out_and_blocks_of_time_of_a_single_one() -> None:
    data = example_dataset(episodes=4)
    pairs = folds_of(data, 3)
    assert [set(seen.names) & set(held.names) for seen, held in pairs] == [set()] * 3
    assert sorted(name for _, held in pairs for name in held.names) == sorted(data.names)
    pieces = data.with_episodes([data.episodes[0][:100], data.episodes[0][100:], data.episodes[1]])
    assert [len(held) for _, held in folds_of(pieces, 3)] == [2, 1], "pieces of one recording stay together"
    assert balanced(["a", "b", "c", "d"], [100, 30, 30, 60], 3) == [["a"], ["b", "c"], ["d"]]
    assert balanced(["a1", "a2", "b1", "b2"], [50] * 4, 2) == [["a1", "b1"], ["a2", "b2"]], "neighbours are parted"
    single = folds_of(data[0], 3)
    assert [seen.n_steps + held.n_steps for seen, held in single] == [200] * 3
    assert horizons_of(single, [10, 20, 60]) == [10, 20]


def test_a_plugin_that_declares_a_structure_is_a_candidate(register):
    class Zero(DynamicsModel):
        """The state stays as it is."""

        structure = "nothing moves"

        def fit(self, dataset: Any, *, rng: Any, progress: Any = None) -> Any:
            return self

        def acceleration(self, carry: Any, control: Any) -> Any:
            return 0.0 * carry

    register(models, "made_up_zero", Zero)
    data = example_dataset()
    assert offered(data.system)[0][0].spec.name == "made_up_zero"
    model = make_model("auto", candidates=["made_up_zero"]).fit(data, rng=0)
    assert structure_of(model.members_[0]) == "nothing moves"  # type: ignore[attr-defined]  # it is an Auto


def test_an_error_is_that_of_free_runs_and_a_copy_is_no_significant_improvement() -> None:
    """A model that is right has no error, one that stands still has that of the spread of the changes."""
    data = example_dataset()
    (_, held), *_ = folds_of(data, 3)
    trial = HeldOutTest.of(held, [1, 10], 2)
    judge = Judge.of(data, [trial])
    still = judge.errors([np.repeat(trial.windows.start_states[:, None], 2, axis=1)])
    assert judge.errors([trial.truth]).mean == 0.0
    off = data.system.difference(np.repeat(trial.windows.start_states[:, None], 2, axis=1), trial.truth)
    np.testing.assert_allclose(still.at, np.sqrt((off**2).mean(axis=0) / judge.spread**2).mean(axis=1))
    close = judge.errors([trial.truth + 0.01])
    assert interval(close, still)[0] > 0.0
    shifted = judge.errors([trial.truth - 0.01])
    np.testing.assert_allclose(interval(close, shifted), 0.0, atol=1e-12)


def test_with_noise_the_intervals_hold_most_of_what_was_held_out() -> None:
    model = learned(stochastic=True)
    assert model.n_noise == 3
    assert model.kernel() is None
    windows = example_dataset(seed=9).windows(20, stride=20, history=model.n_lags)
    drawn = model.simulate(windows.past_states, windows.past_controls, windows.controls, samples=60, rng=1)
    low, high = np.quantile(drawn[:, :, -1], [0.05, 0.95], axis=0)
    inside = ((windows.states[:, -1] >= low) & (windows.states[:, -1] <= high)).mean()
    assert 0.75 < inside <= 1.0


def test_what_progress_raises_is_no_failure_of_a_candidate() -> None:
    class Enough(Exception):
        pass

    once = iter([Enough()])

    def progress(done: int, total: int, note: str = "") -> None:
        if done and (stop := next(once, None)) is not None:
            raise stop

    with pytest.raises(Enough):
        make_model("auto", candidates=["sindy(lag_search=few)", *FEW]).fit(example_dataset(), rng=0, progress=progress)


def test_a_process_that_fits_candidates_loads_what_is_installed_and_does_without_the_rest() -> None:
    load(["json", "no_such_library"])
    here = "import sys; from model_zoo.auto.fitting import LARGE, load; load(LARGE); print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", here], capture_output=True, text=True, check=True).stdout.split()
    assert {name for name in LARGE if importlib.util.find_spec(name)} <= set(loaded)


@pytest.mark.nightly
def test_the_model_is_the_same_for_any_number_of_processes() -> None:
    data = example_dataset()
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
        for mine, other in zip(here.weights_, there.weights_, strict=True):  # type: ignore[attr-defined]  # a network
            np.testing.assert_array_equal(mine, other)


@pytest.mark.parametrize("chooses", [True, False])
def test_what_chooses_among_families_does_not_choose_anew_for_an_adaptation(chooses: bool) -> None:
    class Choosing(Linear):
        pass

    Choosing.chooses = chooses
    data = example_dataset()
    few = data.with_episodes([data.episodes[0][:200]])
    model = Choosing().fit(few, rng=0)
    tried = [trial.name for trial in adaptation(model, few, rng=np.random.default_rng(0)).verdict.trials]
    assert tried
    assert (ANEW in tried) == (not chooses)
    assert Auto.chooses


def test_what_was_held_out_tells_how_far_off_it_is_at_home_and_there_nothing_is_adapted(tmp_path: Path) -> None:
    """The mean of what learned without each fold runs free there, with the weights of the whole."""
    data, model = example_dataset(), learned()
    means = []
    for seen, held in folds_of(data, model.folds):
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
    assert "nothing much has shifted" in adapted.fit_note
    assert learned(stochastic=True).held_out_error_ is not None


def shares_of(model: Auto) -> list[float]:
    """Return the weights of the candidates that it had, in the order in which they were named."""
    return [float(model.shares_[model.candidates_.index(name)]) for name in FEW]


def test_where_nothing_was_held_out_it_does_not_know_how_far_off_it_is() -> None:
    data = example_dataset()
    short = data.with_episodes([data.episodes[0][:40]])
    assert folds_of(short, 3)[0][0] is short
    model = make_model("auto", candidates=["linear"], horizons=[5]).fit(short, rng=0)
    assert model.held_out_error_ is None
