"""The fail-safes of the whole chain, few times each; ``python -m tests.benchmarks.robot`` does it many times.

Bounds in time are those of the firmware, which opens the buttons when a command outlives its 150 ms,
plus what a loaded machine may take from the processes that watch it.
"""

import signal

import pytest

from tests.benchmarks.robot.blinding import BOUND, blind
from tests.benchmarks.robot.cutting import cut
from tests.benchmarks.robot.killing import kill
from tests.benchmarks.robot.stopping import stop
from tests.benchmarks.robot.suspending import suspend

LOAD = 0.2  # s
SEED = 5


def check(rows):
    for row in rows:
        assert row.holds, f"{row.case}: {row.demand}: {row.passed} of {row.count}, {row.figures}"


def test_buttons_open_when_the_host_is_killed(tmp_path):
    check(kill(tmp_path, repeats=2, seed=SEED, margin=LOAD))


def test_a_terminated_host_stops_the_car_and_says_that_it_failed(tmp_path):
    check(stop(tmp_path, repeats=1, seed=SEED, bound=0.05 + LOAD, cases=(signal.SIGTERM,)))


def test_a_host_that_was_stopped_for_a_second_does_not_drive_on(tmp_path):
    check(suspend(tmp_path, repeats=1, seed=SEED, durations=(1.0,)))


def test_a_cut_line_stops_the_car_and_another_version_is_refused(tmp_path):
    check(cut(tmp_path, repeats=1, seed=SEED, margin=LOAD, kinds=("unplug",)))


def test_a_blind_tracker_stops_the_car_and_no_speed_comes_out_of_a_jump(tmp_path):
    check(blind(tmp_path, repeats=1, seed=SEED, bound=BOUND + LOAD, faults=(("dropout", 0.3), ("identity_swap", 0.3))))


@pytest.mark.nightly
def test_a_host_that_ends_in_any_way_stops_the_car_and_says_that_it_failed(tmp_path):
    check(stop(tmp_path, repeats=2, seed=SEED, bound=0.05 + LOAD))


@pytest.mark.nightly
def test_a_clogged_line_and_a_reset_stop_the_car(tmp_path):
    check(cut(tmp_path, repeats=3, seed=SEED, margin=LOAD))


@pytest.mark.nightly
def test_all_faults_of_the_tracker(tmp_path):
    check(blind(tmp_path, repeats=3, seed=SEED, bound=BOUND + LOAD))


@pytest.mark.nightly
def test_stops_of_the_host_of_any_length(tmp_path):
    check(suspend(tmp_path, repeats=3, seed=SEED))


@pytest.mark.nightly
def test_buttons_open_whenever_the_host_is_killed(tmp_path):
    check(kill(tmp_path, repeats=20, seed=SEED, margin=LOAD))
