"""Selection by several models at once."""

from __future__ import annotations

import numpy as np
import pytest

from sysid_evo import extras
from sysid_evo.arrays import Array
from sysid_evo.errors import InvalidArgument, MissingExtra, ShapeError
from sysid_evo.evolution import Scores, evolve
from sysid_evo.evolution.nsga2 import Nsga2, best_first
from sysid_evo.testing import check_strategy


def two_peaks(population: Array, _: int = 0) -> Scores:
    """On one model the peak is at -1 in every parameter, on the other at +1."""
    by_model = np.stack([-((population - peak) ** 2).sum(axis=1) for peak in (-1.0, 1.0)])
    return Scores(by_model.min(axis=0), by_model=by_model)


def test_it_keeps_the_contract() -> None:
    check_strategy("nsga2")


def test_whom_nobody_beats_on_all_models_stands_first_and_the_lonely_before_the_crowded() -> None:
    #                     0    1    2    3    4    5
    objectives = np.array([
        [0.0, 1.0, 1.1, 4.0, 1.0, 0.0],
        [4.0, 3.0, 2.9, 0.0, 2.0, 0.0],
    ])  # fmt: skip
    order = best_first(objectives).tolist()
    assert set(order[:2]) == {0, 3}  # the ends of the first front
    # of 1 and 2 the one with more room: (1.1 / 4 + 1.1 / 4) / 2 against (3 / 4 + 3 / 4) / 2
    assert order[2:] == [2, 1, 4, 5]


def test_a_candidate_without_bounds_does_not_disturb_the_others() -> None:
    order = best_first(np.array([[-np.inf, 1.0, 2.0], [np.inf, 1.0, 0.0]])).tolist()
    assert sorted(order) == [0, 1, 2]


def test_it_keeps_what_is_good_on_either_model_and_what_lies_between() -> None:
    strategy = Nsga2(n_parameters=2, seed=1, population=20)
    for _ in evolve(strategy, two_peaks, 60):
        pass
    scores = two_peaks(strategy.elite)
    assert scores.by_model is not None
    assert (scores.by_model.max(axis=1) > -0.05).all()  # somebody at each peak
    np.testing.assert_allclose(strategy.elite[0], 0.0, atol=0.15)  # the minimum is highest between them
    assert (np.diff(scores.fitness) <= 0.0).all()


def test_by_the_fitness_alone_all_go_where_the_minimum_is_highest() -> None:
    strategy = Nsga2(n_parameters=2, seed=1, population=20)
    for _ in evolve(strategy, lambda population, _: two_peaks(population).fitness, 60):
        pass
    np.testing.assert_allclose(strategy.elite, 0.0, atol=0.4)


def test_a_model_that_was_not_run_does_not_count() -> None:
    asked, told = (Nsga2(n_parameters=2, seed=1, population=4) for _ in range(2))
    fitness, missing = np.array([1.0, 4.0, 3.0, 2.0]), np.full(4, np.nan)
    asked.tell(asked.ask(), fitness)
    told.tell(told.ask(), fitness, by_model=np.stack([missing, fitness]))
    np.testing.assert_array_equal(asked.ask(), told.ask())
    none = Nsga2(n_parameters=2, seed=1, population=4)
    none.tell(none.ask(), fitness, by_model=missing[None])
    np.testing.assert_array_equal(asked.ask(), none.ask())


def test_what_makes_no_sense_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    strategy = Nsga2(n_parameters=2, seed=1, population=4)
    with pytest.raises(ShapeError, match="by_model"):
        strategy.tell(strategy.ask(), np.zeros(4), by_model=np.zeros((2, 3)))
    with pytest.raises(InvalidArgument, match="nsga2: expected a state with generation, parents and fitness"):
        strategy.restore({"generation": 1})
    with pytest.raises(InvalidArgument, match="nsga2: expected n_parameters >= 1, population >= 2"):
        Nsga2(n_parameters=2, seed=1, population=1)
    monkeypatch.setattr(extras, "find_spec", lambda module: None)
    with pytest.raises(MissingExtra, match=r"strategy 'nsga2' needs .* pip install \"sysid-evo\[evolution\]\""):
        Nsga2(n_parameters=2, seed=1)
