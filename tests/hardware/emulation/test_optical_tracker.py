"""The errors of the emulated tracker."""

import numpy as np
import pytest

from hardware.emulation.tracked_robots import CORRELATION, HEADING_ERROR, POSITION_ERROR, OpticalTracker


def test_errors_have_the_stated_size_and_correlation(rng):
    tracker = OpticalTracker(rng)
    pose = np.array([1.0, -2.0, 0.5])
    errors = np.array([tracker.observe(pose) for _ in range(20_000)]) - pose
    assert errors.std(axis=0) == pytest.approx([POSITION_ERROR, POSITION_ERROR, HEADING_ERROR], rel=0.03)
    assert np.abs(errors.mean(axis=0) / errors.std(axis=0)).max() < 0.04
    for column in errors.T:
        assert np.corrcoef(column[:-1], column[1:])[0, 1] == pytest.approx(CORRELATION, abs=0.03)


def test_headings_wrap_and_the_true_pose_is_left_alone(rng):
    tracker, pose = OpticalTracker(rng), np.array([0.0, 0.0, 3.0 * np.pi])
    headings = np.array([tracker.observe(pose)[2] for _ in range(200)])
    assert np.all((headings >= -np.pi) & (headings < np.pi))
    assert np.ptp(headings) > 6.0
    assert pose.tolist() == [0.0, 0.0, 3.0 * np.pi]
