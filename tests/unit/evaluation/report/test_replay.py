"""The replay: what it holds, and when a trial has left the one on the robot."""

import base64
import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from evaluation.report.sections.replay import divergence_time, packed, replay, traces_picture, views
from evaluation.transfer.matrix import Trace, transfer
from evaluation.transfer.matrix import TransferResult as Cell
from sysid_evo.controllers import RecurrentNetwork
from sysid_evo.data import Trajectory
from sysid_evo.engine import DynamicsRunner
from sysid_evo.registry import Spec
from sysid_evo.system import Channel, System
from sysid_evo.tasks import Target
from sysid_evo.tasks.in_space import Hover
from sysid_evo.testing.examples import ExampleDynamics, drone
from tests.fixtures.known_models import Known, Sliding, fitted
from tests.fixtures.reports import EVIL, champion, on_a_plane

ARM = System((Channel("angle", "rad", period=2.0 * np.pi), Channel("speed", "rad/s")), (Channel("torque"),), 0.1)


def unpacked(packed):
    steps = np.frombuffer(base64.b64decode(packed["data"]), dtype="<u2").reshape(-1, len(packed["low"]))
    return np.where(steps == 65535, np.nan, packed["low"] + steps * np.array(packed["step"]))


def of_states(angle, *, target=None):
    states = np.stack([angle, np.zeros_like(angle)], axis=1)
    targets = () if target is None else (Target(ARM.states[0], 0, np.array([target]), 0.1),)
    return Trace(Trajectory(states, np.zeros((len(angle) - 1, 1)), 0.1), 1.0, targets=targets)


def matrix(names=("known", "sliding"), traces=3):
    models = {names[0]: fitted(Known()), names[1]: fitted(Sliding())}
    rows = [champion(f"{name}_c", (name,), seed=2 + i) for i, name in enumerate(names)]
    runners = {name: DynamicsRunner(model) for name, model in {**models, "car": fitted(Known())}.items()}
    return transfer(rows, runners, seed=4, robot="car", trials=3, traces=traces)


def document_of(shown):
    return json.loads(shown.document)


@pytest.fixture(scope="module")
def found():
    return matrix()


def test_every_controller_is_shown_everywhere_the_robot_first_then_where_it_was_evolved(found):
    document = document_of(replay(found))
    order = [(run["row"], run["column"], run["own"], run["robot"]) for run in document["runs"]]
    assert order == [
        ("known_c", "car", False, True),
        ("known_c", "known", True, False),
        ("known_c", "sliding", False, False),
        ("sliding_c", "car", False, True),
        ("sliding_c", "sliding", True, False),
        ("sliding_c", "known", False, False),
    ]
    trace = found.cell("known_c", "known").traces[0]
    shown = document["runs"][1]
    np.testing.assert_allclose(unpacked(shown["pose"]), trace.trajectory.pose, atol=1e-4)
    assert shown["states"] is None
    np.testing.assert_allclose(unpacked(shown["controls"]), trace.trajectory.controls, atol=1e-4)
    np.testing.assert_allclose(shown["markers"], trace.waypoints, atol=5e-4)
    assert shown["dt"] == trace.trajectory.dt


def test_numbers_are_kept_to_a_small_part_of_their_range_and_what_is_none_stays_none():
    values = np.array([[0.0, 1e6, 3.0], [np.nan, 1.0, 3.0], [2.0, np.inf, 3.0], [1e-3, 0.0, 3.0]])
    again = unpacked(packed(values))
    known = np.isfinite(values)
    assert (np.isfinite(again) == known).all()
    assert (
        np.abs(again - values)[known].reshape(-1) <= np.broadcast_to([2.0, 1e6, 1e-9], values.shape)[known] / 65534
    ).all()


def test_a_page_that_would_be_too_large_leaves_out_trials_elsewhere(monkeypatch, found):
    monkeypatch.setattr("evaluation.report.sections.replay.MOST_NUMBERS", 1)
    shown = replay(found)
    assert [(run["row"], run["column"]) for run in document_of(shown)["runs"]] == [
        ("known_c", "car"),
        ("known_c", "known"),
        ("sliding_c", "car"),
        ("sliding_c", "sliding"),
    ]
    assert "2 trials on other models are left out" in shown.caption


def test_the_model_that_is_the_robot_never_leaves_it_and_another_does(found):
    runs = {(run["row"], run["column"]): run for run in document_of(replay(found))["runs"]}
    assert runs["known_c", "known"]["compared"]
    assert runs["known_c", "known"]["apart"] is None
    assert runs["known_c", "sliding"]["apart"] > 0.0
    assert not runs["known_c", "car"]["compared"]


def test_the_controller_to_take_is_shown_first(found):
    assert document_of(replay(found, first="sliding_c"))["first"] == "sliding_c"
    assert document_of(replay(found, first=None))["first"] == "known_c"


def test_without_a_kept_trial_there_is_no_replay(found):
    assert replay(matrix(traces=0)) is None
    failed = {key: Cell(*key, reason="broken") for key in found.cells}
    assert replay(replace(found, cells=failed)) is None


def test_a_row_without_a_kept_trial_is_left_out(found):
    cells = {key: cell if key[0] == "known_c" else Cell(*key, reason="broken") for key, cell in found.cells.items()}
    shown = replay(replace(found, cells=cells))
    assert shown.rows == ("known_c",)


def test_no_name_ends_the_script():
    shown = replay(matrix((EVIL + "</script>", "sliding")))
    assert "<" not in shown.document
    assert EVIL + "</script>" in {run["column"] for run in json.loads(shown.document)["runs"]}


@pytest.mark.parametrize(("ahead", "seconds"), [(0.09, None), (0.11, 0.5)])
def test_bodies_part_where_they_are_a_tenth_of_the_path_apart(ahead, seconds):
    robot = np.linspace(0.0, 1.0, 11)
    model = robot + np.where(np.arange(11) >= 5, ahead, 0.0)
    assert divergence_time(on_a_plane(model), on_a_plane(robot), ARM, paths=True) == seconds


def test_a_trial_that_ends_early_is_compared_as_long_as_it_lasts():
    robot = np.linspace(0.0, 1.0, 11)
    assert divergence_time(on_a_plane(robot[:4]), on_a_plane(robot), ARM, paths=True) is None
    assert divergence_time(on_a_plane(robot), on_a_plane(np.append(robot[:4], 0.8)), ARM, paths=True) == pytest.approx(
        0.4
    )


def test_from_a_robot_that_stands_nothing_parts():
    still, off = np.zeros(11), np.linspace(0.0, 0.3, 11)
    assert divergence_time(on_a_plane(off), on_a_plane(still), ARM, paths=True) is None
    assert divergence_time(of_states(off), of_states(still), ARM, paths=False) is None


def test_a_whole_turn_apart_is_together():
    swing = np.linspace(0.0, 2.0, 11)
    assert divergence_time(of_states(swing + 2.0 * np.pi), of_states(swing), ARM, paths=False) is None
    later = swing + np.where(np.arange(11) >= 3, 0.21, 0.0)
    assert divergence_time(of_states(later), of_states(swing), ARM, paths=False) == pytest.approx(0.3)


def test_a_target_far_away_widens_the_range_but_never_beyond_a_turn():
    still, off = np.zeros(11), np.where(np.arange(11) >= 2, 0.3, 0.0)
    assert divergence_time(of_states(off), of_states(still, target=2.0), ARM, paths=False) == pytest.approx(0.2)
    assert divergence_time(of_states(off), of_states(still, target=3.1), ARM, paths=False) is None
    nearly_a_turn = of_states(np.where(np.arange(11) >= 2, 0.7, 0.0))
    assert divergence_time(nearly_a_turn, of_states(still, target=60.0), ARM, paths=False) == pytest.approx(0.2)


def in_space(frame):
    """A trial that flies north while it climbs, nose up by 45 degrees, past a waypoint."""
    time = np.arange(4.0)
    nose_up = Rotation.from_euler("ZYX", [90.0, -45.0, 0.0], degrees=True)  # to the north, in ENU
    if frame == "NED":
        nose_up = Rotation.from_euler("ZYX", [0.0, 45.0, 0.0], degrees=True)
    place = np.stack([0.0 * time, 2.0 * time, time], axis=1)
    marker = np.array([[0.5, 2.0, 1.0]])
    if frame == "NED":
        place, marker = place[:, [1, 0, 2]] * [1, 1, -1], marker[:, [1, 0, 2]] * [1, 1, -1]
    pose = np.concatenate([place, np.tile(nose_up.as_quat()[[3, 0, 1, 2]], (4, 1))], axis=1)
    run = Trajectory(np.zeros((4, 9)), np.zeros((3, 4)), 0.02, pose=pose)
    return Trace(run, 1.0, marker, 0.3, walls=(place,))


@pytest.mark.parametrize("frame", ["ENU", "NED"])
def test_a_body_in_space_is_seen_from_above_with_north_up_and_from_the_side_with_height_up(frame):
    seen = views(in_space(frame), drone(frame))
    above, side = seen[" from above"], seen[" from the side"]
    np.testing.assert_allclose(above.trajectory.pose, [[0.0, 2.0 * k, np.pi / 2] for k in range(4)], atol=1e-12)
    np.testing.assert_allclose(side.trajectory.pose[:, :2], [[0.0, k] for k in range(4)], atol=1e-12)
    np.testing.assert_allclose(side.trajectory.pose[:, 2], np.pi / 2, atol=1e-6)
    assert (above.waypoints.tolist(), side.waypoints.tolist()) == ([[0.5, 2.0]], [[0.5, 1.0]])
    np.testing.assert_allclose(above.walls[0], above.trajectory.pose[:, :2])


def test_the_replay_of_a_body_in_space_has_both_views_and_its_divergence_counts_the_height():
    system = drone()
    size = RecurrentNetwork().bind_to(Hover().bind(system)).n_parameters
    made = replace(
        champion("c", ("m",)), task=Spec.parse("hover(horizon=20)"), system=system, parameters=np.zeros(size)
    )
    runner = DynamicsRunner(ExampleDynamics(system))
    found = transfer([made], {"m": runner, "drone": runner}, seed=1, robot="drone", trials=2, traces=2)
    shown = replay(found)
    assert "from the side" in shown.caption
    assert shown.paths
    run = document_of(shown)["runs"][0]
    pose = found.cell("c", "drone").traces[0].trajectory.pose
    np.testing.assert_allclose(unpacked(run["side"])[:, 1], pose[:, 2], atol=1e-3)
    assert len(run["markers"][0]) == 3
    titles = [pair.title for pair in traces_picture(found).panels]
    assert titles == ["c on m from above", "c on m from the side", "c on drone from above", "c on drone from the side"]
    higher = in_space("ENU")
    moved = replace(higher.trajectory, pose=higher.trajectory.pose + np.array([0, 0, 1.0, 0, 0, 0, 0]))
    assert divergence_time(replace(higher, trajectory=moved), higher, system, paths=True) == 0.0
