"""Controls at rest are a row of the matrix where fitness may be negative."""

from __future__ import annotations

import pytest

from evaluation.experiment import Experiment
from evaluation.planning import plan_comparison


@pytest.mark.parametrize(
    ("id", "by_hand", "rows"),
    [
        ("Pendulum-v1", (), ["linear", "rest"]),
        ("Pendulum-v1", ("still=constant",), ["linear", "still"]),
        ("CartPole-v1", (), ["linear"]),
    ],
)
def test_controls_at_rest_are_a_row_where_fitness_may_be_negative(
    id: str,  # noqa: A002  # as Gymnasium calls it
    by_hand: tuple[str, ...],
    rows: list[str],
) -> None:
    task, robot = f'environment(id="{id}")', f'gymnasium(id="{id}")'
    planned = plan_comparison(Experiment(robot=robot, task=task, models=("linear",), by_hand=by_hand))
    assert planned.matrix is not None
    assert [champion.name for champion in planned.matrix.champions] == rows
    only = plan_comparison(Experiment(robot=robot, task=task, models=("linear",), only="fit"))
    assert only.matrix is None
