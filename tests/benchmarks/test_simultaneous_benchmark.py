"""Records of the benchmark of simultaneous sampling have the timing that their names give."""

from dataclasses import replace

import numpy as np
import pytest

from tests.benchmarks.simultaneous import AT_ONCE, HELD, KINDS, LATE, main


def unexplained(data):
    """Return the largest error of a linear step of the circuit's voltage from two rows of each signal."""
    y, u = data.episodes[0].states[:, 0], data.episodes[0].controls[:, 0]
    rows = np.stack([y[1:-1], y[:-2], u[1:], u[:-1]], axis=1)
    return np.abs(y[2:] - rows @ np.linalg.lstsq(rows, y[2:], rcond=None)[0]).max() / y.std()


@pytest.mark.parametrize(("way", "advance"), [(HELD, False), (LATE, True)])
def test_a_control_that_is_held_explains_the_step_that_it_belongs_to(way, advance):
    record = replace(KINDS["circuit"], rows=300, noise=0.0).record("circuit", way, 0)
    assert (unexplained(record) < 1e-6) != advance
    assert (unexplained(record.advanced()) < 1e-6) == advance


def test_a_step_depends_on_both_controls_if_they_are_sampled_at_once():
    record = replace(KINDS["circuit"], rows=300, noise=0.0).record("circuit", AT_ONCE, 0)
    assert 1e-3 < unexplained(record.advanced()) < unexplained(record)


@pytest.mark.nightly
def test_the_timing_of_four_records_is_found(tmp_path):
    file = tmp_path / "timing.md"
    kinds = ["--kinds", "wiener_hammerstein", "dc_motor", "--seeds", "0"]
    assert main([*kinds, "--markdown", str(file), "--families"]) == 0
    assert file.read_text().count("| yes |") == 4
