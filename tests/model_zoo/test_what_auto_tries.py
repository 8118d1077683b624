"""What `auto` tries for its budget: candidates in turn, refinements of those that stand well, committees."""

from __future__ import annotations

import numpy as np
import pytest

from model_zoo.auto.candidates import NUMBERS, SHIPPED, STEPS, Candidate, named, offered
from model_zoo.auto.fitting import FitWork
from model_zoo.auto.model import PROCESSORS, SHARE, Auto
from model_zoo.auto.selection import REFINED, UNPROMISING, UNTRIED, CandidateChoice, Choosing, affordable
from model_zoo.average import Average
from sysid_evo.models.base import make_model
from sysid_evo.registry import Spec
from sysid_evo.system import System
from sysid_evo.testing import example_dataset
from sysid_evo.validation.folds import folds_of
from sysid_evo.validation.simulation_error import LONGEST_HISTORY, HeldOutTest, Judge, history_of

NARX = "narx(terms=12, state_lags=0, control_lags=2)"


def test_all_that_is_shipped_is_offered_to_a_car() -> None:
    found, left_out = offered(example_dataset().system)
    assert [one.spec for one in found] == [one.spec for one in SHIPPED]
    assert not left_out


@pytest.mark.parametrize(("outputs", "budget"), [(1, 60.0), (2, 60.0), (3, 300.0)])
def test_networks_with_hidden_states_are_tried_of_few_outputs_with_any_budget(outputs: int, budget: float) -> None:
    names = [f"{kind}{i}" for kind in "yu" for i in range(outputs)]
    system = System(tuple(names[:outputs]), tuple(names[outputs:]), dt=0.1)
    found, _ = offered(system)
    costs = {number: one.cost(system, 1500, 3) for number, one in enumerate(found)}
    tried = [found[number].spec.name for number in affordable(costs, PROCESSORS * SHARE * budget)]
    assert "nonlinear_state_space" in tried


@pytest.mark.parametrize(("roughly", "seconds"), [({"members": 2}, 5.0), ({"members": 4}, 8.0), ({}, 8.0)])
def test_a_fit_that_only_judges_is_expected_to_take_less_only_where_it_has_fewer_members(
    roughly: dict[str, int], seconds: float
) -> None:
    """A quarter of the time of four members is not theirs."""
    one = Candidate(Spec("mlp_ensemble", {"members": 4}), 8.0, 0.0, roughly)
    system = example_dataset().system
    size = (system.nx + system.nu) / NUMBERS
    assert one.seconds_for(system, 100, rough=True) == pytest.approx(size * seconds)
    assert one.seconds_for(system, 100, rough=False) == pytest.approx(size * 8.0)


def test_a_small_system_takes_less_time_by_the_share_that_goes_with_its_states_and_controls() -> None:
    """With one state and one control instead of three and two."""
    system, car = System(("y",), ("u",), dt=0.1), System(("a", "b", "c"), ("u", "v"), dt=0.1)
    for share, less in ((0.0, 1.0), (0.3, 0.82), (1.0, 0.4)):
        one = Candidate(Spec("linear"), 8.0, 0.0, widening=share)
        assert one.seconds_for(car, 100, rough=False) == pytest.approx(8.0)
        assert one.seconds_for(system, 100, rough=False) == pytest.approx(8.0 * less)


def test_networks_are_expected_to_take_nearly_as_long_with_one_output_and_state_spaces_far_less() -> None:
    system = System(("y",), ("u",), dt=0.1)
    shares = {one.spec.name: one.seconds_for(system, round(STEPS), rough=False) / one.seconds for one in SHIPPED}
    assert shares["mlp_ensemble"] > 0.75
    assert shares["nonlinear_state_space"] < 0.5


def choice_among(candidates: list[Candidate], budget: float = 100.0) -> CandidateChoice:
    """Return what becomes of these candidates, judged after ten steps."""
    data = example_dataset()
    pairs = folds_of(data, 3)
    judge = Judge.of(data, [HeldOutTest.of(held, [10], 3) for _, held in pairs])
    seeds = np.zeros((len(candidates), 4), dtype=np.int64)
    choosing = Choosing(data, pairs, judge, candidates, seeds, budget, FitWork(None, budget))
    return choosing.choice(1.25, Average.made_of)


@pytest.mark.parametrize(("budget", "tried"), [(2.0, "a"), (8.0, "abd"), (8.7, "abc"), (99.0, "abcd")])
def test_a_budget_is_spent_by_expected_time_and_what_falls_behind_makes_room_for_others(
    budget: float, tried: str
) -> None:
    """Each is expected to take so many seconds four times: in three folds and for all data; b falls behind in one."""
    specs = {"a": (NARX, 1.0), "b": ("linear(state_lags=0)", 1.0)}
    specs |= {"c": ("linear(state_lags=1, ridge=0.1)", 0.9), "d": ("linear(state_lags=2)", 0.7)}
    candidates = [Candidate(Spec.parse(f"{name}={text}"), cost, 0.0) for name, (text, cost) in specs.items()]
    choice = choice_among(candidates, budget)
    assert "".join(one.name for one, error in zip(candidates, choice.errors, strict=True) if error) == tried
    untried = [reason for error, reason in zip(choice.errors, choice.reasons, strict=True) if error is None]
    assert all(reason == UNTRIED for reason in untried)


BEHIND, PLAIN, BROKEN = "linear(state_lags=0)", "narx(terms=6, state_lags=0, control_lags=2)", "narx(state_lags=500)"


@pytest.mark.parametrize(
    ("rough", "better", "budget", "left", "reasons"),
    [
        (PLAIN, PLAIN, 100.0, "ac", ["", REFINED, ""]),
        (PLAIN, NARX, 100.0, "abc", ["", "", ""]),
        (NARX, PLAIN, 100.0, "ac", ["", REFINED, ""]),
        (PLAIN, BEHIND, 100.0, "ab", ["", "", "x the best in the first of 3 turns"]),
        (PLAIN, BROKEN, 100.0, "ab", ["", "", "no episode is longer than 500 steps"]),
        (BEHIND, PLAIN, 100.0, "a", ["", "x the best in the first of 3 turns", UNPROMISING]),
        (PLAIN, PLAIN, 9.0, "ab", ["", "", UNTRIED]),
        (PLAIN, PLAIN, 5.0, "a", ["", UNTRIED, UNPROMISING]),
    ],
)
def test_what_refines_another_is_tried_where_that_one_is_near_the_best_and_takes_its_place_unless_it_is_worse(
    rough: str, better: str, budget: float, left: str, reasons: list[str]
) -> None:
    """The best is a; c refines b; each is expected to take a second four times."""
    first, second = (Candidate(Spec.parse(text), 1.0, 0.0) for text in (f"a={PLAIN}", f"b={rough}"))
    choice = choice_among([first, second, Candidate(Spec.parse(f"c={better}"), 1.0, 0.0, refines=second)], budget)
    assert "".join("abc"[number] for number in choice.kept) == left
    for expected, reason in zip(reasons, choice.reasons, strict=True):
        assert expected in reason
        assert bool(reason) == bool(expected)


@pytest.mark.parametrize(("gate", "folds"), [(3.0, [0, 1, 2]), (1.25, [0, 2])])
def test_a_committee_weighs_as_much_as_a_single_model_and_holds_what_is_as_good_without_a_fold(
    monkeypatch: pytest.MonkeyPatch, gate: float, folds: list[int]
) -> None:
    """Both are polynomials, so each weighs a half; the second is a committee."""
    tried = [Candidate(Spec.parse(f"{name}={PLAIN}"), 1.0, committee=name == "b") for name in "ab"]
    monkeypatch.setattr("model_zoo.auto.model.offered", lambda _: (tried, []))
    data = example_dataset()
    model = make_model("auto", gate=gate).fit(data, rng=0)
    assert isinstance(model, Auto)
    size = len(folds) + 1
    np.testing.assert_allclose(model.weights_, [0.5, *[0.5 / size] * size])
    assert [row["weight"] for row in model.standing()] == ["0.50", "0.50"]
    windows, parts = data.windows(1, history=2), [data, data, *(folds_of(data, 3)[fold][0] for fold in folds)]
    for member, part in zip(model.members_, parts, strict=True):
        again = make_model(PLAIN).fit(part, rng=0)
        now = [one.simulate(windows.past_states, windows.past_controls, windows.controls) for one in (member, again)]
        np.testing.assert_allclose(*now)


def test_what_is_named_is_tried_even_if_it_refines_another() -> None:
    assert any(one.refines for one in SHIPPED)
    found = named(["nonlinear_state_space"])
    assert len(found) == 2
    assert not any(one.refines for one in found)


def test_an_average_that_is_named_alone_is_that_of_its_own_families() -> None:
    (found,) = named(["average"])
    assert found.spec.parameters == {}
    assert any(one.spec.name == "average" and one.refines for one in SHIPPED)


def test_a_refinement_that_is_shipped_stands_behind_what_it_refines() -> None:
    for number, one in enumerate(SHIPPED):
        assert one.refines is None or one.refines in SHIPPED[:number]


def test_free_runs_are_given_a_third_of_what_the_horizon_leaves_as_history() -> None:
    """A model with hidden states needs it; the rest is where runs begin."""
    for steps, horizon, history in ((166, 60, 35), (166, 20, 48), (90, 80, 3), (50, 60, 0), (600, 60, LONGEST_HISTORY)):
        held = example_dataset(episodes=1, steps=steps)
        assert history_of([(held, held)], [10, horizon]) == history
