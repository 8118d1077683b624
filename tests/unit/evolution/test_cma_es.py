"""Covariance matrix adaptation as a strategy."""

import warnings

import cma
import numpy as np
import pytest

from sysid_evo.artefacts import read_checkpoint, write_checkpoint
from sysid_evo.errors import InvalidArgument, ShapeError
from sysid_evo.evolution import evolve
from sysid_evo.evolution.strategies.cma_es import CmaEs, LearningRates


def sphere(population, _=0):
    return -(population**2).sum(axis=1)


def valley(population, _=0):
    """A hill in a narrow rotated valley, 1,000 times as steep across as along; the peak is at 1, 1, ..."""
    off = population - 1.0
    along = off.mean(axis=1, keepdims=True)
    return -(1e3 * ((off - along) ** 2).sum(axis=1) + along[:, 0] ** 2)


def noisy(population, generation):
    """A hill with noise, on steps of a tenth, so that some are equal, and nothing where parameter 0 is above 2."""
    luck = np.random.default_rng(generation).standard_normal(len(population))
    fitness = np.round(luck - np.abs(population - 1.0).sum(axis=1), 1)
    return np.where(population[:, 0] > 2.0, -np.inf, fitness)


def after(strategy, generations, fitness, start=0):
    """Return what it asks until that many generations are over."""
    return [generation.population for generation in evolve(strategy, fitness, generations, start=start)]


def rotation(n, rng):
    return np.linalg.qr(rng.standard_normal((n, n)))[0]


def test_on_a_sphere_it_converges_about_as_fast_as_weighted_recombination_can(rng):
    n, population = 100, 10
    strategy = CmaEs(n_parameters=n, seed=1, population=population, sigma=1.0, initial=np.full(n, 3.0))
    distances = np.array([np.linalg.norm(asked[-1]) for asked in after(strategy, 901, sphere)])
    first, second = np.log(distances[[100, 500]] / distances[[500, 900]]) / 400
    # Arnold, "Weighted multirecombination evolution strategies" (2006): with the best sigma, in many dimensions, the
    # distance shrinks in a generation by exp(-mu_eff c^2 / 2 n), c being the weighted mean of the order statistics.
    # Cumulative adaptation is known to take longer steps than the best.
    rates = LearningRates.of(n, population)
    ordered = np.sort(rng.standard_normal((100_000, population)), axis=1)[:, ::-1].mean(axis=0)
    fastest = rates.mu_eff * (rates.w[: rates.mu] @ ordered[: rates.mu]) ** 2 / (2 * n)
    assert 0.5 * fastest < first < 0.9 * fastest
    assert second == pytest.approx(first, rel=0.2)


def test_the_covariance_becomes_the_inverse_hessian(rng):
    axes = rotation(8, rng)
    hessian = (axes * 1e4 ** np.linspace(0.0, 1.0, 8)) @ axes.T
    strategy = CmaEs(n_parameters=8, seed=1, population=20, sigma=1.0, initial=np.full(8, 3.0))
    after(strategy, 300, lambda x, _: -np.einsum("pi,ij,pj->p", x, hessian, x))
    lengths = np.linalg.eigvals(strategy.state["covariance"] @ hessian).real
    assert lengths.max() / lengths.min() < 10.0  # it was 10,000


def test_ranks_alone_count():
    plain, bent = (CmaEs(n_parameters=5, seed=1, population=10) for _ in range(2))
    for one, other in zip(
        after(plain, 60, sphere), after(bent, 60, lambda x, _: -(np.log1p(-sphere(x)) ** 3)), strict=True
    ):
        np.testing.assert_array_equal(one, other)


def test_it_does_not_matter_where_the_origin_is_nor_how_long_a_unit():
    moved = np.array([5.0, -3.0, 0.0, 2.0, 1.0])
    plain = CmaEs(n_parameters=5, seed=1, population=10, sigma=1.0)
    other = CmaEs(n_parameters=5, seed=1, population=10, sigma=8.0, initial=moved)
    pairs = zip(after(plain, 40, valley), after(other, 40, lambda x, _: valley((x - moved) / 8.0)), strict=True)
    for one, scaled in pairs:
        np.testing.assert_allclose(8.0 * one + moved, scaled, atol=1e-8)


def test_rotated_coordinates_lead_the_same_way_rotated(rng):
    n, turn = 40, rotation(40, rng)
    plain, turned = (CmaEs(n_parameters=n, seed=1, population=8) for _ in range(2))
    turned.restore({**turned.state, "axes": turn})  # of a sphere any axes are; from here on candidates are turned
    for _ in range(int(plain.rates.gap)):  # recomputed eigenvectors may have the opposite sign
        for strategy, back in ((plain, np.eye(n)), (turned, turn)):
            asked = strategy.ask()
            strategy.tell(asked, valley(asked @ back))
    one, other = plain.state, turned.state
    for name in ("mean", "path", "sigma_path"):
        np.testing.assert_allclose(turn @ one[name], other[name], atol=1e-10, err_msg=name)
    np.testing.assert_allclose(turn @ one["covariance"] @ turn.T, other["covariance"], atol=1e-10)
    assert other["sigma"] == pytest.approx(one["sigma"], rel=1e-10)
    assert other["decomposed"] == 0


@pytest.mark.parametrize(
    ("n", "population"), [(2, 4), (2, 7), (3, 5), (5, 50), (10, 10), (30, 200), (40, 9), (60, 50), (100, 20)]
)
def test_it_learns_from_a_generation_what_the_library_learns(n, population):
    strategy = CmaEs(n_parameters=n, seed=3, population=population)
    for generation in range(0, 41, 10):
        after(strategy, generation, noisy, start=int(strategy.state["generation"]))
        before = strategy.state
        asked = strategy.ask()
        costs = np.random.default_rng(generation).standard_normal(population)
        strategy.tell(asked, np.append(-costs, 0.0))
        oracle = _library(before, population)
        oracle.tell(list(asked[:-1]), costs.tolist(), check_points=False)
        own, scale = strategy.state, np.abs(oracle.sm.C).max()
        np.testing.assert_allclose(own["mean"], oracle.mean, rtol=1e-10, atol=1e-10)
        np.testing.assert_allclose(own["path"], oracle.pc, rtol=1e-10, atol=1e-10 * scale**0.5)
        np.testing.assert_allclose(own["sigma_path"], oracle.adapt_sigma.ps, rtol=1e-10, atol=1e-10)
        np.testing.assert_allclose(own["covariance"], oracle.sm.C, rtol=1e-10, atol=1e-10 * scale)
        assert own["sigma"] == pytest.approx(oracle.sigma, rel=1e-10)


def _library(state, population):
    """Return the library's search as it is in this ``state``."""
    options = {"popsize": population, "CMA_mirrors": 0, "verbose": -9}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        search = cma.CMAEvolutionStrategy(state["mean"], state["sigma"], options)
    search.tell(search.ask(), list(range(population)))  # its first cycle sets up what later ones need
    search.mean, search.sigma = state["mean"].copy(), float(state["sigma"])
    search.sm.C, search.sm.B, search.sm.D = (state[name].copy() for name in ("covariance", "axes", "lengths"))
    search.adapt_sigma.ps, search.pc = state["sigma_path"].copy(), state["path"].copy()
    search.sm.lazy_update_gap, search.sm._inverse_root_C = np.inf, None
    search.countiter = int(state["generation"])
    search.adapt_sigma._ps_updated_iteration = search._isotropic_mean_shift_iteration = -1
    norm = search.sm.norm
    search.sm.norm = lambda y: norm(y) - 1e-9  # the library adds that, lest it divide by 0
    search.ask()
    return search


def test_the_axes_are_computed_again_when_the_covariance_may_have_changed_by_one_in_n():
    strategy = CmaEs(n_parameters=60, seed=1)
    found = [strategy.state["decomposed"] for _ in evolve(strategy, valley, 24)]
    assert 2.0 < strategy.rates.gap < 3.0
    assert sorted(set(found)) == [0, *range(3, 25, 3)]


@pytest.mark.parametrize(
    ("n", "population"),
    [(1, 6), (60, 12), *(pytest.param(*sizes, marks=pytest.mark.nightly) for sizes in [(20, 50), (60, 50), (120, 50)])],
)
def test_a_stored_search_continues_bit_for_bit(n, population, tmp_path):
    whole, asked, states = CmaEs(n_parameters=n, seed=3, population=population), [], []
    for generation in evolve(whole, noisy, 40):
        asked.append(generation.population)
        write_checkpoint(tmp_path / str(len(asked)), "search", whole.state)
        states.append(whole.state)
    for done in (1, 2, 3, 4, 5, 6, 7, 8, 20, 39, 40):
        resumed, until = CmaEs(n_parameters=n, seed=3, population=population), min(done + 12, 40)
        resumed.restore(read_checkpoint(tmp_path / str(done))[1])
        for one, other in zip(asked[done:until], after(resumed, until, noisy, start=done), strict=True):
            np.testing.assert_array_equal(one, other, err_msg=f"resumed after {done} generations")
        for name, value in states[until - 1].items():
            np.testing.assert_array_equal(value, resumed.state[name], err_msg=name)


def test_it_finds_the_end_of_a_narrow_valley():
    strategy = CmaEs(n_parameters=6, seed=1, population=20)
    after(strategy, 150, valley)
    np.testing.assert_allclose(strategy.elite[0], 1.0, atol=0.01)


@pytest.mark.parametrize("population", [4, 7, 50])
def test_one_parameter_is_enough(population):
    strategy = CmaEs(n_parameters=1, seed=1, population=population)
    after(strategy, 200, lambda x, _: -np.abs(x[:, 0] - 5.0))
    np.testing.assert_allclose(strategy.elite[0], 5.0, atol=1e-6)


@pytest.mark.parametrize(
    ("n", "population", "generations"),
    [
        (2, 6, 1200),
        *(
            pytest.param(*sizes, 2000, marks=pytest.mark.nightly)
            for sizes in [(1, 4), (1, 10), (2, 6), (2, 50), (10, 4), (10, 200)]
        ),
    ],
)
@pytest.mark.parametrize("fitness", [sphere, lambda x, _: x[:, 0], lambda x, _: np.zeros(len(x))])
def test_candidates_stay_finite_long_after_there_is_something_to_find(fitness, n, population, generations):
    strategy = CmaEs(n_parameters=n, seed=1, population=population, initial=np.ones(n))
    with np.errstate(over="raise", invalid="raise", divide="raise"):
        for asked in after(strategy, generations, fitness):
            assert np.isfinite(asked).all()
    state = strategy.state
    assert np.linalg.eigvalsh(state["covariance"]).min() > 0.0
    assert all(np.isfinite(value).all() for value in state.values())


def test_what_failed_ranks_last_and_may_be_all():
    first, second = (CmaEs(n_parameters=3, seed=1, population=10) for _ in range(2))
    for strategy, failed in ((first, -np.inf), (second, -1e9)):
        after(strategy, 20, lambda x, _, failed=failed: np.where(x[:, 0] > 0.5, failed, sphere(x)))
    np.testing.assert_array_equal(first.ask(), second.ask())
    deviation = CmaEs(n_parameters=3, seed=1)
    after(deviation, 100, lambda x, _: np.full(len(x), -np.inf))
    assert 0.3 < deviation.ask().std() < 30.0  # where nothing is known, it neither contracts nor leaves


def test_the_mean_is_asked_with_the_candidates_and_is_part_of_the_elite():
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


def test_the_mean_teaches_it_nothing():
    first, second = CmaEs(n_parameters=3, seed=1), CmaEs(n_parameters=3, seed=1)
    for strategy, of_mean in ((first, 0.0), (second, 1e6)):
        population = strategy.ask()
        strategy.tell(population, np.append(valley(population[:-1]), of_mean))
    np.testing.assert_array_equal(first.ask(), second.ask())


def test_it_starts_with_the_given_width():
    drawn = CmaEs(n_parameters=5, seed=3, population=400, sigma=2.0).ask()[:-1]
    np.testing.assert_allclose(drawn.std(axis=0), 2.0, rtol=0.15)


def test_it_starts_with_steps_of_their_own_sizes_and_learns_others():
    steps = np.array([1.0, 0.1, 10.0])
    strategy = CmaEs(n_parameters=3, seed=3, population=400, sigma=2.0, first_steps=steps)
    np.testing.assert_allclose(strategy.ask()[:-1].std(axis=0), 2.0 * steps, rtol=0.15)
    equal, usual = CmaEs(n_parameters=3, seed=3, first_steps=np.ones(3)), CmaEs(n_parameters=3, seed=3)
    for _ in range(4):
        population = usual.ask()
        np.testing.assert_array_equal(equal.ask(), population)
        for one in (equal, usual):
            one.tell(population, sphere(population))
    uneven = CmaEs(n_parameters=3, seed=3, first_steps=steps)
    for _ in evolve(uneven, valley, 150):
        pass
    assert valley(uneven.elite).max() > -1e-6


def test_the_global_random_state_is_neither_read_nor_changed():
    np.random.seed(1)  # noqa: NPY002  # the global source, which must not be in use
    first = CmaEs(n_parameters=3, seed=1).ask()
    before = np.random.get_state()[1].copy()  # noqa: NPY002
    second = CmaEs(n_parameters=3, seed=1).ask()
    np.testing.assert_array_equal(first, second)
    np.testing.assert_array_equal(before, np.random.get_state()[1])  # noqa: NPY002


def test_what_cannot_be_searched_is_refused():
    for wrong in ({"population": 3}, {"sigma": 0.0}, {"sigma": np.inf}):
        with pytest.raises(InvalidArgument, match="cma_es: expected n_parameters >= 1, population >= 4, sigma > 0"):
            CmaEs(n_parameters=2, seed=0, **wrong)
    with pytest.raises(ShapeError, match="initial"):
        CmaEs(n_parameters=2, seed=0, initial=np.zeros(3))
    with pytest.raises(ShapeError, match="first_steps"):
        CmaEs(n_parameters=2, seed=0, first_steps=np.ones(3))
    strategy = CmaEs(n_parameters=2, seed=0)
    with pytest.raises(InvalidArgument, match="expected 51 candidates, got 50"):
        strategy.tell(strategy.ask()[:-1], np.zeros(50))
    with pytest.raises(InvalidArgument, match="expected a state with axes, covariance"):
        strategy.restore({"generation": 1})
