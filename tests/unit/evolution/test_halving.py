"""Several ways to begin a search share its generations; the one that rises is continued."""

from dataclasses import replace

import numpy as np
import pytest

from sysid_evo.artefacts import CheckpointFile
from sysid_evo.engine import DynamicsRunner
from sysid_evo.errors import InvalidArgument, UnknownName
from sysid_evo.evolution import ControllerEvolution, evolve_controller
from sysid_evo.evolution.halving import Halving, Start
from sysid_evo.models.base import make_model
from tests.fixtures.checkpoints import Stop, StopAfter
from tests.fixtures.evolutions import assert_same

LINEAR, CONSTANT = "start(controller=linear, strategy=cma_es(sigma=0.3))", "start(controller=constant)"
NETWORK = "start(controller=feed_forward(hidden=2), strategy=niches)"
SETTINGS = ControllerEvolution(
    generations=12,
    trials=2,
    selection_trials=3,
    task="point_to_point(horizon=40)",
    starts=f"{CONSTANT}, {LINEAR}, {NETWORK}",
)


@pytest.fixture(scope="module")
def evolved(car_data):
    """A function that evolves in a model of the car."""
    models = {"linear": DynamicsRunner(make_model("linear").fit(car_data, rng=0))}

    def evolve(settings=SETTINGS, **options):
        return evolve_controller("c", models, car_data.system, settings, seed=3, **options)

    return evolve


@pytest.fixture(scope="module")
def whole(evolved):
    """The champion of a search that nothing stopped."""
    return evolved()


@pytest.mark.parametrize(
    "starts, generations, sizes, lengths",
    [(1, 7, (1,), (7,)), (3, 9, (3, 2, 1), (1, 1, 1, 1, 1, 3)), (4, 12, (4, 2, 1), (1, 1, 1, 1, 2, 2, 4))],
)
def test_every_rung_takes_the_same_share_of_the_generations(starts, generations, sizes, lengths):
    halving = Halving(starts, generations)
    assert halving.sizes == sizes
    assert halving.lengths == lengths


def test_the_better_half_of_a_rung_continues_best_first():
    halving = Halving(3, 9)
    fitness = [1.0, 5.0, 3.0, 4.0, 6.0]
    assert halving.lineage(2, []) == (2,)
    assert halving.lineage(3, fitness[:3]) == (1, 3)
    assert halving.lineage(4, fitness[:3]) == (2, 4)
    assert halving.lineage(5, fitness) == (2, 4, 5)
    assert halving.longest == 1 + 1 + 3


def test_equal_starts_continue_in_their_order():
    assert Halving(2, 4).lineage(2, [1.0, 1.0]) == (0, 2)


def test_too_few_generations_for_the_starts_are_refused():
    with pytest.raises(InvalidArgument, match="at least 6 generations to compare 3 starts, got 5"):
        Halving(3, 5)
    with pytest.raises(InvalidArgument, match="at least 6"):
        replace(SETTINGS, generations=5)


def test_the_champion_has_the_controller_of_its_start_and_the_history_of_all_its_rungs(whole):
    assert whole.controller in [start.controller for start in SETTINGS.starts]
    law = {"constant": 2, "linear": None, "feed_forward": None}[whole.controller.name]
    assert law is None or len(whole.parameters) == law
    assert {len(one.parameters) for one in whole.finalists} == {len(whole.parameters)}
    lengths = SETTINGS.generations // 3
    assert len(whole.history) in (lengths // 3, lengths // 3 + lengths // 2, lengths // 3 + lengths // 2 + lengths)
    assert max(one.fitness for one in whole.finalists) == max(whole.seed_fitness)


SPEED = "set_point(channels=forward_speed, low=-1, high=1, horizon=60)"


def test_feedback_wins_against_commands_that_do_not_depend_on_the_state(evolved):
    champion = evolved(replace(SETTINGS, task=SPEED, generations=40, starts=f"{CONSTANT}, {LINEAR}"))
    assert champion.controller.name == "linear"
    assert len(champion.history) == 10 + 20


def test_a_run_continues_where_the_run_before_it_ended(evolved):
    champion = evolved(replace(SETTINGS, task=SPEED, generations=24, starts=f"{LINEAR}, {LINEAR}"))
    means = champion.history[:, 1]
    assert len(means) == 6 + 12
    assert means[6] > means[:3].max()  # begun again, the mean would fall to that of the first generation


@pytest.mark.parametrize("generations", [1, 5, 9])
def test_a_search_that_was_stopped_ends_with_the_same_champion(evolved, whole, generations, tmp_path):
    file = CheckpointFile(tmp_path / "checkpoint")
    with pytest.raises(Stop):
        evolved(checkpoint=file, progress=StopAfter(generations))
    assert_same(evolved(checkpoint=file), whole)


def test_repeats_are_more_starts(evolved):
    champion = evolved(replace(SETTINGS, repeats=2, starts=LINEAR, generations=8))
    assert len(champion.seed_fitness) == 3
    assert not np.array_equal(champion.finalists[0].parameters, champion.finalists[1].parameters)


@pytest.mark.parametrize(
    "text, error, words",
    [
        ("linear", InvalidArgument, r"expected start\(controller=SPEC, strategy=SPEC\), got linear"),
        ("start(law=linear)", InvalidArgument, r"got start\(law=linear\)"),
        ("start(controller=lineer)", UnknownName, "linear"),
        ("start(strategy=cma)", UnknownName, "cma_es"),
    ],
)
def test_what_is_no_start_is_refused(text, error, words):
    with pytest.raises(error, match=words):
        Start.listed(text)
