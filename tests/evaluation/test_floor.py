"""Controls at rest are a row of the matrix where they may bring something."""

import pytest

from evaluation.experiment import Experiment
from evaluation.planning import plan_comparison
from tests.fixtures.known_models import recording


@pytest.mark.parametrize(
    ("id", "by_hand", "rows"),
    [
        ("Pendulum-v1", (), ["linear", "rest"]),
        ("Pendulum-v1", ("still=constant",), ["linear", "still"]),
        ("CartPole-v1", (), ["linear", "rest"]),
    ],
)
def test_controls_at_rest_are_a_row_where_they_may_bring_something(id, by_hand, rows):  # noqa: A002  # as Gymnasium calls it
    task, robot = f'environment(id="{id}")', f'gymnasium(id="{id}")'
    planned = plan_comparison(Experiment(robot=robot, task=task, models=("linear",), by_hand=by_hand))
    assert planned.matrix is not None
    assert [champion.name for champion in planned.matrix.champions] == rows
    own = plan_comparison(Experiment(robot=robot, models=("linear",), by_hand=by_hand))
    assert own.experiment.task == task  # without --task it is the environment's own
    assert [cell.digest for cell in own.plan] == [cell.digest for cell in planned.plan]
    only = plan_comparison(Experiment(robot=robot, models=("linear",), only="fit"))
    assert only.matrix is None


def test_controls_at_rest_are_no_row_where_they_are_known_to_bring_nothing():
    planned = plan_comparison(Experiment(models=("linear",), yardstick=False))
    assert planned.matrix is not None
    assert [champion.name for champion in planned.matrix.champions] == ["linear"]


def test_controls_at_rest_are_a_row_without_a_robot():
    task = 'set_point(channels="forward_speed")'
    without_robot = plan_comparison(Experiment(models=("linear",), task=task), dataset=recording(3, steps=400))
    assert without_robot.matrix is not None
    assert [champion.name for champion in without_robot.matrix.champions] == ["linear", "rest"]
