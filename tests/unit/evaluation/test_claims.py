"""Claims: one statistic wherever they are made, and the rule for "exploited" to the digit."""

import numpy as np
import pytest

from evaluation.exploitability.assessment import assess_exploitability
from evaluation.transfer.matrix import TransferMatrix
from evaluation.transfer.matrix import TransferResult as Cell
from evaluation.transfer.summary import MatrixEstimates, is_exploited, summarise
from sysid_evo.validation.estimates import Estimate
from tests.fixtures.known_models import recording
from tests.fixtures.reports import champion


def matrix_of(*cells, against=("a",), aggregate="min"):
    columns = tuple(cell.column for cell in cells)
    robot = "car" if "car" in columns else None
    return TransferMatrix.of([champion("c", against, aggregate=aggregate)], columns, cells, robot=robot)


def test_the_claim_and_its_error_are_the_same_in_transfer_and_exploitability(rng):
    cells = [Cell("c", name, mean + rng.normal(size=30)) for name, mean in (("a", 9.0), ("b", 6.0), ("car", 5.0))]
    matrix = matrix_of(*cells)
    controller = summarise(matrix).controller("c")
    model = assess_exploitability(matrix, recording(), recording(1, seed=2))[0]
    for name in ("claimed", "other_models", "achieved"):
        assert getattr(model, name) == getattr(controller, name)
    assert model.gap == controller.reality_gap
    assert model.exploited is controller.exploited is True


@pytest.mark.parametrize("trials", [2, 5, 100])
def test_the_error_of_a_claim_is_the_standard_error_of_the_mean(rng, trials):
    cell = Cell("c", "a", rng.normal(size=trials))
    claimed = summarise(matrix_of(cell)).controller("c").claimed
    assert claimed.value == cell.mean
    assert claimed.standard_error == pytest.approx(cell.standard_error, rel=0.08)


def test_every_draw_of_trials_goes_through_the_rule_of_the_evolution():
    here, there = np.array([0.0, 4.0, 1.0, 5.0]), np.array([4.0, 0.0, 5.0, 1.0])
    cells = (Cell("c", "a", here), Cell("c", "b", there))
    figures = MatrixEstimates(matrix_of(*cells, against=("a", "b")))
    least, mean = (figures.on(champion("c", ("a", "b"), aggregate=rule), ("a", "b")) for rule in ("min", "mean"))
    assert least.value == mean.value == 2.5
    # the mean of both models hardly changes with the trials that are drawn; the lower of the two does
    assert least.values[1:].mean() < 2.0
    assert mean.values[1:].mean() == pytest.approx(2.5, abs=0.05)


def test_a_claim_needs_every_model_that_it_is_about():
    ran, failed = Cell("c", "a", np.ones(3)), Cell("c", "b", reason="no answer")
    assert MatrixEstimates(matrix_of(ran, failed)).on(champion("c", ("a",)), ("a", "b")) is None
    assert MatrixEstimates(matrix_of(ran)).on(champion("c", ("a",)), ("a", "gone")) is None
    assert MatrixEstimates(matrix_of(ran)).on(champion("c", ()), ()) is None


def test_models_with_different_trials_are_joined_over_the_trials_of_both():
    cells = (Cell("c", "a", np.array([1.0, 3.0, 50.0])), Cell("c", "b", np.array([4.0, 6.0])))
    drawn = MatrixEstimates(matrix_of(*cells)).on(champion("c", ("a", "b"), aggregate="mean"), ("a", "b"))
    assert (drawn.value, drawn.blocks) == (3.5, 2)


def test_differences_over_as_many_trials_are_paired_and_others_are_not(rng):
    """On a robot that left a trial out the later ones are others."""
    luck = rng.normal(size=20)
    for trials, paired in ((20, True), (19, False)):
        gap = summarise(matrix_of(Cell("c", "a", luck + 3.0), Cell("c", "car", luck[:trials]))).controller("c").gap
        assert (gap.standard_error < 0.01) == paired
        assert gap.value == pytest.approx(3.0, abs=0.1)


def test_intervals_of_claims_hold_the_truth_in_nineteen_of_twenty_comparisons(rng):
    """Of 150 with ten trials, whose luck is shared by all systems and controllers."""
    truth, held = {"claimed": 12.0, "achieved": 9.0, "reality_gap": 3.0, "kept": 0.75}, {}
    for _ in range(150):
        luck = 2.0 * rng.normal(size=10) + rng.normal(size=(3, 10))
        cells = (Cell("c", "a", 12.0 + luck[0]), Cell("c", "car", 9.0 + luck[1]), Cell("d", "car", 10.0 + luck[2]))
        rivals = [champion("c", ("a",)), champion("d", ("b",))]
        found = summarise(TransferMatrix.of(rivals, ("a", "car"), cells, robot="car")).controller("c")
        for name, value in truth.items():
            held.setdefault(name, []).append(not getattr(found, name).differs_from(value))
    assert all(0.9 <= np.mean(each) <= 0.99 for each in held.values()), {k: np.mean(v) for k, v in held.items()}


@pytest.mark.parametrize(
    "claimed, gap, low, exploited",
    [
        (10.0, 0.99, 0.9, False),
        (10.0, 1.01, 0.9, True),
        (10.0, 4.0, -0.01, False),
        (10.0, 4.0, 0.01, True),
        (-10.0, 0.99, 0.9, False),
        (-10.0, 1.01, 0.9, True),
        (10.0, 9.0, float("nan"), None),
    ],
)
def test_a_claim_is_exploited_if_it_is_surely_too_high_and_by_a_tenth(claimed, gap, low, exploited):
    assert is_exploited(Estimate(claimed, 0.1), Estimate(gap, low, low, 2 * gap - low)) is exploited


def test_nothing_is_exploited_where_nothing_is_claimed_or_nowhere_else_is_tested():
    assert is_exploited(None, Estimate(1.0, 0.1)) is None
    assert is_exploited(Estimate(1.0, 0.1), None) is None


def test_a_controller_is_judged_by_the_robot_and_without_one_by_the_other_models():
    own, other, robot = (Cell("c", name, np.full(4, v)) for name, v in (("a", 9.0), ("b", 1.0), ("car", 9.0)))
    on_robot = summarise(matrix_of(own, other, robot)).controller("c")
    on_models = summarise(matrix_of(own, other)).controller("c")
    assert (on_robot.exploited, on_models.exploited) == (False, True)
    assert on_robot.elsewhere == on_robot.achieved
    assert on_models.elsewhere == on_models.other_models


def test_a_controller_evolved_on_the_robot_itself_exploits_nothing():
    cells = (Cell("c", "a", np.full(4, 9.0)), Cell("c", "car", np.full(4, 9.0)))
    assert summarise(matrix_of(*cells, against=("car",))).controller("c").exploited is None
