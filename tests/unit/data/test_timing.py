"""The control logged after each step: found in a recording, kept by data sets and models, refused to controllers."""

import json
from dataclasses import replace

import numpy as np
import pytest

from evaluation.advice.advise import advise_recording
from evaluation.experiment import Experiment
from evaluation.planning import plan_comparison
from sysid_evo import make_model
from sysid_evo.data import Dataset, RawLog, control_timing, prepare
from sysid_evo.errors import IncompatibleSystem, InvalidArgument
from sysid_evo.motion import PlanarBody
from sysid_evo.system import Channel, System
from sysid_evo.tasks.task import make_task
from tests.fixtures.commands import run_here

SYSTEM = System((Channel("speed", "m/s"),), (Channel("push", low=-1.0, high=1.0),), 0.1, name="slider")
LATER = System(SYSTEM.states, SYSTEM.controls, SYSTEM.dt, name="slider", advance=True)


def slider(steps=1500, *, shift=0, later=0.0, seed=0):
    """Return rows of a nonlinear drag: states and controls (steps + 1, 1), the control logged ``shift`` rows late.

    A step has the share ``later`` of the control of the next row.
    """
    rng = np.random.default_rng(seed)
    push, speed = rng.uniform(-1.0, 1.0, steps + 1), np.zeros(steps + 1)
    for k in range(steps):
        speed[k + 1] = 0.8 * speed[k] - 0.1 * speed[k] ** 3 + 0.5 * ((1.0 - later) * push[k] + later * push[k + 1])
    return (speed + 0.01 * rng.normal(size=steps + 1))[:, None], np.roll(push, shift)[:, None]


def test_rows_of_a_log_give_the_control_after_each_step(tmp_path):
    states, controls = slider(30)
    usual, later = (Dataset.from_arrays(system, states, controls) for system in (SYSTEM, LATER))
    np.testing.assert_array_equal(usual.episodes[0].controls, controls[:-1])
    np.testing.assert_array_equal(later.episodes[0].controls, controls[1:])
    np.testing.assert_array_equal(Dataset.from_arrays(LATER, states, controls[1:]).episodes[0].controls, controls[1:])
    again = Dataset.from_pandas(LATER, later.to_pandas(), episode="episode")
    assert again.fingerprint == later.fingerprint != usual.fingerprint
    later.save(tmp_path)
    assert Dataset.load(tmp_path).fingerprint == later.fingerprint
    assert Dataset.load(tmp_path).system.advance


def test_an_advanced_data_set_is_the_same_log_read_with_advance_but_for_the_last_step():
    states, controls = slider(30)
    advanced = Dataset.from_arrays(SYSTEM, states, controls).advanced()
    assert advanced.system == LATER
    np.testing.assert_array_equal(advanced.episodes[0].states, states[:-1])
    np.testing.assert_array_equal(advanced.episodes[0].controls, controls[1:-1])
    assert "for simulation" in advanced.notes[-1]
    with pytest.raises(InvalidArgument, match="without advance"):
        advanced.advanced()


def test_filtered_logs_hold_the_control_of_the_sample_after_each_step():
    rows = np.arange(2001)
    log = RawLog("log", 0.01 * rows, np.empty((len(rows), 0)), rows[:, None] / 2000.0, {"speed": np.sin(0.01 * rows)})
    usual, later = (prepare(log, system).episodes[0] for system in (SYSTEM, LATER))
    np.testing.assert_array_equal(usual.states, later.states)
    np.testing.assert_array_equal(usual.controls[1:], later.controls[:-1])


def test_import_with_advance_stores_it_and_a_model_keeps_it(tmp_path):
    states, controls = slider(300, shift=1)
    rows = "".join(f"{x!r},{u!r}\n" for x, u in zip(states[:, 0].tolist(), controls[:, 0].tolist(), strict=True))
    (tmp_path / "log.csv").write_text("v,u\n" + rows)
    channels = '[states]\nspeed = { column = "v", unit = "m/s" }\n[controls]\npush = { column = "u" }\n'
    (tmp_path / "map.toml").write_text("name = 'slider'\ndt = 0.1\n" + channels)
    (tmp_path / "later.toml").write_text("name = 'slider'\ndt = 0.1\nadvance = true\n" + channels)
    for folder, options in (("a", ("--columns", "map.toml", "--advance")), ("b", ("--columns", "later.toml"))):
        done = run_here("import", "log.csv", *options, "--out", folder, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        assert "for simulation" in " ".join(done.stderr.split())
    first, second = Dataset.load(tmp_path / "a"), Dataset.load(tmp_path / "b")
    assert first.fingerprint == second.fingerprint
    np.testing.assert_array_equal(first.episodes[0].controls, controls[1:])
    model = make_model("linear").fit(first, rng=0)
    fitted = run_here("fit", "a", "--models", "linear", "--out", "run", cwd=tmp_path)
    assert fitted.returncode == 0, fitted.stderr
    assert "evolve" not in fitted.stderr
    card = run_here("models", "show", "run/models/linear", "--json", cwd=tmp_path)
    assert card.returncode == 0, card.stderr
    assert "logged after" in json.loads(card.stdout)["advance"]
    with pytest.raises(IncompatibleSystem, match="expected data with advance"):
        model.score(Dataset.from_arrays(SYSTEM, states, controls))


def test_the_usual_timing_leaves_no_trace_in_stored_systems():
    assert "advance" not in json.dumps(SYSTEM.to_dict())
    assert System.from_dict(LATER.to_dict()) == LATER != SYSTEM
    assert LATER.with_dt(0.2).advance
    assert SYSTEM.differences(LATER) == ("controls logged before against after each step",)


def test_controllers_of_advanced_systems_are_refused_and_comparisons_without_controllers_are_planned():
    data = Dataset.from_arrays(LATER, *slider(600))
    with pytest.raises(IncompatibleSystem, match="for simulation"):
        make_task("set_point").bind(LATER)
    settings = {"models": ("linear",), "reference": False}
    with pytest.raises(IncompatibleSystem, match="--stop-after prediction"):
        plan_comparison(Experiment(**settings, task="set_point"), dataset=data)
    plan_comparison(Experiment(**settings, stop_after="prediction"), dataset=data)


def test_both_timings_are_found_and_reported():
    usual, late = (Dataset.from_arrays(SYSTEM, *slider(800, shift=shift)) for shift in (0, 1))
    assert not control_timing(usual).simultaneous
    timing = control_timing(late)
    assert timing.simultaneous
    assert timing.ratio > 3.0
    assert control_timing(late.advanced()) is None
    assert control_timing(Dataset.from_arrays(SYSTEM, *slider(800, later=0.02))).simultaneous
    topics = [{remark.topic: remark.sentence for remark in advise_recording(data)} for data in (usual, late)]
    assert "simultaneous samples" not in topics[0]
    assert "import the log with --advance" in topics[1]["simultaneous samples"]
    assert f"{timing.ratio:.2f} times" in topics[1]["simultaneous samples"]


def test_samples_that_look_ahead_and_environments_are_not_compared():
    states, controls = slider(shift=1)
    data = Dataset.from_arrays(SYSTEM, states, controls)
    assert control_timing(data) is not None
    assert control_timing(Dataset(SYSTEM, data.episodes, ("log: 31-tap low-pass at 3 Hz without delay",))) is None
    body = System(("speed", "turn"), SYSTEM.controls, 0.1, PlanarBody("speed", None, "turn"))
    assert control_timing(Dataset.from_arrays(body, np.repeat(states, 2, axis=1), controls)) is None
    rewarded = replace(data.episodes[0], rewards=np.zeros(len(data.episodes[0])))
    assert control_timing(data.with_episodes([rewarded])) is None
    assert control_timing(data.with_episodes([data.episodes[0][:40]])) is None
