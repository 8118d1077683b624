"""Ensembles and the evolution of controllers against them."""

from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from evaluation.cells.controllers import Evolve, evolution_settings
from evaluation.cells.plants import Plant
from evaluation.experiment import Experiment
from sysid_evo.engine import DynamicsRunner, Rollouts, rollout
from sysid_evo.errors import IncompatibleTask, InvalidArgument, ShapeError, UnknownName
from sysid_evo.evolution import ControllerEvolution, evolve_controller, polish
from sysid_evo.evolution.controller_evolution import EnsembleObjective, disturbed_runners
from sysid_evo.models import Disturbed
from sysid_evo.models.base import make_model
from sysid_evo.randomness import trial_seeds
from sysid_evo.registry import Spec, aggregates
from sysid_evo.registry.registry import noises
from tests.fixtures.by_hand import Climber, Constant, Ladder

POPULATION = np.array([[1.0], [0.0], [-0.5]])
SETTINGS = ControllerEvolution(
    generations=3,
    trials=2,
    selection_trials=3,
    controller="recurrent(hidden=2)",
    task="point_to_point(horizon=40, waypoint_radius=0.6)",
    strategy="mu_plus_lambda(parents=4, children=4, spread=2.0)",  # at once some drive
)
NOISE = "domain_randomisation(sensor=2.0, process=1.0, gain=0.2)"


@dataclass
class Watched:
    """A runner that also writes down the trials and candidates it was given, and what they achieved."""

    runner: DynamicsRunner
    seeds: list = field(default_factory=list)
    parameters: list = field(default_factory=list)
    fitness: list = field(default_factory=list)

    def bind(self, controller, task):
        bound = self.runner.bind(controller, task)

        def run(parameters, seeds, *, record=False):
            rollouts = bound(parameters, seeds, record=record)
            self.seeds.append(seeds)
            self.parameters.append(parameters)
            self.fitness.append(rollouts.fitness)
            return rollouts

        return run


@pytest.fixture
def pair(ladder):
    """A ladder that breaks early and one that breaks late."""
    return tuple(Watched(DynamicsRunner(Climber(ladder, breaks_above=above))) for above in (10.2, 11.2))


@pytest.fixture(scope="module")
def runners(car_data):
    return {name: DynamicsRunner(make_model(name).fit(car_data, rng=0)) for name in ("linear", "nearest_neighbour")}


@pytest.fixture
def evolved(runners, car_data):
    """A function that evolves in both models, or in those that are given."""

    def evolve(settings=SETTINGS, models=runners, *, seed=3, **options):
        return evolve_controller("c", models, car_data.system, settings, seed=seed, **options)

    return evolve


def test_an_objective_is_the_aggregate_of_the_means_over_the_trials(pair, ladder):
    seeds = trial_seeds(1, 6)
    means = [
        rollout(watched.runner.dynamics, Constant(), POPULATION, Ladder(), seeds).fitness.mean(axis=1)
        for watched in pair
    ]
    assert means[0][0] < means[1][0] < means[1][1] == 10.0
    for name, expected in (("min", means[0]), ("mean", (means[0] + means[1]) / 2)):
        objective = EnsembleObjective(pair, Constant(), Ladder(), seed=1, trials=6, aggregate=name)
        np.testing.assert_allclose(objective(POPULATION, 0).fitness, expected)


def test_the_mean_over_trials_is_taken_before_the_lowest_over_models(ladder):
    """One model is good in odd trials, the other in even ones: each has a mean of one half."""

    @dataclass
    class Fixed:
        fitness: np.ndarray

        def bind(self, controller, task):
            count = np.zeros(self.fitness.shape, dtype=np.int64)
            return lambda parameters, seeds: Rollouts(self.fitness, count, count, task.begin(seeds), "fixed")

    runners = Fixed(np.array([[0.0, 1.0]])), Fixed(np.array([[1.0, 0.0]]))
    objective = EnsembleObjective(runners, Constant(), Ladder(), seed=1, trials=2)
    np.testing.assert_array_equal(objective(np.zeros((1, 1)), 0).fitness, [0.5])


def test_a_rule_may_look_at_the_spread_over_the_trials(pair, register):
    """The steady candidate beats the one with the better mean, since the rule takes the spread off."""
    shapes = []

    def cautious(fitness, *, weight=1.0):
        shapes.append(fitness.shape)
        return (fitness.mean(axis=2) - weight * fitness.std(axis=2)).min(axis=0)

    register(aggregates, "cautious", cautious)
    scores = [watched.bind(Constant(), Ladder())(POPULATION, trial_seeds(1, 6)).fitness for watched in pair]
    expected = np.min([score.mean(axis=1) - 2.0 * score.std(axis=1) for score in scores], axis=0)
    objective = EnsembleObjective(pair, Constant(), Ladder(), seed=1, trials=6, aggregate="cautious(weight=2.0)")
    np.testing.assert_allclose(objective(POPULATION, 0).fitness, expected)
    assert shapes[-1] == (2, 3, 6)
    assert expected[0] < expected[1]


def test_a_runner_that_leaves_trials_out_cannot_be_part_of_an_ensemble(ladder):
    class Dropping(DynamicsRunner):
        def bind(self, controller, task):
            bound = super().bind(controller, task)
            return lambda parameters, seeds: bound(parameters, seeds[1:])

    objective = EnsembleObjective((Dropping(Climber(ladder)),), Constant(), Ladder(), seed=1, trials=6)
    with pytest.raises(ShapeError, match=r"fitness in every trial: expected shape \(1, 6\), got \(1, 5\)"):
        objective(np.zeros((1, 1)), 0)


def test_an_objective_binds_controller_and_task_to_each_model_once_however_often_it_is_asked(ladder):
    bound = []

    class Counting(DynamicsRunner):
        def bind(self, controller, task):
            bound.append(self)
            return super().bind(controller, task)

    models = Counting(Climber(ladder)), Counting(Climber(ladder))
    objective = EnsembleObjective(models, Constant(), Ladder(), seed=1, trials=2)
    for generation in range(3):
        objective(np.zeros((2, 1)), generation)
    assert [id(one) for one in bound] == [id(model) for model in models]


def test_all_candidates_of_a_generation_have_the_same_trials_and_the_next_generation_others(pair):
    objective = EnsembleObjective(pair, Constant(), Ladder(), seed=5, trials=4)
    for generation in range(3):
        objective(np.zeros((3, 1)), generation)
        for watched in pair:
            np.testing.assert_array_equal(watched.seeds[generation], trial_seeds(5, 4, generation=generation))
    assert len({int(seed) for seeds in pair[0].seeds for seed in seeds}) == 12


def test_an_ensemble_without_models_or_trials_is_refused(pair):
    with pytest.raises(InvalidArgument, match="expected at least one model and one trial, got 0 and 10"):
        EnsembleObjective((), Constant(), Ladder(), seed=1)
    with pytest.raises(InvalidArgument, match="expected at least one model and one trial, got 2 and 0"):
        EnsembleObjective(pair, Constant(), Ladder(), seed=1, trials=0)
    with pytest.raises(UnknownName, match="no aggregate is called 'lowest'"):
        EnsembleObjective(pair, Constant(), Ladder(), seed=1, aggregate="lowest")


def test_an_evolved_controller_beats_random_ones_on_trials_it_never_met(runners, car_data, evolved):
    settings = replace(
        SETTINGS, generations=20, trials=4, selection_trials=8, strategy="mu_plus_lambda(parents=12, children=12)"
    )
    linear = runners["linear"]
    champion = evolved(settings, {"linear": linear})
    random = 0.5 * np.random.default_rng(0).standard_normal((100, len(champion.parameters)))
    everyone = np.concatenate([champion.parameters[None], random])
    task = settings.make_task(car_data.system)
    fitness = linear.bind(settings.make_controller(task), task)(everyone, trial_seeds(999, 30)).fitness.mean(axis=1)
    assert fitness[0] > fitness[1:].max()
    assert fitness[0] > 2.0 * fitness[1:].mean()


def test_a_champion_knows_how_it_came_about(car_data, evolved):
    told = []
    settings = replace(SETTINGS, repeats=2, aggregate="mean")
    champion = evolved(settings, progress=lambda *given: told.append(given))
    assert (champion.name, champion.against) == ("c", ("linear", "nearest_neighbour"))
    assert (champion.aggregate, champion.seed) == ("mean", 3)
    assert champion.parameters.shape == (2 * (5 + 2 + 2),)
    assert champion.history.shape == (3, 3)
    assert (np.diff(champion.history, axis=1) <= 0).all()  # best, mean, worst
    assert champion.controller == Spec("recurrent", {"hidden": 2})
    assert champion.task == Spec("point_to_point", {"horizon": 40, "waypoint_radius": 0.6})
    assert champion.system == car_data.system
    assert [given[:2] for given in told] == [(i, 6) for i in range(1, 7)]
    notes = [note for _, _, note in told]
    best, mean, _ = champion.history[0]
    assert any(note.startswith(f"best {best:.1f}, mean {mean:.1f}; linear ") for note in notes)
    assert all("nearest_neighbour" in note and note.endswith(("run 1 of 2", "run 2 of 2")) for note in notes)


def test_the_result_depends_on_the_seed_alone(evolved):
    first, again, other = (evolved(seed=seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first.parameters, again.parameters)
    np.testing.assert_array_equal(first.history, again.history)
    assert not np.isin(other.parameters, first.parameters).any()


def test_the_champion_is_the_best_parent_of_all_runs_on_the_same_fresh_trials(runners, evolved):
    settings = replace(
        SETTINGS, generations=2, repeats=3, selection_trials=10,
        strategy="mu_plus_lambda(parents=5, children=5, spread=1.0)",
    )  # fmt: skip
    best_runs = set()
    for seed in (3, 4, 5, 8):
        watched = Watched(runners["linear"])
        champion = evolved(settings, {"linear": watched}, seed=seed)
        met = {int(number) for seeds in watched.seeds if len(seeds) == 2 for number in seeds}
        assert len(met) == 2 * 2 * 3  # three runs of two generations of two trials, all of them different
        choices = [i for i, seeds in enumerate(watched.seeds) if len(seeds) == 10]
        assert [len(watched.parameters[i]) for i in choices] == [5, 5, 5]
        assert len({watched.seeds[i].tobytes() for i in choices}) == 1
        assert not met & {int(number) for number in watched.seeds[choices[0]]}
        fitness = np.stack([watched.fitness[i].mean(axis=1) for i in choices])
        run, parent = np.unravel_index(np.argmax(fitness), fitness.shape)
        np.testing.assert_array_equal(champion.parameters, watched.parameters[choices[run]][parent])
        best_runs.add(run)
    assert len(best_runs) > 1


def test_an_estimator_delay_applies_to_every_model_and_is_stored(runners, evolved):
    late = {name: replace(runner, dynamics=Disturbed(runner.dynamics, delay=0.1)) for name, runner in runners.items()}
    wrapped, asked, plain = evolved(models=late), evolved(replace(SETTINGS, estimator_delay=0.1)), evolved()
    np.testing.assert_array_equal(asked.parameters, wrapped.parameters)
    np.testing.assert_array_equal(asked.history, wrapped.history)
    assert not np.array_equal(asked.history, plain.history)
    assert (asked.estimator_delay, plain.estimator_delay) == (0.1, 0.0)


def test_a_bare_model_is_run_by_a_runner_of_its_own_and_what_is_none_is_refused(runners, evolved):
    model = runners["linear"].dynamics
    np.testing.assert_array_equal(
        evolved(models={"linear": model}).parameters, evolved(models={"linear": runners["linear"]}).parameters
    )
    for models, settings, reason in (
        ([model], SETTINGS, r"expected models or runners by name, \{name: model\}, got list"),
        ({"linear": "linear"}, SETTINGS, "expected a model or a runner as 'linear', got str"),
        ({"linear": Watched(runners["linear"])}, replace(SETTINGS, estimator_delay=0.03), "not a model"),
        ({"car": Watched(runners["linear"])}, replace(SETTINGS, noise=NOISE), "car is not a model"),
    ):
        with pytest.raises(InvalidArgument, match=reason):
            evolved(settings, models)
    with pytest.raises(InvalidArgument, match="seed: expected a whole number >= 0, got Generator"):
        evolved(seed=np.random.default_rng(0))


@pytest.mark.parametrize(
    ("settings", "error", "reason"),
    [
        *(
            ({name: 0}, InvalidArgument, f"expected {name} as a whole number >= 1, got 0")
            for name in ("generations", "trials", "repeats", "selection_trials")
        ),
        ({"generations": "ten"}, InvalidArgument, "expected generations as a whole number >= 1, got 'ten'"),
        ({"aggregate": "maximum"}, UnknownName, r"no aggregate is called 'maximum'\..* Known: .*mean, median, min"),
        ({"aggregate": "min(share=0.2)"}, InvalidArgument, "aggregate 'min' has no parameter 'share'"),
        ({"controller": "recurent"}, UnknownName, r"no controller is called 'recurent'\. Did you mean 'recurrent'"),
        (
            {"strategy": "mu_plus_lambda(sigmma=0.1)"},
            InvalidArgument,
            r"strategy 'mu_plus_lambda' has no parameter 'sigmma'\. Did you mean",
        ),
        ({"task": "point_to_point(radius=0.1)"}, InvalidArgument, "task 'point_to_point' has no parameter 'radius'"),
        ({"noise": "fog(density=2)"}, UnknownName, "domain_randomisation"),
    ],
)
def test_impossible_settings_are_refused_where_they_are_given(settings, error, reason):
    with pytest.raises(error, match=reason):
        ControllerEvolution(**settings)


def test_a_task_that_the_system_cannot_do_and_noise_of_an_experiment_are_refused(ladder):
    with pytest.raises(IncompatibleTask, match="has no motion"):
        ControllerEvolution().make_task(ladder)
    with pytest.raises(UnknownName, match="domain_randomisation"):
        evolution_settings(Experiment(noise="fog"))


@pytest.fixture(scope="module")
def models(car_data):
    return {
        name: DynamicsRunner(make_model("linear", ridge=ridge).fit(car_data, rng=0))
        for name, ridge in (("a", 0.0), ("b", 0.1))
    }


def test_noise_decides_what_candidates_score_and_the_same_seed_gives_the_same(models, evolved):
    first, again, other = (evolved(replace(SETTINGS, noise=noise), models) for noise in (NOISE, NOISE, ""))
    np.testing.assert_array_equal(first.parameters, again.parameters)
    assert not np.array_equal(first.history, other.history)


def test_noise_applies_to_a_polish(models, evolved):
    start = evolved(models=models)
    plain, noisy = (
        polish("x", start, models, replace(SETTINGS, noise=noise), seed=3, generations=3) for noise in ("", NOISE)
    )
    assert not np.array_equal(noisy.history, plain.history)


def test_noise_applies_to_every_model(models):
    for runner in disturbed_runners(models, replace(SETTINGS, noise=NOISE)).values():
        assert isinstance(runner, DynamicsRunner)
        assert isinstance(runner.dynamics, Disturbed)
        assert runner.dynamics.noise == noises.make(NOISE)


def test_noise_belongs_to_what_a_controllers_cell_depends_on():
    column = Plant("emulated_car", "emulated_car", robot=Spec("emulated_car"))

    def digest(**changed):
        return Evolve((column,), replace(SETTINGS, **changed), seed=0).cell().digest

    digests = [digest(noise=noise) for noise in ("", NOISE, "domain_randomisation(sensor=0.1)")]
    assert len(set(digests)) == 3
    assert digest(noise="domain_randomisation(gain=0.2, process=1.0, sensor=2.0)") == digests[1]


@pytest.mark.parametrize(("arena", "share"), [(1.5, 1.0), (45.0, 1.0 / 30.0)])
def test_a_search_begins_with_small_weights_of_a_distance_in_a_large_arena(evolved, runners, arena, share):
    watched = Watched(runners["linear"])
    task = f"point_to_point(horizon=5, arena_radius={arena})"
    search = replace(SETTINGS, generations=1, controller="linear", strategy="cma_es(sigma=0.3)", task=task)
    evolved(search, {"linear": watched})
    weights = watched.parameters[0][:-1].reshape(50, -1, 2)
    np.testing.assert_allclose(weights[:, 4].std(), 0.3 * share, rtol=0.3)
    np.testing.assert_allclose(weights[:, 3].std(), 0.3, rtol=0.3)
