"""The nearest-neighbour family, the cells that sort its data, and the distance of several neighbours."""

import tracemalloc
from itertools import product

import numpy as np
import pytest

from model_zoo.control_grid import ControlGrid
from model_zoo.neighbours import KNeighbours
from sysid_evo.data import Dataset
from sysid_evo.errors import IncompatibleSystem, InvalidArgument
from sysid_evo.models.base import make_model
from sysid_evo.system import Channel, System
from tests.fixtures.systems import AUTONOMOUS, DRIVEN

pytestmark = pytest.mark.filterwarnings("ignore::sysid_evo.errors.DataWarning")  # some fits are to two steps


def test_a_recorded_state_under_its_command_gives_the_recorded_acceleration(car_data):
    model = make_model("nearest_neighbour").fit(car_data, rng=0)
    data = car_data.transitions()
    expected = car_data.system.acceleration(data.carry, data.after)
    np.testing.assert_array_equal(model.acceleration(data.carry, data.control), expected)
    np.testing.assert_allclose(model.step(data.carry, data.control), data.after, atol=1e-12)


def test_the_nearest_state_under_the_same_command_is_what_counts(car_data):
    """Against a search through the whole table, one query at a time."""
    model = make_model("nearest_neighbour").fit(car_data, rng=0)
    data = car_data.transitions()
    accelerations = car_data.system.acceleration(data.carry, data.after)
    rng = np.random.default_rng(1)
    states = data.carry[rng.integers(len(data), size=60)] + 0.3 * rng.standard_normal((60, 3))
    controls = rng.integers(-1, 2, (60, 2)).astype(float)
    found = model.acceleration(states, controls)
    for state, control, acceleration in zip(states, controls, found, strict=True):
        same = np.flatnonzero((data.control == control).all(axis=1))
        nearest = same[np.argmin(np.linalg.norm(data.carry[same] - state, axis=1))]
        np.testing.assert_array_equal(acceleration, accelerations[nearest])


def test_a_continuous_control_joins_the_state_inside_its_cell(throttle_car_data):
    model = make_model("nearest_neighbour", levels=3).fit(throttle_car_data, rng=0)
    data = throttle_car_data.transitions()
    accelerations = throttle_car_data.system.acceleration(data.carry, data.after)
    middle = np.array([[0.0, 0.5, 1.0], [-1.0, 0.0, 1.0]])
    cell = np.stack([np.abs(data.control[:, [i]] - middle[i]).argmin(axis=1) for i in (0, 1)], axis=1)
    rng = np.random.default_rng(1)
    states = data.carry[rng.integers(len(data), size=40)]
    controls = rng.uniform([0.0, -1.0], [1.0, 1.0], (40, 2))
    found = model.acceleration(states, controls)
    for state, control, acceleration in zip(states, controls, found, strict=True):
        mine = [np.abs(control[i] - middle[i]).argmin() for i in (0, 1)]
        same = np.flatnonzero((cell == mine).all(axis=1))
        far = (
            np.linalg.norm(data.carry[same] - state, axis=1) ** 2
            + np.linalg.norm(data.control[same] - control, axis=1) ** 2
        )
        np.testing.assert_array_equal(acceleration, accelerations[same[np.argmin(far)]])


def test_a_command_that_was_never_recorded_uses_the_nearest_one_that_was(car):
    """Only straight ahead and back to the left are known: ahead to the left is nearer to the first."""
    pushed, pulled = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]]), np.array([[1.0, 0.0, 0.0], [0.8, 0.0, 0.0]])
    recorded = Dataset.from_arrays(car, [pushed, pulled], [[[1.0, 0.0]], [[-1.0, 1.0]]])
    model = make_model("nearest_neighbour").fit(recorded, rng=0)
    anywhere = np.full((3, 3), 5.0)
    asked = np.array([[1.0, 1.0], [-1.0, 0.0], [-1.0, -1.0]])
    np.testing.assert_allclose(model.acceleration(anywhere, asked)[:, 0], [2.0, -4.0, -4.0], rtol=1e-9)
    # no command is one step away from straight ahead and two from back to the left
    np.testing.assert_allclose(model.acceleration(anywhere[:1], np.zeros((1, 2)))[:, 0], [2.0], rtol=1e-9)


def test_a_second_fit_forgets_the_first(car_data, throttle_car_data):
    model = make_model("nearest_neighbour").fit(car_data, rng=0)
    model.step(np.zeros((1, 3)), np.zeros((1, 2)))
    model.fit(throttle_car_data, rng=0)
    data = throttle_car_data.transitions()
    np.testing.assert_allclose(model.step(data.carry, data.control), data.after, atol=1e-12)


def cells(*controls, levels=3):
    return ControlGrid.of(System((Channel("x"),), controls, dt=0.1), levels)


def test_every_pair_of_levels_is_a_cell_and_its_own_centre():
    grid = cells(Channel("a", levels=(-1, 0, 1)), Channel("b", low=0.0, high=1.0), levels=4)
    assert grid.count == 12
    assert grid.exact == (1,)
    every = np.array(list(product(*grid.levels)), dtype=np.float64)
    np.testing.assert_array_equal(grid.index(every), np.arange(12))
    np.testing.assert_allclose(np.unique(every[:, 1]), [0.0, 1 / 3, 2 / 3, 1.0])


def test_a_control_belongs_to_its_nearest_level_also_beyond_the_limits():
    grid = cells(Channel("b", low=-1.0, high=1.0))
    np.testing.assert_array_equal(
        grid.index(np.array([[-9.0], [-0.51], [-0.49], [0.49], [0.51], [9.0]])), [0, 0, 1, 1, 2, 2]
    )


def test_a_filled_cell_serves_itself_and_an_empty_one_is_served_by_the_nearest_in_shares_of_the_range():
    """A step of the first channel is half its range, a step of the second a tenth of its own."""
    grid = cells(Channel("a", levels=(-1, 0, 1)), Channel("b", levels=tuple(range(11))))
    filled = np.array([0, 11 + 10])  # (-1, 0) and (0, 10)
    served = grid.fallback(filled)
    assert set(served) == set(filled)
    assert served[0] == 0
    assert served[21] == 21
    assert served[6] == 0  # (-1, 6): 0.6 from the first; 0.5 and 0.4, together 0.64, from the second
    assert served[11 + 1] == 0  # (0, 1): 0.5 and 0.1 from the first, 0.9 from the second
    assert served[22 + 9] == 21  # (1, 9)


def test_a_control_that_cannot_be_cut_into_cells_is_refused():
    with pytest.raises(IncompatibleSystem, match=r"control 'f' is continuous and has no limits.*give limits"):
        cells(Channel("f", "N"))
    with pytest.raises(IncompatibleSystem, match=r"expected at most 1,048,576 commands, got .* = 1,594,323"):
        cells(*(Channel(f"u{i}", low=-1.0, high=1.0) for i in range(13)))
    with pytest.raises(InvalidArgument, match="NearestNeighbour: levels: expected a whole number >= 2, got 1"):
        make_model("nearest_neighbour", levels=1)
    system = System((Channel("x"),), (Channel("f", "N"),), dt=0.1)
    endless = Dataset.from_arrays(system, [np.zeros((5, 1))], [np.zeros((4, 1))])
    model = make_model("nearest_neighbour")
    with pytest.raises(IncompatibleSystem, match="control 'f'"):
        model.fit(endless, rng=0)
    assert not hasattr(model, "system_")


@pytest.mark.parametrize(
    "family", ["nearest_neighbour", pytest.param("backprop27(epochs=2)", marks=pytest.mark.nightly)]
)
def test_ten_controls_take_little_memory_and_twenty_are_refused_with_the_bytes(family):
    """Every sample has a command of its own among 59,049, each of which is served by the nearest recorded one."""

    def recorded(controls):
        names = tuple(Channel(f"u{i}", low=-1.0, high=1.0) for i in range(controls))
        rng = np.random.default_rng(0)
        values = rng.uniform(-1.0, 1.0, (300, controls))
        return Dataset.from_arrays(System((Channel("x"),), names, dt=0.1), [rng.standard_normal((301, 1))], [values])

    dataset = recorded(10)
    tracemalloc.start()
    model = make_model(family).fit(dataset, rng=0)
    after = model.step(np.zeros((5, 1)), np.full((5, 10), 0.9))
    kernel = model.kernel()
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert np.isfinite(after).all()
    assert most < 3e8
    assert kernel is None or kernel.parameters.nbytes < 1.5e8
    with pytest.raises(IncompatibleSystem, match=r"= 3,486,784,401: .* 111\.58 GB; use fewer levels"):
        make_model(family).fit(recorded(20))


def test_too_many_commands_for_the_compiled_form_run_in_numpy():
    """Every table is filled up to 256 points, so that many small ones are larger than their points."""
    rng = np.random.default_rng(0)
    states, controls = (Channel(f"x{i}") for i in range(40)), (Channel(f"u{i}", low=-1.0, high=1.0) for i in range(8))
    system, x, u = (
        System(tuple(states), tuple(controls), dt=0.1),
        rng.standard_normal((1001, 40)),
        rng.uniform(-1.0, 1.0, (1000, 8)),
    )
    for n, compiles in ((100, True), (1000, False)):
        model = make_model("nearest_neighbour").fit(Dataset.from_arrays(system, [x[: n + 1]], [u[:n]]))
        assert (model.kernel() is not None) == compiles


def test_earlier_samples_count_half_in_the_distance_and_controls_as_much_as_asked():
    model = make_model("k_neighbours", neighbours=4, state_lags=1, control_lags=2, control_weight=3.0)
    learned = DRIVEN.recording(seed=1)
    metric = model.fit(learned).metric_
    np.testing.assert_allclose(metric[2:4] / metric[:2], 0.5)
    np.testing.assert_allclose(metric[4:6] / metric[6], 0.5 / 3.0)


def test_without_controls_the_distance_of_k_neighbours_weighs_states_fully_and_earlier_ones_half():
    model = make_model("k_neighbours", neighbours=4, state_lags=1, control_lags=0, control_weight=9.0)
    model.fit(AUTONOMOUS.recording(), rng=0)
    np.testing.assert_allclose(model.metric_[2:] / model.metric_[:2], 0.5)


def test_predictions_stay_within_the_range_of_the_neighbours(car_data):
    model = KNeighbours(neighbours=8, state_lags=0, control_lags=0).fit(car_data, rng=0)
    edge = np.tile(model.high_, (4, 1))
    after = model.next_state(edge, np.ones((4, 2)))
    rounding = 1e-12  # of the difference of two states
    assert (after - edge <= model.changes_.max(axis=0) + rounding).all()
    assert (after - edge >= model.changes_.min(axis=0) - rounding).all()
    beyond = model.next_state(edge + 5.0, np.ones((4, 2)))
    assert (beyond < edge + 2.0).all()
