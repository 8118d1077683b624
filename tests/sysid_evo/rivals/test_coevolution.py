"""Two populations against each other: repeatable, stopped and gone on with, and better than who stands still."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sysid_evo import CheckpointFile, ControllerEvolution, DynamicsRunner
from sysid_evo.errors import IncompatibleSystem, InvalidArgument
from sysid_evo.evolution import Champion, Stage
from sysid_evo.registry import Spec
from sysid_evo.rivals import evolve_rivals, match
from sysid_evo.rivals.coevolution import EVERY, OPPONENTS, Population
from sysid_evo.store import load_champion, save_champion
from sysid_evo.testing.examples import ExampleDynamics, continuous_car, switched_car

CAR = ExampleDynamics(switched_car())
RUNNERS = {"car": DynamicsRunner(CAR, threads=1)}
SETTINGS = ControllerEvolution(
    generations=7,
    trials=2,
    selection_trials=4,
    task=Spec.parse("duel(horizon=60)"),
    controller=Spec.parse("recurrent(hidden=2)"),
    strategy=Spec.parse("mu_plus_lambda(parents=4, children=4)"),
)


def evolved(settings: ControllerEvolution = SETTINGS, **options: Any) -> tuple[Champion, ...]:
    return evolve_rivals("rival", RUNNERS, switched_car(), settings, **{"seed": 1, **options})


def same(ones: tuple[Champion, ...], others: tuple[Champion, ...]) -> bool:
    return all(
        np.array_equal(one.parameters, other.parameters) and np.array_equal(one.history, other.history)
        for one, other in zip(ones, others, strict=True)
    )


def test_the_same_seed_gives_the_same_champions_on_any_number_of_threads() -> None:
    first = evolved()
    again = evolve_rivals("rival", {"car": DynamicsRunner(CAR, threads=2)}, switched_car(), SETTINGS, seed=1)
    assert [one.name for one in first] == ["rival-1", "rival-2"]
    assert same(first, again)
    assert not same(first, evolved(seed=2))


class Stopped(Exception):
    """What stops an evolution in the test."""


def test_what_was_stopped_goes_on_to_the_same_champions(tmp_path: Path) -> None:
    def stop(done: int, total: int, note: str = "") -> None:
        if done == EVERY + 1:
            raise Stopped

    whole, file = evolved(), CheckpointFile(tmp_path / "rivals.checkpoint")
    with pytest.raises(Stopped):
        evolved(checkpoint=file, progress=stop)
    begun: list[int] = []
    rest = evolved(checkpoint=file, progress=lambda done, total, note="": begun.append(done))
    assert begun == [EVERY + 2]
    assert same(whole, rest)


def test_a_champion_drives_ahead_of_one_that_stands_still() -> None:
    best = max(evolved(replace(SETTINGS, generations=25)), key=lambda one: match(one, idle(), CAR, trials=10).won)
    met = match(best, idle(), CAR, task="duel(horizon=60)", trials=20)
    assert met.won > 0.9
    assert match(idle(), best, CAR, task="duel(horizon=60)", trials=20).won < 0.1


def idle() -> Champion:
    """One that gives no command."""
    return Champion(
        "idle", np.zeros(2 * 9), (), "min", 0, np.empty((0, 3)), system=switched_car(),
        controller=Spec.parse("linear"), task=Spec.parse("walled_track"),
    )  # fmt: skip


def test_a_population_may_be_its_own_rival_and_several_models_count_by_the_aggregate() -> None:
    runners = {**RUNNERS, "other": DynamicsRunner(ExampleDynamics(switched_car()), threads=1)}
    (one,) = evolve_rivals("self", runners, switched_car(), replace(SETTINGS, generations=2), seed=0, populations=1)
    assert one.name == "self-1"
    assert one.against == ("car", "other")


def test_opponents_are_parents_and_former_champions_by_turns() -> None:
    class Parents:
        elite = np.zeros((3, 2))

    population = Population(Parents(), np.ones((2, 2)))  # type: ignore[arg-type]  # only its parents are asked for
    drawn = population.opponents(np.random.default_rng(0))
    np.testing.assert_array_equal(drawn[:, 0], [0.0, 1.0] * (OPPONENTS // 2))
    nobody = replace(population, hall=np.empty((0, 2)))
    assert not nobody.opponents(np.random.default_rng(0)).any()


def test_a_stored_champion_races_as_before(tmp_path: Path) -> None:
    first, second = evolved(replace(SETTINGS, generations=2))
    stored = load_champion(save_champion(first, tmp_path / "first"))
    leads = [match(one, second, CAR, task="duel(horizon=60)", trials=5).lead for one in (first, stored)]
    np.testing.assert_array_equal(*leads)
    with pytest.raises(IncompatibleSystem):
        match(first, second, ExampleDynamics(continuous_car()))


@pytest.mark.parametrize(
    "wrong, told",
    [
        ({"task": Spec("walled_track")}, "rivals race at duel"),
        ({"runs": 2}, "one run"),
        ({"schedule": (Stage(at_most=1),)}, "without a schedule"),
    ],
)
def test_settings_that_do_not_fit_are_refused(wrong: dict[str, Any], told: str) -> None:
    with pytest.raises(InvalidArgument, match=told):
        evolved(replace(SETTINGS, **wrong))
    with pytest.raises(InvalidArgument, match="one or two populations"):
        evolved(populations=3)
    runners = {**RUNNERS, "other": DynamicsRunner(ExampleDynamics(continuous_car()))}
    with pytest.raises(IncompatibleSystem, match="other is of another system"):
        evolve_rivals("rival", runners, switched_car(), SETTINGS, seed=0)
