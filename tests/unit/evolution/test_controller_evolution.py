"""Ensembles and the evolution of controllers against them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from evaluation.cells.controllers import EvolveCell, evolution_settings
from evaluation.cells.plants import Plant
from evaluation.experiment import Experiment
from sysid_evo.engine import DynamicsRunner, Rollouts, rollout
from sysid_evo.engine.rollout import Discounted
from sysid_evo.errors import IncompatibleTask, InvalidArgument, ShapeError, UnknownName
from sysid_evo.evolution import ControllerEvolution, EnsembleObjective, evolve_controller, polish
from sysid_evo.evolution.controller_evolution import met
from sysid_evo.models import DelayedEstimate, NoisySensors, Perturbed
from sysid_evo.models.base import make_model
from sysid_evo.randomness import trial_seeds
from sysid_evo.registry import Spec, aggregates
from sysid_evo.testing import example_dataset
from sysid_evo.types import Array, Seeds
from tests.fixtures.by_hand import Climber, Constant, Ladder


@dataclass
class Watched:
    """A runner that also writes down the trials and candidates it was given, and what they achieved."""

    runner: DynamicsRunner
    seeds: list[Seeds] = field(default_factory=list)
    parameters: list[Array] = field(default_factory=list)
    fitness: list[Array] = field(default_factory=list)

    def run(self, controller, parameters, task, seeds, *, record=False):
        rollouts = self.runner.run(controller, parameters, task, seeds, record=record)
        self.seeds.append(seeds)
        self.parameters.append(parameters)
        self.fitness.append(rollouts.fitness)
        return rollouts


@pytest.fixture
def pair(ladder):
    """A ladder that breaks early and one that breaks late."""
    return (
        Watched(DynamicsRunner(Climber(ladder, breaks_above=10.2))),
        Watched(DynamicsRunner(Climber(ladder, breaks_above=11.2))),
    )


def test_an_objective_is_the_aggregate_of_the_means_over_the_trials(pair, ladder):
    population = np.array([[1.0], [0.0], [-0.5]])
    seeds = trial_seeds(1, 6)
    means = [
        rollout(watched.runner.dynamics, Constant(), population, Ladder(), seeds).fitness.mean(axis=1)
        for watched in pair
    ]
    assert means[0][0] < means[1][0] < means[1][1] == 10.0
    for name, expected in (("min", means[0]), ("mean", (means[0] + means[1]) / 2)):
        objective = EnsembleObjective(pair, Constant(), Ladder(), seed=1, trials=6, aggregate=name)
        np.testing.assert_allclose(objective(population, 0).fitness, expected)


def test_the_mean_over_trials_is_taken_before_the_lowest_over_models(ladder):
    """One model is good in odd trials, the other in even ones: each has a mean of one half."""

    @dataclass
    class Fixed:
        fitness: Array

        def run(self, controller, parameters, task, seeds, *, record=False):
            count = np.zeros(self.fitness.shape, dtype=np.int64)
            return Rollouts(self.fitness, count, count, task.begin(seeds), "fixed")

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
    population = np.array([[1.0], [0.0], [-0.5]])
    scores = [watched.run(Constant(), population, Ladder(), trial_seeds(1, 6)).fitness for watched in pair]
    expected = np.min([score.mean(axis=1) - 2.0 * score.std(axis=1) for score in scores], axis=0)
    objective = EnsembleObjective(pair, Constant(), Ladder(), seed=1, trials=6, aggregate="cautious(weight=2.0)")
    np.testing.assert_allclose(objective(population, 0).fitness, expected)
    assert shapes[-1] == (2, 3, 6)
    assert expected[0] < expected[1]


def test_a_runner_that_leaves_trials_out_cannot_be_part_of_an_ensemble(ladder):
    class Dropping(DynamicsRunner):
        def run(self, controller, parameters, task, seeds, *, record=False):
            return super().run(controller, parameters, task, seeds[1:], record=record)

    objective = EnsembleObjective((Dropping(Climber(ladder)),), Constant(), Ladder(), seed=1, trials=6)
    with pytest.raises(ShapeError, match=r"fitness in every trial: expected shape \(1, 6\), got \(1, 5\)"):
        objective(np.zeros((1, 1)), 0)


def test_everyone_in_a_generation_meets_the_same_trials_and_the_next_one_others(pair):
    objective = EnsembleObjective(pair, Constant(), Ladder(), seed=5, trials=4)
    for generation in range(3):
        objective(np.zeros((3, 1)), generation)
    first, second = pair
    for generation in range(3):
        np.testing.assert_array_equal(first.seeds[generation], trial_seeds(5, 4, generation=generation))
        np.testing.assert_array_equal(first.seeds[generation], second.seeds[generation])
    assert len({int(seed) for seeds in first.seeds for seed in seeds}) == 12


def test_an_ensemble_without_models_or_trials_is_refused(pair):
    with pytest.raises(InvalidArgument, match="expected at least one model and one trial, got 0 and 10"):
        EnsembleObjective((), Constant(), Ladder(), seed=1)
    with pytest.raises(InvalidArgument, match="expected at least one model and one trial, got 2 and 0"):
        EnsembleObjective(pair, Constant(), Ladder(), seed=1, trials=0)
    with pytest.raises(UnknownName, match="no aggregate is called 'lowest'"):
        EnsembleObjective(pair, Constant(), Ladder(), seed=1, aggregate="lowest")


SETTINGS = ControllerEvolution(
    generations=25,
    trials=5,
    selection_trials=10,
    controller=Spec.parse("recurrent(hidden=3)"),
    task=Spec.parse("point_to_point(horizon=120, waypoint_radius=0.4)"),
    strategy=Spec.parse("mu_plus_lambda(parents=15, children=15, sigma=0.3)"),
)


@pytest.fixture(scope="module")
def runners(car_data):
    fitted = {
        name: make_model(name).fit(car_data, rng=np.random.default_rng(0)) for name in ("linear", "nearest_neighbour")
    }
    return {name: DynamicsRunner(model) for name, model in fitted.items()}


def test_an_evolved_controller_beats_random_ones_on_trials_it_never_met(runners, car_data):
    linear = {"linear": runners["linear"]}
    champion = evolve_controller("first", linear, car_data.system, SETTINGS, seed=3)
    random = 0.5 * np.random.default_rng(0).standard_normal((200, len(champion.parameters)))
    everyone = np.concatenate([champion.parameters[None], random])
    task = SETTINGS.make_task(car_data.system)
    seeds = trial_seeds(999, 40)
    fitness = linear["linear"].run(SETTINGS.make_controller(task), everyone, task, seeds).fitness.mean(axis=1)
    assert fitness[0] > fitness[1:].max()
    assert fitness[0] > 2.0 * fitness[1:].mean()


def test_a_champion_knows_how_it_came_about(runners, car_data):
    told: list[tuple[int, int]] = []
    notes: list[str] = []

    def progress(done, total, note=""):
        told.append((done, total))
        notes.append(note)

    settings = ControllerEvolution(
        generations=3,
        trials=2,
        runs=2,
        aggregate="mean",
        selection_trials=3,
        controller=Spec.parse("recurrent(hidden=2)"),
        task=Spec.parse("point_to_point(horizon=15)"),
        strategy=Spec.parse("mu_plus_lambda(parents=4, children=4)"),
    )
    champion = evolve_controller("both", runners, car_data.system, settings, seed=3, progress=progress)
    assert champion.name == "both"
    assert champion.against == ("linear", "nearest_neighbour")
    assert (champion.aggregate, champion.seed) == ("mean", 3)
    assert champion.parameters.shape == (2 * (5 + 2 + 2),)
    assert champion.history.shape == (3, 3)
    assert (np.diff(champion.history, axis=1) <= 0).all()  # best, mean, worst
    assert champion.controller == Spec("recurrent", {"hidden": 2})
    assert champion.task == Spec("point_to_point", {"horizon": 15})
    assert champion.system == car_data.system
    assert told == [(i, 6) for i in range(1, 7)]
    best, mean, _ = champion.history[0]
    first = [note for note in notes if note.startswith(f"best {best:.1f}, mean {mean:.1f}; linear ")]
    assert first
    assert all("nearest_neighbour" in note and note.endswith(("run 1 of 2", "run 2 of 2")) for note in notes)


def test_the_result_depends_on_the_seed_alone(runners, car_data):
    settings = ControllerEvolution(
        generations=3,
        trials=2,
        selection_trials=3,
        task=Spec.parse("point_to_point(horizon=15)"),
        strategy=Spec.parse("mu_plus_lambda(parents=4, children=4)"),
    )
    first, again, other = (evolve_controller("c", runners, car_data.system, settings, seed=seed) for seed in (3, 3, 4))
    np.testing.assert_array_equal(first.parameters, again.parameters)
    np.testing.assert_array_equal(first.history, again.history)
    assert not np.isin(other.parameters, first.parameters).any()


def test_the_champion_is_the_best_parent_of_all_runs_on_the_same_fresh_trials(runners, car_data):
    settings = ControllerEvolution(
        generations=2,
        trials=2,
        runs=3,
        selection_trials=10,
        task=Spec.parse("point_to_point(horizon=80, waypoint_radius=0.5)"),
        strategy=Spec.parse("mu_plus_lambda(parents=5, children=5, spread=1.0)"),
    )
    best_runs = set()
    for seed in (3, 4, 5, 8):
        watched = Watched(runners["linear"])
        champion = evolve_controller("c", {"linear": watched}, car_data.system, settings, seed=seed)
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


def test_an_estimator_delay_is_met_on_every_model_and_remembered(runners, car_data):
    settings = ControllerEvolution(
        generations=15, trials=2, selection_trials=2, task=Spec.parse("point_to_point(horizon=300)")
    )
    late = {name: replace(runner, dynamics=DelayedEstimate(runner.dynamics, 0.1)) for name, runner in runners.items()}
    wrapped = evolve_controller("c", late, car_data.system, settings, seed=1)
    asked = evolve_controller("c", runners, car_data.system, replace(settings, estimator_delay=0.1), seed=1)
    plain = evolve_controller("c", runners, car_data.system, settings, seed=1)
    np.testing.assert_array_equal(asked.parameters, wrapped.parameters)
    np.testing.assert_array_equal(asked.history, wrapped.history)
    assert not np.array_equal(asked.history, plain.history)
    assert (asked.estimator_delay, plain.estimator_delay) == (0.1, 0.0)


def test_only_models_can_be_observed_late(runners, car_data):
    settings = ControllerEvolution(generations=1, trials=1, estimator_delay=0.03)
    watched = {name: Watched(runner) for name, runner in runners.items()}
    with pytest.raises(InvalidArgument, match="not a model"):
        evolve_controller("c", watched, car_data.system, settings, seed=1)


def test_a_bare_model_is_run_by_a_runner_of_its_own(car_data):
    model, settings = make_model("linear").fit(car_data), ControllerEvolution(generations=1, trials=1)
    bare = evolve_controller("c", {"linear": model}, car_data.system, settings, seed=1)
    wrapped = evolve_controller("c", {"linear": DynamicsRunner(model)}, car_data.system, settings, seed=1)
    np.testing.assert_array_equal(bare.parameters, wrapped.parameters)
    with pytest.raises(InvalidArgument, match=r"expected models or runners by name, \{name: model\}, got list"):
        evolve_controller("c", [model], car_data.system, settings, seed=1)  # type: ignore[arg-type]  # a usual slip
    with pytest.raises(InvalidArgument, match="'linear' is a str, no model and no runner"):
        evolve_controller("c", {"linear": "linear"}, car_data.system, settings, seed=1)  # type: ignore[dict-item]  # same
    with pytest.raises(InvalidArgument, match="seed: expected a whole number >= 0, got Generator"):
        evolve_controller("c", {"linear": model}, car_data.system, settings, seed=np.random.default_rng(0))  # type: ignore[arg-type]  # same


def test_impossible_settings_are_refused(car_data, ladder):
    for name in ("generations", "trials", "runs", "selection_trials"):
        with pytest.raises(InvalidArgument, match=f"expected {name} as a whole number >= 1, got 0"):
            ControllerEvolution(**{name: 0})
    with pytest.raises(InvalidArgument, match="expected generations as a whole number >= 1, got 'ten'"):
        ControllerEvolution(generations="ten")  # type: ignore[arg-type]  # as from a file
    with pytest.raises(UnknownName, match=r"no aggregate is called 'maximum'\..* Known: .*mean, median, min"):
        ControllerEvolution(aggregate="maximum")
    with pytest.raises(InvalidArgument, match="aggregate 'min' has no parameter 'share'"):
        ControllerEvolution(aggregate="min(share=0.2)")
    with pytest.raises(IncompatibleTask, match="has no motion"):
        ControllerEvolution().make_task(ladder)
    with pytest.raises(UnknownName, match=r"no controller is called 'recurent'\. Did you mean 'recurrent'"):
        ControllerEvolution(controller="recurent")
    with pytest.raises(InvalidArgument, match=r"strategy 'mu_plus_lambda' has no parameter 'sigmma'\. Did you mean"):
        ControllerEvolution(strategy="mu_plus_lambda(sigmma=0.1)")
    with pytest.raises(InvalidArgument, match="task 'point_to_point' has no parameter 'radius'"):
        ControllerEvolution(task="point_to_point(radius=0.1)")


NOISE = "envelope(sensor=0.2, latency=2, gain=0.2)"
SHORT = Spec.parse("point_to_point(horizon=120)")


@pytest.fixture(scope="module")
def models():
    data = example_dataset()
    return {
        name: DynamicsRunner(make_model("linear", ridge=ridge).fit(data, rng=0))
        for name, ridge in (("a", 0.0), ("b", 0.1))
    }


def settings(noise, caution=""):
    return ControllerEvolution(generations=2, trials=2, selection_trials=4, task=SHORT, noise=noise, caution=caution)


def test_noise_decides_what_candidates_score_and_the_same_seed_gives_the_same(models):
    system = next(iter(models.values())).dynamics.system
    first, again, other = (
        evolve_controller("x", models, system, settings(noise), seed=3) for noise in (NOISE, NOISE, "")
    )
    np.testing.assert_array_equal(first.parameters, again.parameters)
    assert not np.array_equal(first.history, other.history)


def test_a_polish_meets_noise_and_caution_too(models):
    system = next(iter(models.values())).dynamics.system
    start = evolve_controller("x", models, system, settings(""), seed=3)
    plain, doubted = (
        polish("x", start, models, settings(NOISE, caution), seed=3, generations=1)
        for caution in ("", "doubt(outside=100)")
    )
    assert doubted.history.min() < 0.0 <= plain.history.min()


def test_every_model_is_met_with_noise(models):
    for runner in met(models, settings(NOISE)).values():
        assert isinstance(runner, DynamicsRunner)
        assert isinstance(runner.dynamics, NoisySensors)
        assert isinstance(runner.dynamics.inner, Perturbed)


def test_what_is_no_model_cannot_be_met_with_noise():
    class Elsewhere:
        def run(self, controller, parameters, task, seeds, *, record=False):
            raise AssertionError

    with pytest.raises(InvalidArgument, match="car is not a model"):
        met({"car": Elsewhere()}, settings(NOISE))


def test_noise_is_checked_where_it_is_given():
    with pytest.raises(UnknownName, match="envelope"):
        ControllerEvolution(noise="fog(density=2)")
    with pytest.raises(UnknownName, match="doubt"):
        ControllerEvolution(caution="fog")
    with pytest.raises(UnknownName, match="envelope"):
        evolution_settings(Experiment(noise="fog"))


def test_candidates_lose_fitness_where_models_are_doubted(models):
    system = next(iter(models.values())).dynamics.system
    plain, cautious = (
        evolve_controller("x", models, system, settings("", caution), seed=3)
        for caution in ("", "doubt(outside=100, disagreement=50)")
    )
    assert cautious.history[:, 2].min() < -1.0 <= plain.history[:, 2].min()
    doubted = met(models, settings("envelope(gain=0.1)", "doubt(outside=1, disagreement=2)"))["a"]
    assert isinstance(doubted, Discounted)
    assert doubted.most == 3.0


def test_noise_belongs_to_what_a_controllers_cell_depends_on():
    column = Plant("emulated_car", "emulated_car", robot=Spec("emulated_car"))
    cells = [EvolveCell((column,), settings(noise), seed=0) for noise in ("", NOISE, "envelope(sensor=0.1)")]
    cells.append(EvolveCell((column,), settings("", "doubt(outside=1)"), seed=0))
    assert len({cell.digest for cell in cells}) == 4
    spelled = EvolveCell((column,), settings("envelope(gain=0.2, latency=2, sensor=0.2)"), seed=0)
    assert spelled.digest == cells[1].digest
