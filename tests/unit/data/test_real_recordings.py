"""Real recordings: preparation against the sensors on the car, rows against the file."""

import csv
import json
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from sysid_evo.data import Dataset, prepare, read_recording
from sysid_evo.system import Channel, System
from tests.benchmarks.growth.recordings import write_log


def test_prepared_yaw_rate_and_speed_agree_with_gyro_and_wheel_encoder_on_every_file(recordings):
    """Compared at every tick: the prepared state with the last value that the sensor had sent by then.

    The sensors send 10 values a second; both are 0 in the log until they send the first, and ticks
    before that are left out. They take the place of the controls, which are held at the ticks.
    """
    recording = read_recording(recordings / "dart" / "free_100hz")
    assert len(recording.logs) == 4
    system = recording.system
    sensed = System(system.states, (Channel("encoder"), Channel("gyro")), system.dt, system.motion)
    for log in recording.logs:
        sensors = np.stack([log.extra["encoder_speed"], log.extra["gyro"]], axis=1)
        (episode,) = prepare(replace(log, controls=sensors), sensed).episodes
        encoder, gyro = episode.controls[np.cumsum(np.abs(episode.controls).sum(axis=1)) > 0].T
        forward, _, yaw_rate = episode.states[:-1][-len(gyro) :].T
        assert len(gyro) > 0.99 * len(episode)
        assert np.corrcoef(yaw_rate, gyro)[0, 1] >= 0.96, log.name
        assert np.corrcoef(forward, encoder)[0, 1] >= 0.95, log.name


def test_the_steady_clock_makes_the_speed_smoother_than_the_stamps_do(recordings):
    recording = read_recording(sorted((recordings / "dart" / "free_100hz").glob("*.csv"))[-1])
    (log,) = recording.logs
    prepared = prepare(log, recording.system)
    assert any("scatter by 0.26 ms around a steady 100.0 Hz" in note for note in prepared.notes)
    by_stamps = np.diff(log.pose[:, :2], axis=0) / np.diff(log.time)[:, None]
    by_clock = np.diff(log.pose[:, :2], axis=0) / 0.01
    assert np.std(np.diff(by_clock, axis=0)) < 0.7 * np.std(np.diff(by_stamps, axis=0))


def test_rows_of_the_slippery_drives_are_samples_digit_by_digit(recordings):
    folder = recordings / "dart" / "slippery_20hz"
    dataset = Dataset.read(folder)
    files = sorted(folder.glob("*.csv"))
    assert dataset.names == tuple(file.stem for file in files)
    for file, episode in zip(files, dataset, strict=True):
        with file.open() as lines:
            rows = list(csv.DictReader(lines))
        expected = np.array([[float(row[name]) for name in "uvr"] for row in rows])
        np.testing.assert_array_equal(episode.states, expected)
        drive = np.array([max(float(row["throttle"]), 0.0) * float(row["safety"]) for row in rows])
        steer = np.array([float(row["steering"]) for row in rows])
        np.testing.assert_array_equal(episode.controls, np.stack([drive, steer], axis=1)[:-1])
        np.testing.assert_array_equal(episode.pose[:, :2], [[float(row["x"]), float(row["y"])] for row in rows])
    assert dataset.notes[0].startswith("column map 'dart_20hz' chosen")
    assert any("45.2 to 55.4 ms apart" in note for note in dataset.notes)
    train, test = dataset.split(["2025-04-16-17-36-01"])
    assert (len(train), test.names) == (4, ("2025-04-16-17-36-01",))


@pytest.mark.parametrize(
    "folder, columns, episodes",
    [("dart/free_20hz", "dart_20hz_ungated", 4), ("f1tenth_frictionmaps", "f1tenth_20hz", 4)],
)
def test_other_recordings_are_read_with_the_map_shipped_for_them(recordings, folder, columns, episodes):
    dataset = Dataset.read(recordings / folder)
    assert len(dataset) == episodes
    assert f"column map '{columns}' chosen" in dataset.notes[0]


def test_the_gyro_in_degrees_per_second_agrees_with_the_differentiated_heading(recordings):
    dataset = Dataset.read(recordings / "f1tenth_frictionmaps")
    for episode in dataset:
        turning = np.gradient(episode.pose[:, 2], episode.dt)
        slope = np.polyfit(turning, episode.states[:, 2], 1)[0]
        assert 0.8 < slope < 1.2


def test_preparing_the_raw_log_gives_what_a_savitzky_golay_filter_gave(recordings):
    raw, smoothed = (Dataset.read(recordings / "dart" / name) for name in ("free_100hz", "free_20hz"))
    for a, b in zip(raw, smoothed, strict=True):
        difference = a.states - b.states[5 : 5 + len(a) + 1]
        assert (difference.std(axis=0) < [0.01, 0.01, 0.03]).all()


ROWS = 200_000
NUMBERS = ROWS * 9 * 8 / 2**20
"""Megabytes of the log's nine columns as numbers."""

WATCHED = """
import json, resource, sys
from sysid_evo.__main__ import main
import sysid_evo.cli.models, sysid_evo.data, evaluation.cells
import pyarrow.csv, pyarrow.parquet, scipy.signal, sklearn.base
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
sys.argv = ["sysid-evo", *sys.argv[1:]]
try:
    main()
except SystemExit as ended:
    assert not ended.code, ended.code
after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
print(json.dumps({"megabytes": (after - before) / 1024}))
"""


def megabytes(*arguments):
    """Return by how much a command raises the peak of resident memory over what its imports take."""
    done = subprocess.run(
        [sys.executable, "-c", WATCHED, *map(str, arguments)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return float(json.loads(done.stdout.splitlines()[-1])["megabytes"])


@pytest.mark.nightly
def test_a_log_of_200_000_rows_is_imported_inspected_and_learned_from_in_little_memory(tmp_path):
    log, columns = write_log(tmp_path, ROWS)
    used = megabytes("import", log, "--columns", columns, "--out", tmp_path / "data")
    assert used < 8 * NUMBERS
    stored = Dataset.load(tmp_path / "data")
    assert stored.n_steps == ROWS - 1
    assert stored.fingerprint == Dataset.read(log, columns=columns).fingerprint
    assert megabytes("inspect", tmp_path / "data") < 20 * NUMBERS
    families = "linear,nearest_neighbour,backprop27(epochs=20)"
    fitting = ("fit", tmp_path / "data", "--models", families, "--preset", "quick", "--out", tmp_path / "run")
    assert megabytes(*fitting) < 30 * NUMBERS
    notes = [json.loads(file.read_text()) for file in (tmp_path / "run").glob("models/*.json")]
    assert len(notes) == 3
