"""The nearest-neighbour family and the cells that sort its data."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from model_zoo.control_grid import CommandCells
from sysid_evo.data import Dataset
from sysid_evo.errors import IncompatibleSystem, InvalidArgument
from sysid_evo.models.base import make_model
from sysid_evo.system import Channel, System

pytestmark = pytest.mark.filterwarnings("ignore::sysid_evo.errors.DataWarning")  # some fits are to two steps


def test_a_recorded_state_under_its_command_gives_the_recorded_acceleration(switched: Dataset) -> None:
    model = make_model("nearest_neighbour").fit(switched, rng=np.random.default_rng(0))
    data = switched.transitions()
    expected = switched.system.acceleration(data.carry, data.after)
    np.testing.assert_array_equal(model.acceleration(data.carry, data.control), expected)
    np.testing.assert_allclose(model.step(data.carry, data.control), data.after, atol=1e-12)


def test_the_nearest_state_under_the_same_command_is_what_counts(switched: Dataset) -> None:
    """Against a search through the whole table, one query at a time."""
    model = make_model("nearest_neighbour").fit(switched, rng=np.random.default_rng(0))
    data = switched.transitions()
    accelerations = switched.system.acceleration(data.carry, data.after)
    rng = np.random.default_rng(1)
    states = data.carry[rng.integers(len(data), size=60)] + 0.3 * rng.standard_normal((60, 3))
    controls = rng.integers(-1, 2, (60, 2)).astype(float)
    found = model.acceleration(states, controls)
    for state, control, acceleration in zip(states, controls, found, strict=True):
        same = np.flatnonzero((data.control == control).all(axis=1))
        nearest = same[np.argmin(np.linalg.norm(data.carry[same] - state, axis=1))]
        np.testing.assert_array_equal(acceleration, accelerations[nearest])


def test_a_continuous_control_joins_the_state_inside_its_cell(proportional: Dataset) -> None:
    model = make_model("nearest_neighbour", levels=3).fit(proportional, rng=np.random.default_rng(0))
    data = proportional.transitions()
    accelerations = proportional.system.acceleration(data.carry, data.after)
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


def test_a_command_that_was_never_recorded_uses_the_nearest_one_that_was(car: System) -> None:
    """Only straight ahead and back to the left are known: ahead to the left is nearer to the first."""
    pushed, pulled = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]]), np.array([[1.0, 0.0, 0.0], [0.8, 0.0, 0.0]])
    recorded = Dataset.from_arrays(car, [pushed, pulled], [[[1.0, 0.0]], [[-1.0, 1.0]]])
    model = make_model("nearest_neighbour").fit(recorded, rng=np.random.default_rng(0))
    anywhere = np.full((3, 3), 5.0)
    asked = np.array([[1.0, 1.0], [-1.0, 0.0], [-1.0, -1.0]])
    np.testing.assert_allclose(model.acceleration(anywhere, asked)[:, 0], [2.0, -4.0, -4.0], rtol=1e-9)
    # no command is one step away from straight ahead and two from back to the left
    np.testing.assert_allclose(model.acceleration(anywhere[:1], np.zeros((1, 2)))[:, 0], [2.0], rtol=1e-9)


def test_a_second_fit_forgets_the_first(switched: Dataset, proportional: Dataset) -> None:
    model = make_model("nearest_neighbour").fit(switched, rng=np.random.default_rng(0))
    model.step(np.zeros((1, 3)), np.zeros((1, 2)))
    model.fit(proportional, rng=np.random.default_rng(0))
    data = proportional.transitions()
    np.testing.assert_allclose(model.step(data.carry, data.control), data.after, atol=1e-12)


def cells(*controls: Channel, levels: int = 3) -> CommandCells:
    return CommandCells.of(System((Channel("x"),), controls, dt=0.1), levels)


def test_every_pair_of_levels_is_a_cell_and_its_own_centre() -> None:
    grid = cells(Channel("a", levels=(-1, 0, 1)), Channel("b", low=0.0, high=1.0), levels=4)
    assert grid.count == 12
    assert grid.exact == (1,)
    np.testing.assert_array_equal(grid.index(grid.centres), np.arange(12))
    np.testing.assert_allclose(np.unique(grid.centres[:, 1]), [0.0, 1 / 3, 2 / 3, 1.0])


def test_a_control_belongs_to_its_nearest_level_also_beyond_the_limits() -> None:
    grid = cells(Channel("b", low=-1.0, high=1.0))
    np.testing.assert_array_equal(
        grid.index(np.array([[-9.0], [-0.51], [-0.49], [0.49], [0.51], [9.0]])), [0, 0, 1, 1, 2, 2]
    )


def test_a_filled_cell_serves_itself_and_an_empty_one_is_served_by_the_nearest_in_shares_of_the_range() -> None:
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


def test_a_control_that_cannot_be_cut_into_cells_is_refused() -> None:
    with pytest.raises(IncompatibleSystem, match=r"control 'f' is continuous and has no limits.*give limits"):
        cells(Channel("f", "N"))
    with pytest.raises(InvalidArgument, match="NearestNeighbour: levels: expected a whole number >= 2, got 1"):
        make_model("nearest_neighbour", levels=1)
    system = System((Channel("x"),), (Channel("f", "N"),), dt=0.1)
    endless = Dataset.from_arrays(system, [np.zeros((5, 1))], [np.zeros((4, 1))])
    model = make_model("nearest_neighbour")
    with pytest.raises(IncompatibleSystem, match="control 'f'"):
        model.fit(endless, rng=np.random.default_rng(0))
    assert not hasattr(model, "system_")


@pytest.mark.parametrize("family", ["nearest_neighbour", "backprop27(epochs=2)"])
def test_ten_controls_take_little_memory_and_twenty_are_refused_with_the_bytes(family: str) -> None:
    """Every sample has a command of its own among 59,049, each of which is served by the nearest recorded one."""

    def recorded(controls: int) -> Dataset:
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


def test_too_many_commands_for_the_compiled_form_run_in_numpy() -> None:
    """Every table is filled up to 256 points, so that many small ones are larger than their points."""
    rng, n = np.random.default_rng(0), 1600
    names = tuple(Channel(f"u{i}", low=-1.0, high=1.0) for i in range(10))
    system = System((Channel("x"), Channel("y"), Channel("z")), names, dt=0.1)
    states, controls = rng.standard_normal((n + 1, 3)), rng.uniform(-1.0, 1.0, (n, 10))
    few = Dataset.from_arrays(system, [states[:401]], [controls[:400]])
    assert make_model("nearest_neighbour").fit(few).kernel() is not None
    several = Dataset.from_arrays(system, [states] * 4, [np.roll(controls, i, axis=1) for i in range(4)])
    assert make_model("nearest_neighbour").fit(several).kernel() is None
