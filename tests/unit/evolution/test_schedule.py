"""Incremental evolution: stages end when the fitness is there, and what comes after meets the harder task."""

from dataclasses import replace

import numpy as np
import pytest

from sysid_evo.artefacts import CheckpointFile
from sysid_evo.engine import DynamicsRunner
from sysid_evo.engine.rollout import BoundRollout
from sysid_evo.errors import EvolutionWarning, InvalidArgument, UnknownName
from sysid_evo.evolution import ControllerEvolution, Stage, evolve, evolve_controller, loop
from sysid_evo.evolution.loop import Generation, Schedule
from sysid_evo.evolution.strategies.mu_plus_lambda import MuPlusLambda
from sysid_evo.models.base import make_model
from sysid_evo.registry import Spec
from tests.fixtures.checkpoints import Stop, StopAfter
from tests.fixtures.evolutions import assert_same

SETTINGS = ControllerEvolution(
    generations=6,
    trials=2,
    selection_trials=3,
    controller="recurrent(hidden=2)",
    task="point_to_point(horizon=40)",
    strategy="mu_plus_lambda(parents=4, children=4)",
    schedule="stage(task=point_to_point(horizon=20, waypoint_radius=0.8), models=[linear], max_generations=2), "
    "stage(task=point_to_point(horizon=30, waypoint_radius=0.5), until=0.1, window=2)",
)


@pytest.fixture(scope="module")
def runners(car_data):
    names = ("linear", "nearest_neighbour")
    return {name: DynamicsRunner(make_model(name).fit(car_data, rng=0)) for name in names}


@pytest.fixture(scope="module")
def evolved(runners, car_data):
    """A function that evolves in both models, or in those that are given."""

    def evolve(settings=SETTINGS, models=runners, **options):
        return evolve_controller("c", models, car_data.system, settings, seed=3, **options)

    return evolve


@pytest.fixture(scope="module")
def whole(evolved):
    """The champion of an evolution that nothing stopped."""
    return evolved()


def scored(*fitness):
    return Generation(0, np.zeros((len(fitness), 1)), np.array(fitness))


def hill(width):
    """Return a hill around 3 in every parameter: outside its width it is flat."""

    def fitness(population, _):
        return np.maximum(0.0, 1.0 - np.abs(population - 3.0).max(axis=1) / width)

    return fitness


def test_a_stage_ends_when_the_median_of_the_better_half_has_been_there_for_some_generations():
    schedule = Schedule([(Stage(until=2.0, window=3), hill(9.0))], hill(1.0))
    lucky, below, there = scored(9.0, 1.0, 1.0, 0.0, 0.0, 0.0), scored(1.9, 1.9, 0.0, 0.0), scored(2.1, 2.0, 0.0, -9.0)
    for generation in (there, lucky, below, there, lucky):
        assert not schedule.tell(generation)
    assert schedule.tell(there)
    assert schedule.status == "stage 2 of 2"
    assert not schedule.tell(there)  # there is no further one


def test_a_stage_ends_after_its_most_generations():
    schedule = Schedule(
        [(Stage(until=2.0, max_generations=3), hill(9.0)), (Stage(max_generations=1), hill(3.0))], hill(1.0)
    )
    assert [schedule.tell(scored(0.0)) for _ in range(6)] == [False, False, True, True, False, False]


def test_a_peak_that_plain_search_misses_is_found_by_way_of_wider_ones():
    def best(objective):
        strategy = MuPlusLambda(n_parameters=4, seed=1, parents=10, children=10)
        for generation in evolve(strategy, objective, 200):
            if isinstance(objective, Schedule) and objective.tell(generation):
                strategy.forget_fitness()
        return float(np.asarray(hill(0.6)(strategy.elite, 0)).max())

    stages = [(Stage(until=0.75), hill(width)) for width in (5.0, 2.0)]
    assert best(hill(0.6)) == 0.0
    assert best(Schedule(stages, hill(0.6))) > 0.3


def test_parents_that_are_not_asked_again_do_not_live_on_the_fitness_of_an_easier_stage():
    strategy = MuPlusLambda(n_parameters=2, seed=1, parents=5, children=5, reevaluate=False)
    schedule = Schedule([(Stage(max_generations=3), lambda population, _: population[:, 0] + 1000.0)], hill(2.0))
    for generation in evolve(strategy, schedule, 10):
        if schedule.tell(generation):
            assert len(strategy.ask()) == 5
            strategy.forget_fitness()
            assert len(strategy.ask()) == 10
    assert (np.asarray(strategy.state["parents_fitness"]) < 1.1).all()


@pytest.fixture
def noted(monkeypatch):
    """Every run of the test: its family, candidates and task."""
    runs, run = [], BoundRollout.__call__

    def noting(self, parameters, seeds, *, record=False):
        runs.append((type(self.dynamics).__name__, len(parameters), self.task))
        return run(self, parameters, seeds, record=record)

    monkeypatch.setattr(BoundRollout, "__call__", noting)
    return runs


def test_the_stages_of_a_controller_meet_their_own_task_and_models(evolved, noted):
    notes = []
    evolved(progress=lambda done, total, note="": notes.append(note))
    met = [(family, task.horizon, task.waypoint_radius) for family, _, task in noted]
    families = ("Linear", "NearestNeighbour")
    second = sum("stage 2 of 3" in note for note in notes)
    tasks = [(30, 0.5)] * second + [(40, 0.3)] * (4 - second + 1)  # the last is that of the finalists
    assert second >= 2
    assert met[:2] == [("Linear", 20, 0.8)] * 2
    both = [sorted(met[i : i + 2]) for i in range(2, len(met), 2)]  # the cheaper comes first
    assert both == [[(family, *task) for family in families] for task in tasks]
    assert ["linear" in note for note in notes] == [False] * 2 + [True] * 4


def test_a_controller_s_parents_are_asked_again_when_a_stage_begins(runners, evolved, noted):
    strategy = "mu_plus_lambda(parents=4, children=3, reevaluate=false)"
    settings = replace(SETTINGS, generations=5, strategy=strategy, schedule=(Stage(max_generations=3),))
    evolved(settings, {"linear": runners["linear"]})
    assert [asked for _, asked, _ in noted] == [7, 3, 3, 7, 3, 4]  # at last the finalists


@pytest.mark.parametrize("after", [1, 3, 6, *(pytest.param(n, marks=pytest.mark.nightly) for n in (2, 4, 5))])
def test_an_evolution_stopped_in_any_stage_resumes_to_the_same_champion(after, evolved, whole, tmp_path):
    with pytest.raises(Stop):
        evolved(checkpoint=CheckpointFile(tmp_path / "c"), progress=StopAfter(after))
    assert_same(evolved(checkpoint=CheckpointFile(tmp_path / "c")), whole)


def test_a_stage_that_never_ends_gives_a_warning(evolved):
    unreachable = replace(SETTINGS, generations=1, schedule=(Stage(until=1e6),))
    with pytest.warns(EvolutionWarning, match=r"run 1 ended in stage 1 of 2: the final task was not reached"):
        evolved(unreachable)


def test_stages_are_written_in_the_grammar_of_everything_that_has_a_name():
    first, second = SETTINGS.schedule
    assert first == Stage(task="point_to_point(horizon=20, waypoint_radius=0.8)", models=("linear",), max_generations=2)
    assert second.task == Spec("point_to_point", {"horizon": 30, "waypoint_radius": 0.5})
    assert Stage(models="a + b", until=1).models == ("a", "b")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("stage(task=point_to_point)", "expected until=FITNESS, max_generations=NUMBER or both"),
        ("stage(until=inf)", "finite"),
        ("stage(max_generations=0)", ">= 1"),
        ("stage(at_most=3)", r"got stage\(at_most=3\)\. It is called 'max_generations' now"),
        (
            "step(until=3)",
            r"expected stage\(task=..., models=..., until=..., max_generations=..., window=...\), got step",
        ),
        ("stage(untill=3)", "expected stage"),
        ("stage(until=high)", "cannot be read"),
        ("stage(task=point_to_point(radius=1), until=3)", "has no parameter 'radius'"),
    ],
)
def test_a_schedule_that_makes_no_sense_is_refused(text, said):
    with pytest.raises(InvalidArgument, match=said):
        ControllerEvolution(schedule=text)


def test_stages_must_fit_what_is_asked_for(car_data):
    with pytest.raises(UnknownName, match="no task is called 'race'"):
        Stage(task="race", until=3.0)
    wrong = replace(SETTINGS, schedule=(Stage(models=("lineer",), until=3.0),))
    with pytest.raises(InvalidArgument, match="'lineer' is not among the models: linear"):
        wrong.stages(wrong.make_task(car_data.system), ("linear",))


def test_a_search_is_over_when_half_of_the_candidates_have_had_nearly_the_most_for_twenty_generations():
    schedule = Schedule([], hill(1.0))
    full, not_quite = scored(2.0, 1.9999, 0.0, 0.0), scored(2.0, 1.999, 1.999, 0.0)
    for generation in (*[full] * 19, not_quite, *[full] * 19):
        schedule.tell(generation)
        assert not schedule.converged
    schedule.tell(full)
    assert schedule.converged


def test_a_search_that_still_rises_is_not_over():
    schedule = Schedule([], hill(1.0))
    for number in range(60):
        schedule.tell(scored(1.0 + 0.01 * number, 1.0 + 0.01 * number, 0.0))
    schedule.tell(scored(1.0, 1.0, 1.0))
    assert not schedule.converged


def test_a_search_among_equals_goes_on():
    schedule = Schedule([], hill(1.0))
    for _ in range(30):
        schedule.tell(scored(-500.0, -500.0))
    assert not schedule.converged


def test_an_easier_stage_does_not_end_a_search():
    schedule = Schedule([(Stage(max_generations=30), hill(9.0))], hill(1.0))
    for _ in range(30):
        schedule.tell(scored(1.0, 1.0, 0.0))
    assert schedule.stage == 1
    assert not schedule.converged


def test_a_run_ends_when_its_search_has_converged_and_resumes_to_the_same_end(runners, evolved, tmp_path, monkeypatch):
    monkeypatch.setattr(loop, "EQUAL_SHARE", 0.0)
    settings = replace(SETTINGS, generations=40, repeats=2, schedule=())
    given = settings, {"linear": runners["linear"]}
    champion = evolved(*given)
    assert len(champion.history) == 22  # the first two have equals alone
    with pytest.raises(Stop):
        evolved(*given, checkpoint=CheckpointFile(tmp_path / "c"), progress=StopAfter(20))
    assert_same(evolved(*given, checkpoint=CheckpointFile(tmp_path / "c")), champion)
