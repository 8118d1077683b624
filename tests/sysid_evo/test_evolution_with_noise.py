"""Controllers evolved under noise: it is met in evolution, by every model, and decides the result."""

import numpy as np
import pytest

from evaluation.cells.controllers import EvolveCell, evolution_settings
from evaluation.cells.plants import Plant
from evaluation.experiment import Experiment
from sysid_evo.engine import DynamicsRunner
from sysid_evo.engine.rollout import Discounted
from sysid_evo.errors import InvalidArgument, UnknownName
from sysid_evo.evolution import ControllerEvolution, evolve_controller, polish
from sysid_evo.evolution.controller_evolution import met
from sysid_evo.models import NoisySensors, Perturbed
from sysid_evo.models.base import make_model
from sysid_evo.registry import Spec
from sysid_evo.testing import example_dataset

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
