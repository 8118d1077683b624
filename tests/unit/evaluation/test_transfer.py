"""Transfer: a cell is what the rollout says, and the summary is arithmetic on cells."""

import numpy as np
import pytest
from scipy.stats import spearmanr

from evaluation.storage import load_result, plain, save_result
from evaluation.transfer.matrix import TransferMatrix, transfer, transfer_seeds, try_controller
from evaluation.transfer.matrix import TransferResult as Cell
from evaluation.transfer.summary import mean_ranks, summarise
from sysid_evo.controllers.controller import make_controller
from sysid_evo.engine import DynamicsRunner, rollout
from sysid_evo.errors import ArtefactError, InvalidArgument
from sysid_evo.evolution.controller_evolution import SELECTION
from sysid_evo.randomness import trial_seeds
from sysid_evo.tasks.task import make_task
from tests.fixtures.known_models import Boxed, Known, Stopped, Undefined, Weak, fitted
from tests.fixtures.reports import Unplugged, champion, paper_matrix


def test_a_cell_holds_the_numbers_of_the_rollout():
    model, driver, seeds = fitted(Boxed()), champion("c", ("boxed",), seed=3), transfer_seeds(7, 6)
    cell = try_controller(driver, "boxed", DynamicsRunner(model, engine="reference"), seeds, traces=2)
    task, controller = make_task("point_to_point", horizon=60), make_controller("recurrent")
    expected = rollout(model, controller, driver.parameters[None], task, seeds, engine="reference")
    np.testing.assert_array_equal(cell.fitness, expected.fitness[0])
    assert cell.mean == expected.fitness.mean()
    assert cell.std == pytest.approx(expected.fitness.std(ddof=1))
    assert cell.standard_error == pytest.approx(cell.std / np.sqrt(6))
    assert cell.clipped_share > 0.1
    assert cell.clipped_share == pytest.approx(expected.clipped.sum() / expected.survived.sum())
    assert cell.engine == expected.engine
    assert cell.unit == "waypoints"
    assert len(cell.traces) == 2


def test_all_cells_meet_the_same_trials_and_record_where_it_is_needed():
    runners = {"known": DynamicsRunner(fitted(Known())), "weak": DynamicsRunner(fitted(Weak()))}
    matrix = transfer([champion("c", ("known",))], runners, seed=1, robot="weak", trials=4, traces=3)
    own, robot = matrix.cell("c", "known"), matrix.cell("c", "weak")
    assert len(own.traces) == len(robot.traces) == 3
    for here, there in zip(own.traces, robot.traces, strict=True):
        np.testing.assert_array_equal(here.waypoints[0], there.waypoints[0])
        assert here.waypoint_radius == 0.3


def test_fresh_trials_are_those_neither_of_evolution_nor_of_the_choice_of_the_champion():
    evolved = np.concatenate([trial_seeds(7, 10, generation=g) for g in range(50)])
    chosen = trial_seeds(7, 100, generation=SELECTION)
    assert not np.isin(transfer_seeds(7, 100), [*evolved, *chosen]).any()


def test_a_column_that_fails_is_a_cell_with_its_reason():
    runners = {"known": DynamicsRunner(fitted(Known())), "car": Unplugged()}
    matrix = transfer([champion("c", ("known",))], runners, seed=1, robot="car", trials=3)
    reason = str(matrix.cell("c", "car").reason)
    assert reason.startswith("ConnectionError: no answer from the car (reports.py, line ")
    assert np.isnan(matrix.cell("c", "car").mean)
    assert not matrix.cell("c", "known").failed
    summary = summarise(matrix).controller("c")
    assert summary.achieved is None
    assert summary.reality_gap is None


def test_ctrl_c_while_a_controller_runs_is_no_failed_cell():
    with pytest.raises(KeyboardInterrupt):
        try_controller(champion("c", ("s",)), "s", DynamicsRunner(fitted(Stopped())), transfer_seeds(0, 2))


def test_trials_that_diverge_are_counted():
    cell = try_controller(champion("c", ("u",)), "u", DynamicsRunner(fitted(Undefined())), transfer_seeds(0, 5))
    assert cell.diverged_share == 1.0
    assert cell.mean < 0.0


def test_the_papers_table_gives_the_papers_gaps():
    summary = summarise(paper_matrix())
    bp27c, mm1c = summary.controller("bp27c"), summary.controller("mm1c")
    assert bp27c.claimed.value == pytest.approx(18.6)
    assert bp27c.reality_gap.value == pytest.approx(18.6 - 9.33)
    assert bp27c.exploitation_gap.value == pytest.approx(18.6 - (9 + 1.3 + 14) / 3)
    assert mm1c.claimed.value == pytest.approx(12.0)
    assert mm1c.other_models.value == pytest.approx(7.5)
    assert mm1c.kept.value == pytest.approx(8.33 / 12.0)


def test_the_median_on_other_families_is_highest_for_the_best_controller_of_the_paper():
    matrix = paper_matrix()
    summary = summarise(matrix)
    assert summary.pick is None  # picking is left to the forecast
    judged = {c.name: c.other_families.value for c in summary.controllers if c.other_families}
    assert judged == pytest.approx({"bp27c": 9.0, "paramc": 15.5, "evo3c": 0.3, "nnc": 5.0, "mm1c": 7.5})
    assert max(judged, key=judged.__getitem__) == "paramc"
    assert summary.controller("paramc").other_family_models == ("backprop27", "evolved3", "nearest_neighbour")


def test_rank_correlations_are_spearmans():
    claimed, other = summarise(paper_matrix()).correlations
    # ranks of claimed 5 3 2 4 1 and of the medians on other families 4 5 1 2 3 against achieved 4 5 1 2 3
    assert claimed.value == pytest.approx(1 - 6 * (1 + 4 + 1 + 4 + 4) / (5 * 24))
    assert other.value == pytest.approx(1.0)
    assert other.controllers == 5


def summary_of_means(rows, champions, **keywords):
    """Return the summary of controllers whose trials all gave these means."""
    cells = [Cell(name, column, np.full(2, v)) for name, row in rows.items() for column, v in row.items()]
    columns = tuple(dict.fromkeys(cell.column for cell in cells))
    return summarise(TransferMatrix.of(champions, columns, cells, **keywords))


def test_a_model_of_the_same_family_is_no_judge():
    families = {"a-1": "a", "a-2": "a", "b-1": "b"}
    rows = {"c": {"a-1": 9.0, "a-2": 8.0, "b-1": 3.0}}
    summary = summary_of_means(rows, [champion("c", ("a-1",))], families=families).controller("c")
    assert summary.other_family_models == ("b-1",)
    assert summary.other_models.value == pytest.approx(5.5)


def test_a_controller_evolved_on_the_robot_is_in_no_correlation():
    rows = {name: {"car": 5.0, "a": 5.0, "b": 5.0} for name in ("cheat", "c")}
    summary = summary_of_means(rows, [champion("cheat", ("car",)), champion("c", ("a",))], robot="car")
    assert summary.controller("cheat").evolved_on_robot
    assert [correlation.controllers for correlation in summary.correlations] == [1, 1]


def test_the_aggregate_of_the_evolution_makes_the_claim():
    rows = {name: {"a": 2.0, "b": 6.0} for name in ("low", "mid")}
    summary = summary_of_means(rows, [champion("low", ("a", "b")), champion("mid", ("a", "b"), aggregate="mean")])
    assert [c.claimed.value for c in summary.controllers] == [2.0, 4.0]
    assert all(c.other_models is None and c.exploitation_gap is None for c in summary.controllers)
    assert summary.pick is None
    assert summary.correlations == ()


def test_the_error_of_a_gap_is_that_of_paired_trials(rng):
    luck = rng.normal(size=400)
    cells = [Cell("c", "a", 5.0 + luck), Cell("c", "b", 3.0 + luck + 0.1 * rng.normal(size=400))]
    summary = summarise(TransferMatrix.of([champion("c", ("a",))], ("a", "b"), cells)).controller("c")
    assert summary.claimed.standard_error == pytest.approx(luck.std() / 20, rel=0.15)
    assert summary.exploitation_gap.standard_error == pytest.approx(0.1 / 20, rel=0.2)


def test_a_missing_cell_is_a_failed_one_and_the_robot_comes_last():
    matrix = TransferMatrix.of([champion("c", ("a",))], ("car", "a"), [], robot="car")
    assert matrix.columns == ("a", "car")
    assert matrix.cell("c", "a").reason == "not run"
    with pytest.raises(InvalidArgument, match="robot 'bus'"):
        TransferMatrix.of([champion("c", ("a",))], ("a",), [], robot="bus")


@pytest.mark.parametrize("traces", [0, 2])
def test_a_cell_on_disk_keeps_every_bit_of_its_traces(tmp_path, traces):
    driver, runner = champion("c", ("boxed",), seed=3), DynamicsRunner(fitted(Boxed()))
    cell = try_controller(driver, "boxed", runner, transfer_seeds(7, 3), traces=traces)
    files = save_result(cell, tmp_path / "here" / "c@boxed")
    assert all(file.is_file() for file in files)
    again = load_result(Cell, tmp_path / "here" / "c@boxed")
    assert plain(again) == plain(cell)
    assert again.fitness.dtype == cell.fitness.dtype == np.float64
    assert len(again.traces) == traces
    files[0].write_bytes(b"damaged")
    with pytest.raises(ArtefactError, match="not a stored TransferResult"):
        load_result(Cell, tmp_path / "here" / "c@boxed")


def test_the_correlation_of_mean_ranks_is_that_of_scipy_with_ties_too():
    rng = np.random.default_rng(5)
    for size in (3, 4, 12):
        first, second = rng.integers(0, size, (2, size)).astype(float)
        first[:2], second[1:3] = (0.5, 1.5), (1.5, 0.5)
        expected = float(spearmanr(first, second).statistic)
        np.testing.assert_allclose(np.corrcoef(mean_ranks(first), mean_ranks(second))[0, 1], expected, atol=1e-14)
