"""Choosing among finalists by models of other families, and polishing the chosen."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from sysid_evo.engine import Rollouts
from sysid_evo.errors import InvalidArgument
from sysid_evo.evolution import Champion, ControllerEvolution, Finalist, choose, polish
from sysid_evo.evolution.selection import score_finalists
from sysid_evo.registry import Spec
from sysid_evo.testing.examples import switched_car

CONTROLLER = Spec("recurrent", {"hidden": 1})
N = 5 + 1 + 2


@dataclass
class Hill:
    """A runner on which fitness falls with the distance of the first parameter from ``peak``."""

    peak: float
    height: float = 10.0
    met: int = 0

    def bind(self, controller, task):
        def run(parameters, seeds):
            self.met = len(seeds)
            fitness = np.repeat(self.height - np.abs(parameters[:, :1] - self.peak), len(seeds), axis=1)
            steps = np.zeros(fitness.shape, dtype=np.int64)
            return Rollouts(fitness, steps, steps, task.begin(seeds), "made up")

        return run


def finalist(first, fitness, niche=""):
    return Finalist(niche, 0, fitness, np.array([first, *np.zeros(N - 1)]))


def champion(name, *finalists):
    best = max(finalists, key=lambda one: one.fitness)
    return Champion(
        name, best.parameters, (name,), "min", 0, np.empty((0, 3)),
        controller=CONTROLLER, system=switched_car(), finalists=finalists,
    )  # fmt: skip


def test_not_the_claim_counts_but_the_median_on_models_of_other_families():
    mine = champion("mine", finalist(0.0, fitness=99.0, niche="boasts"), finalist(3.0, fitness=5.0, niche="modest"))
    others = {"a": Hill(3.0), "b": Hill(4.0), "c": Hill(-50.0)}
    best = choose([(mine, others)], seed=1)
    assert best.parameters[0] == 3.0
    assert best.name == "mine"
    assert best.scoring_models == ("a", "b", "c")
    assert [(one.behaviour_class, one.forecast) for one in best.finalists] == [("boasts", 6.0), ("modest", 9.0)]
    assert [one.fitness for one in best.finalists] == [99.0, 5.0]
    assert others["a"].met == 100


def test_of_several_champions_each_is_scored_on_its_own_models():
    first, second = champion("first", finalist(0.0, 7.0)), champion("second", finalist(1.0, 6.0))
    best = choose([(first, {"second": Hill(1.0)}), (second, {"first": Hill(1.5)})], seed=1, trials=3)
    assert (best.name, best.parameters[0]) == ("second", 1.0)
    assert [one.forecast for one in best.finalists] == [9.0, 9.5]


def test_a_choice_among_different_controllers_keeps_the_finalists_of_its_own_kind_and_can_be_polished():
    longer = Finalist("", 0, 7.0, np.zeros(N + 6))
    other = Champion(
        "other", longer.parameters, ("other",), "min", 0, np.empty((0, 3)),
        controller=Spec("recurrent", {"hidden": 2}), system=switched_car(), finalists=(longer,),
    )  # fmt: skip
    mine, on = champion("mine", finalist(1.0, 6.0), finalist(2.0, 6.0)), {"model": Hill(1.0)}
    best = choose([(other, on), (mine, on)], seed=1, trials=3)
    assert (best.name, [len(one.parameters) for one in best.finalists]) == ("mine", [N, N])
    assert polish("p", best, on, ControllerEvolution(trials=1), seed=0, generations=1).controller == CONTROLLER


def test_without_scoring_models_the_fittest_is_chosen_and_a_scored_one_has_priority():
    alone = champion("alone", finalist(0.0, 7.0), finalist(1.0, 8.0))
    assert score_finalists(alone, {}, seed=1) is alone
    assert choose([(alone, {})], seed=1).parameters[0] == 1.0
    judged = champion("judged", finalist(2.0, 1.0))
    assert choose([(alone, {}), (judged, {"other": Hill(2.0, height=-3.0)})], seed=1).name == "judged"
    with pytest.raises(InvalidArgument, match="expected at least one champion"):
        choose([], seed=1)


SETTINGS = ControllerEvolution(
    trials=2, selection_trials=4, aggregate="min", controller=CONTROLLER, task=Spec("point_to_point", {"horizon": 5})
)


def test_a_polish_climbs_to_the_place_where_the_lowest_model_is_highest():
    start = champion("start", finalist(0.0, 9.0, "left"), finalist(-30.0, 1.0, "far"))
    told = []
    better = polish(
        "better", start, {"a": Hill(0.0), "b": Hill(2.0)}, SETTINGS,
        seed=3, starts=1, generations=60, progress=lambda done, total, _="": told.append((done, total)),
    )  # fmt: skip
    assert better.parameters[0] == pytest.approx(1.0, abs=0.05)
    assert (better.name, better.against, better.aggregate) == ("better", ("a", "b"), "min")
    assert 20 < len(better.history) < 60  # all candidates are there long before
    assert told == [(i, 60) for i in range(1, len(better.history) + 1)]
    (only,) = better.finalists
    assert (only.behaviour_class, only.forecast) == ("polished left", None)
    assert only.fitness == pytest.approx(9.0, abs=0.05)
    assert better.scoring_models == ()


def test_the_best_finalists_are_polished_and_one_without_an_improvement_stays():
    start = champion(
        "start",
        replace(finalist(-9.0, 50.0, "boasts"), forecast=1.0),
        replace(finalist(1.0, 5.0, "good"), forecast=9.0),
        replace(finalist(3.0, 4.0, "next"), forecast=8.0),
    )
    best = polish("best", start, {"a": Hill(1.0), "b": Hill(1.0)}, SETTINGS, seed=3, starts=2, generations=1)
    assert [one.behaviour_class for one in best.finalists] == ["polished good", "polished next"]
    assert best.parameters[0] == 1.0


def test_without_finalists_there_is_nothing_to_polish():
    person = replace(champion("anna", finalist(0.0, 1.0)), finalists=())
    with pytest.raises(InvalidArgument, match="'anna' has no finalists"):
        polish("x", person, {"a": Hill(0.0)}, SETTINGS, seed=0)


def test_a_model_that_underrates_the_best_finalist_is_left_out_of_the_polish():
    start = champion("start", finalist(1.0, 9.0))
    heights = {"a": 10.0, "denies": 6.6, "b": 9.5, "doubts": 6.7, "c": 10.0}  # 70 % of the median is 6.65
    runners = {name: Hill(1.0, height) for name, height in heights.items()}
    best = polish("best", start, runners, SETTINGS, seed=3, generations=1)
    assert best.against == ("a", "b", "doubts", "c")
