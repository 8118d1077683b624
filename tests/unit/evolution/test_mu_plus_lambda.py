"""The paper's strategy on functions whose answer is known."""

import numpy as np
import pytest

from sysid_evo.errors import InvalidArgument, ShapeError
from sysid_evo.evolution import evolve
from sysid_evo.evolution.strategies.mu_plus_lambda import MuPlusLambda


def sphere(population, _=0):
    return -np.sum(population**2, axis=1)


@pytest.mark.parametrize("reevaluate", [True, False])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_it_converges_on_a_sphere_as_far_as_its_step_size_allows(seed, reevaluate):
    """A mutation of deviation sigma at distance R changes R^2 by 2 R sigma z + sigma^2 chi^2_n, z normal.

    The better half of all z has a mean of 0.8, chi^2_n one of n: the better half comes nearer on
    average as long as R > n sigma / 1.6. That the best are never lost can only add to it. From a
    distance of 6.7 at 0.8 sigma a generation the way takes 80 generations or fewer.
    """
    n, sigma = 5, 0.1
    strategy = MuPlusLambda(n_parameters=n, seed=seed, sigma=sigma, initial=np.full(n, 3.0), reevaluate=reevaluate)
    assert np.linalg.norm(strategy.elite, axis=1).min() > 4.0
    for _ in evolve(strategy, sphere, 80):
        pass
    assert np.linalg.norm(strategy.elite[0]) < n * sigma / 1.6


def test_the_elite_are_the_best_of_parents_and_children_best_first():
    strategy = MuPlusLambda(n_parameters=3, seed=1, parents=4, children=7)
    for _ in range(3):
        population = strategy.ask()
        fitness = sphere(population)
        strategy.tell(population, fitness)
        np.testing.assert_array_equal(sphere(strategy.elite), np.sort(fitness)[::-1][:4])


def test_without_reevaluation_the_best_never_gets_worse_however_noisy_the_fitness():
    rng = np.random.default_rng(0)
    strategy = MuPlusLambda(n_parameters=3, seed=1, parents=6, children=6, reevaluate=False)
    kept, best = {}, []
    for generation in evolve(strategy, lambda p, _: sphere(p) + rng.standard_normal(len(p)), 40):
        kept.update({x.tobytes(): f for x, f in zip(generation.population, generation.fitness, strict=True)})
        elite = [kept[x.tobytes()] for x in strategy.elite]
        assert elite == sorted(elite, reverse=True)
        best.append(elite[0])
    assert best == sorted(best)
    assert best[-1] > best[0]


def test_with_reevaluation_a_lucky_draw_does_not_last():
    """All candidates are equal except for luck in the first generation, which does not count afterwards."""
    strategy = MuPlusLambda(n_parameters=2, seed=1, parents=2, children=2)
    population = strategy.ask()
    strategy.tell(population, np.array([0.0, 9.0, 0.0, 0.0]))
    lucky = population[1]
    np.testing.assert_array_equal(strategy.elite[0], lucky)
    strategy.tell(strategy.ask(), np.array([-1.0, 0.0, 0.0, 0.0]))
    assert not (strategy.elite == lucky).all(axis=1).any()


def test_parents_are_asked_again_only_with_reevaluation():
    for reevaluate, sizes in ((True, [8, 8, 8]), (False, [8, 5, 5])):
        strategy = MuPlusLambda(n_parameters=4, seed=1, parents=3, children=5, reevaluate=reevaluate)
        for size in sizes:
            population = strategy.ask()
            assert population.shape == (size, 4)
            strategy.tell(population, sphere(population))
            assert strategy.elite.shape == (3, 4)


def test_parents_come_first_and_have_children_in_turn():
    strategy = MuPlusLambda(n_parameters=3, seed=1, parents=2, children=5, sigma=1e-9, spread=1.0)
    population = strategy.ask()
    np.testing.assert_array_equal(population[:2], strategy.elite)
    np.testing.assert_allclose(population[2:], strategy.elite[[0, 1, 0, 1, 0]], atol=1e-8)


def test_asking_twice_gives_the_same_population():
    strategy = MuPlusLambda(n_parameters=3, seed=1)
    np.testing.assert_array_equal(strategy.ask(), strategy.ask())


@pytest.mark.parametrize("seed", [0, 1, 2**32 - 1])
def test_a_mutation_depends_on_seed_generation_and_child_alone(seed):
    """Two runs with other starts, sizes and fitnesses add the same numbers to the bearers."""
    rng = np.random.default_rng(7)
    few = MuPlusLambda(n_parameters=3, seed=seed, parents=4, children=4, initial=np.array([5.0, 0.0, -5.0]))
    many = MuPlusLambda(n_parameters=3, seed=seed, parents=4, children=7, spread=0.0)
    for _ in range(3):
        a, b = few.ask(), many.ask()
        np.testing.assert_allclose(a[4:] - a[:4], (b[4:] - b[[0, 1, 2, 3, 0, 1, 2]])[:4], atol=1e-12)
        few.tell(a, rng.standard_normal(len(a)))
        many.tell(b, rng.standard_normal(len(b)))


def test_mutations_are_normal_with_the_standard_deviation_sigma():
    strategy = MuPlusLambda(n_parameters=50, seed=1, parents=1, children=400, sigma=0.1, spread=0.0)
    steps = (strategy.ask()[1:] - strategy.elite).ravel()
    n = len(steps)
    assert abs(steps.mean()) < 4 * 0.1 / np.sqrt(n)
    assert abs(steps.std() - 0.1) < 4 * 0.1 / np.sqrt(2 * n)
    assert abs(np.mean(np.abs(steps) < 0.1) - 0.6827) < 4 * np.sqrt(0.6827 * 0.3173 / n)
    strategy.tell(strategy.ask(), np.zeros(401))
    assert len(np.unique(np.concatenate([steps, (strategy.ask()[1:] - strategy.elite).ravel()]))) == 2 * n


def test_the_first_parents_are_around_initial_with_the_deviation_spread():
    strategy = MuPlusLambda(n_parameters=2, seed=1, parents=2000, children=1, initial=np.array([3.0, -1.0]), spread=0.5)
    np.testing.assert_allclose(strategy.elite.mean(axis=0), [3.0, -1.0], atol=4 * 0.5 / np.sqrt(2000))
    np.testing.assert_allclose(strategy.elite.std(axis=0), 0.5, atol=4 * 0.5 / np.sqrt(4000))


def test_the_newest_survive_among_equals():
    strategy = MuPlusLambda(n_parameters=2, seed=1, parents=3, children=3)
    population = strategy.ask()
    strategy.tell(population, np.zeros(6))
    np.testing.assert_array_equal(np.sort(strategy.elite, axis=0), np.sort(population[3:], axis=0))
    kept = MuPlusLambda(n_parameters=2, seed=1, parents=3, children=3, reevaluate=False)
    for _ in range(2):
        children = kept.ask()
        kept.tell(children, np.zeros(len(children)))
        np.testing.assert_array_equal(np.sort(kept.elite, axis=0), np.sort(children[-3:], axis=0))


def test_a_nan_is_no_fitness():
    strategy = MuPlusLambda(n_parameters=2, seed=1, parents=2, children=2)
    with pytest.raises(InvalidArgument, match="expected a fitness for every candidate, got nan for candidate 2"):
        strategy.tell(strategy.ask(), np.array([0.0, 1.0, np.nan, 2.0]))
    with pytest.raises(ShapeError, match=r"fitness: expected shape \(4\), got \(3,\)"):
        strategy.tell(strategy.ask(), np.zeros(3))
    with pytest.raises(ShapeError, match=r"population: expected shape \(any, 2\), got \(4, 3\)"):
        strategy.tell(np.zeros((4, 3)), np.zeros(4))
    strategy.tell(strategy.ask(), np.array([0.0, -np.inf, 1.0, -np.inf]))
    assert len(strategy.elite) == 2


@pytest.mark.parametrize(
    "parameters", [{"n_parameters": 0}, {"parents": 0}, {"children": 0}, {"sigma": 0.0}, {"spread": -1.0}]
)
def test_impossible_sizes_are_refused(parameters):
    with pytest.raises(InvalidArgument, match="expected n_parameters, parents, children >= 1, sigma > 0, spread >= 0"):
        MuPlusLambda(**{"n_parameters": 2, "seed": 1, **parameters})


def test_the_loop_yields_candidates_and_their_fitness():
    strategy = MuPlusLambda(n_parameters=2, seed=1, parents=2, children=3)
    seen = []
    loop = evolve(strategy, lambda p, index: sphere(p) + index, 3)
    for generation in loop:
        seen.append(generation.index)
        np.testing.assert_array_equal(generation.fitness, sphere(generation.population) + generation.index)
        fitness = generation.fitness
        assert generation.summary == (fitness.max(), fitness.mean(), fitness.min())
        assert strategy.generation == generation.index + 1
    assert seen == [0, 1, 2]


def test_the_state_of_another_strategy_is_refused():
    strategy = MuPlusLambda(n_parameters=3, seed=5, parents=4)
    with pytest.raises(ShapeError, match=r"state: parents: expected shape \(4, 3\), got \(4, 2\)"):
        strategy.restore(MuPlusLambda(n_parameters=2, seed=5, parents=4).state)
    with pytest.raises(InvalidArgument, match=r"expected a state with generation, parents .* got mean, sigma"):
        strategy.restore({"mean": np.zeros(3), "sigma": 1.0})
