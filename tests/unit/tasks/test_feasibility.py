"""A robot that cannot do its task is told so before anything is evolved."""

import numpy as np
import pytest

from evaluation.experiment import Experiment
from evaluation.planning import plan_comparison
from sysid_evo.errors import InvalidArgument
from sysid_evo.evolution.controller_evolution import ControllerEvolution, recorded_state_range, simulated_state_range
from sysid_evo.registry import make_robot
from sysid_evo.tasks import PointToPoint
from sysid_evo.testing import example_dataset
from sysid_evo.testing.examples import ExampleDynamics, pendulum


def doubts(car, farthest, **sizes):
    return PointToPoint(**sizes).bind(car).feasibility_warnings(np.array(farthest))


def test_a_controller_that_fits_into_no_memory_is_refused_with_what_it_would_need(car):
    settings = ControllerEvolution(controller="recurrent(hidden=1000000000)")
    controller = settings.make_controller(settings.make_task(car))
    with pytest.raises(InvalidArgument, match=r"000 parameters is too large for .* two candidates take 1.6e\+10"):
        settings.make_strategy(controller.n_parameters, 0)
    experiment = Experiment(robot="emulated_car", minutes=1.0, models=("linear",), generations=10**23)
    with pytest.raises(InvalidArgument, match=r"would take about \S+ years on one processor"):
        plan_comparison(experiment)


def test_unreachable_waypoints_give_a_warning_with_feasible_sizes(car):
    """At 0.1 m/s 2.5 m in 25 s; two random points of a disc of 1.5 m are 1.36 m apart, less the radius 1.06 m."""
    (sentence,) = doubts(car, [0.1, 0.0, 3.0])
    assert "drives 2.5 m in a trial of 25 s" in sentence
    assert "the mean distance between waypoints is 1.1 m: it can pass about 2.4" in sentence
    assert "arena_radius=0.61" in sentence
    assert "horizon=2117" in sentence
    assert doubts(car, [0.1, 0.0, 3.0], horizon=2117) == ()
    assert doubts(car, [0.1, 0.0, 3.0], arena_radius=0.6) == ()


def test_a_robot_that_never_moves_jumps_or_cannot_turn_gives_a_warning(car):
    assert "does not move in the recording" in doubts(car, [0.0, 0.0, 0.0])[0]
    assert "drives 1 m in one step and may jump over" in doubts(car, [20.0, 0.0, 30.0])[0]
    assert "in circles of 20 m, in an arena of 1.5 m" in doubts(car, [2.0, 0.0, 0.1])[0]
    assert "in no circle" in doubts(car, [2.0, 0.0, 0.0])[0]


def test_how_far_states_go_is_seen_in_recordings_and_under_extreme_commands():
    car = make_robot("emulated_car").dynamics
    farthest = simulated_state_range(car)
    assert farthest is not None
    assert 1.7 < farthest[0] < 2.3
    assert 2.0 < farthest[2] < 12.0
    data = example_dataset()
    speeds = np.abs(np.concatenate([episode.states for episode in data]))
    assert np.mean(speeds <= recorded_state_range(data), axis=0) == pytest.approx(0.99, abs=0.01)
    swinging = simulated_state_range(ExampleDynamics(pendulum()))
    assert swinging is not None
    assert swinging[0] > 0.0


def test_a_comparison_warns_before_any_work_for_recordings_and_for_an_emulated_robot():
    far = "point_to_point(arena_radius=60)"
    for plan in (
        plan_comparison(Experiment(task=far, robot="emulated_car", models=("linear",))),
        plan_comparison(Experiment(task=far, models=("linear",)), dataset=example_dataset()),
    ):
        assert any("Use a smaller arena" in remark for remark in plan.plan.remarks)
    with pytest.raises(InvalidArgument, match=r"evolve linear would take about .* years on one processor"):
        plan_comparison(
            Experiment(task="point_to_point(horizon=100000000000000)", models=("linear",)), dataset=example_dataset()
        )
    usual = plan_comparison(Experiment(robot="emulated_car", models=("linear",)))
    assert not any("point_to_point" in remark for remark in usual.plan.remarks)
