"""Covariance matrix adaptation as a strategy."""

from __future__ import annotations

import numpy as np
import pytest

from sysid_evo.arrays import Array
from sysid_evo.errors import InvalidArgument, ShapeError
from sysid_evo.evolution import CmaEs, evolve
from sysid_evo.evolution.cma_search import CmaSearch
from sysid_evo.testing import check_strategy


def valley(population: Array, _: int = 0) -> Array:
    """A hill in a narrow rotated valley, 1,000 times as steep across as along; the peak is at 1, 1, ..."""
    off = population - 1.0
    along = off.mean(axis=1, keepdims=True)
    return -(1e3 * ((off - along) ** 2).sum(axis=1) + along[:, 0] ** 2)


def test_it_keeps_the_contract() -> None:
    check_strategy("cma_es")


def test_it_finds_the_end_of_a_narrow_valley() -> None:
    strategy = CmaEs(n_parameters=6, seed=1, population=20)
    for _ in evolve(strategy, valley, 150):
        pass
    np.testing.assert_allclose(strategy.elite[0], 1.0, atol=0.01)


def test_the_mean_is_asked_with_the_candidates_and_is_part_of_the_elite() -> None:
    start = np.array([2.0, -1.0, 0.5])
    strategy = CmaEs(n_parameters=3, seed=1, population=20, sigma=0.5, initial=start)
    population = strategy.ask()
    assert population.shape == (21, 3)
    np.testing.assert_array_equal(population[-1], start)
    fitness = np.arange(21.0)[::-1]  # the mean is the worst of all
    strategy.tell(population, fitness)
    assert len(strategy.elite) == 16
    np.testing.assert_array_equal(strategy.elite[0], population[0])
    np.testing.assert_array_equal(strategy.elite[-1], start)


def test_the_mean_teaches_it_nothing() -> None:
    first, second = CmaEs(n_parameters=3, seed=1), CmaEs(n_parameters=3, seed=1)
    for strategy, of_mean in ((first, 0.0), (second, 1e6)):
        population = strategy.ask()
        strategy.tell(population, np.append(valley(population[:-1]), of_mean))
    np.testing.assert_array_equal(first.ask(), second.ask())


def test_it_starts_as_wide_as_it_is_told() -> None:
    drawn = CmaEs(n_parameters=5, seed=3, population=400, sigma=2.0).ask()[:-1]
    np.testing.assert_allclose(drawn.std(axis=0), 2.0, rtol=0.15)


def test_the_global_random_state_is_neither_read_nor_changed() -> None:
    np.random.seed(1)  # noqa: NPY002  # the library's own source, which must not be in use
    first = CmaEs(n_parameters=3, seed=1).ask()
    before = np.random.get_state()[1].copy()  # type: ignore[union-attr, call-overload]  # noqa: NPY002
    second = CmaEs(n_parameters=3, seed=1).ask()
    np.testing.assert_array_equal(first, second)
    np.testing.assert_array_equal(before, np.random.get_state()[1])  # type: ignore[call-overload]  # noqa: NPY002


def test_what_cannot_be_searched_is_refused() -> None:
    for wrong in ({"population": 3}, {"sigma": 0.0}, {"sigma": np.inf}):
        with pytest.raises(InvalidArgument, match="cma_es: expected n_parameters >= 1, population >= 4, sigma > 0"):
            CmaEs(n_parameters=2, seed=0, **wrong)  # type: ignore[arg-type]  # wrong on purpose
    with pytest.raises(ShapeError, match="initial"):
        CmaEs(n_parameters=2, seed=0, initial=np.zeros(3))
    strategy = CmaEs(n_parameters=2, seed=0)
    with pytest.raises(InvalidArgument, match="expected 51 candidates, got 50"):
        strategy.tell(strategy.ask()[:-1], np.zeros(50))
    with pytest.raises(InvalidArgument, match="expected a state with axes, covariance"):
        strategy.restore({"generation": 1})


def test_the_sampler_learns_what_that_of_the_library_learns_and_finds_its_axes_less_often(
    rng: np.random.Generator,
) -> None:
    from cma.sampler import GaussFullSampler

    from sysid_evo.evolution.gaussian_sampler import GaussianSampler

    own, library = (kind(5, randn=rng.standard_normal) for kind in (GaussianSampler, GaussFullSampler))
    for _ in range(8):
        vectors, weights = rng.standard_normal((6, 5)), [0.05, 0.04, 0.02, 0.0, -0.02, -0.03]
        for sampler in (own, library):
            sampler.update(list(vectors), weights, 0.01)
            sampler.update_now()
    np.testing.assert_allclose(own.C, library.C, rtol=1e-10)
    strategy = CmaEs(n_parameters=60, seed=1)
    for _ in evolve(strategy, valley, 20):
        pass
    assert 2 <= strategy._search.sm.count_eigen <= 10


@pytest.mark.parametrize(("n", "population"), [(1, 4), (2, 7), (5, 50), (40, 9), (30, 200)])
def test_it_learns_bit_by_bit_what_the_library_learns(n: int, population: int, monkeypatch: pytest.MonkeyPatch) -> None:
    def way() -> list[dict[str, object]]:
        strategy, states = CmaEs(n_parameters=n, seed=3, population=population), []
        for generation in range(40):
            candidates = strategy.ask()
            luck = np.random.default_rng(generation).standard_normal(len(candidates))
            strategy.tell(candidates, np.round(luck - np.abs(candidates - 1.0).sum(axis=1), 1))
            states.append(dict(strategy.state))
        return states

    own = way()
    monkeypatch.setattr(CmaSearch, "learn", lambda self, asked, costs: self.tell(asked, costs.tolist(), False))
    for one, other in zip(own, way(), strict=True):
        assert one.keys() == other.keys()
        for name, value in one.items():
            np.testing.assert_array_equal(value, other[name], err_msg=name)
