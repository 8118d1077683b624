"""The short benchmarks of pages of results: intervals of studies, the trap, baselines and disturbances."""

import pytest

from tests.benchmarks import baselines, disturbances
from tests.benchmarks.study_intervals import coverage
from tests.benchmarks.trap import STRATEGIES, found


def test_intervals_of_a_study_contain_the_truth_in_95_of_100_cases():
    share, width = coverage(5, 3, 1.0, draws=600)
    assert share == pytest.approx(0.95, abs=0.03)
    assert width == pytest.approx(2 * 2.776 * (4 / 3 / 5) ** 0.5, rel=0.1)  # Student's quantile of four degrees


def test_a_search_by_classes_ends_on_the_steep_hill():
    assert found(STRATEGIES[0], seed=0)


@pytest.mark.nightly
def test_the_regulator_balances_the_pendulum_whose_equations_it_has():
    mean, error, unit = baselines.fitness(*baselines.CASES[0])
    assert mean == pytest.approx(99.8, abs=0.5)
    assert error < 0.5
    assert unit.startswith("%")


@pytest.mark.nightly
def test_every_wrapper_around_a_family_is_timed(tmp_path):
    file = tmp_path / "cost.md"
    given = ["--families", "parametrised", "--repeats", "1", "--horizon", "40", "--markdown", str(file)]
    assert disturbances.main(given) == 0
    assert file.read_text().count("\n|") == 10
