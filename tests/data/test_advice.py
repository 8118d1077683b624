"""Advice on data sets whose excitation, coverage and delays are known."""

import io
import json
import tracemalloc

import numpy as np
import pytest
from rich.console import Console

from sysid_evo.cli.recordings import advice_as_json, advice_tables
from sysid_evo.data import Dataset, RawLog, advise, find_delays
from sysid_evo.motion import PlanarBody
from sysid_evo.system import Channel, System

LEVELS = (-1.0, 0.0, 1.0)


def render(what):
    """Return what a terminal of 80 columns shows, with single spaces."""
    console = Console(file=io.StringIO(), width=80)
    console.print(what)
    return " ".join(console.file.getvalue().split())


def random_switch(rng, n, hold=6):
    """Random levels, each held for 1 to ``hold`` samples."""
    return np.repeat(rng.choice(LEVELS, n), rng.integers(1, hold + 1, n))[:n]


def delayed_car(rng, delays, *, n=3000, noise=0.02):
    """A car whose acceleration follows drive, and yaw acceleration steer times speed, so many steps late."""
    system = System(
        (Channel("forward_speed", "m/s"), Channel("yaw_rate", "rad/s")),
        (Channel("drive", levels=LEVELS), Channel("steer", levels=LEVELS)),
        0.05,
        PlanarBody(lateral=None),
    )
    u = np.stack([random_switch(rng, n), random_switch(rng, n)], axis=1)
    x = np.zeros((n + 1, 2))
    for k in range(n):
        drive, steer = u[max(k - delays[0], 0), 0], u[max(k - delays[1], 0), 1]
        push = np.array([2.0 * drive, 5.0 * steer * x[k, 0]])
        x[k + 1] = x[k] + 0.05 * (push - 1.5 * x[k]) + noise * rng.normal(size=2)
    return Dataset.from_arrays(system, [x[: n // 2 + 1], x[n // 2 :]], [u[: n // 2], u[n // 2 :]])


@pytest.mark.parametrize("delays", [(0, 0), (1, 3), (4, 2)])
def test_the_delay_of_each_control_is_found(rng, delays):
    found = {(d.control, d.state): d for d in find_delays(delayed_car(rng, delays))}
    drive, steer = found["drive", "forward_speed"], found["steer", "yaw_rate"]
    assert (drive.steps, steer.steps) == delays
    assert drive.seconds == pytest.approx(0.05 * delays[0], abs=0.02)
    assert drive.clear
    assert steer.clear
    assert drive.strength > 0.5
    assert (drive.at_speed, steer.at_speed) == (False, True)
    assert not found["steer", "forward_speed"].clear


def test_the_delay_of_a_smooth_control_is_not_smeared_by_its_own_past(rng):
    n, delay = 4000, 3
    push = np.zeros(n)
    for k in range(1, n):
        push[k] = 0.95 * push[k - 1] + 0.1 * rng.normal()
    speed = np.zeros(n + 1)
    for k in range(n):
        speed[k + 1] = speed[k] + 0.05 * (5.0 * push[max(k - delay, 0)] - 4.0 * speed[k])
    system = System((Channel("speed"),), (Channel("push", low=-2.0, high=2.0),), 0.05)
    (found,) = find_delays(Dataset.from_arrays(system, [speed[:, None]], [push[:, None]]))
    assert found.steps == delay
    assert found.seconds == pytest.approx(0.05 * delay, abs=0.01)
    assert found.strength > 0.9


def test_a_control_logged_late_is_seen_to_act_before_it_is_set(rng):
    data = delayed_car(rng, (0, 0))
    late = [np.roll(episode.controls, 1, axis=0) for episode in data]
    data = Dataset.from_arrays(data.system, [episode.states for episode in data], late)
    found = {(d.control, d.state): d.steps for d in find_delays(data)}
    assert found["drive", "forward_speed"] == -1
    assert any("before drive is logged" in sentence for sentence in advise(data).suggestions)


def test_a_constant_control_has_no_delay(rng, car):
    data = Dataset.from_arrays(car, [rng.normal(size=(200, 3))], [np.tile([0.0, 1.0], (200, 1))])
    assert find_delays(data) == ()
    short = Dataset.from_arrays(car, [rng.normal(size=(5, 3))], [rng.normal(size=(4, 2))])
    assert find_delays(short) == ()


def test_shares_switches_and_coverage_of_a_hand_made_recording():
    system = System((Channel("place"),), (Channel("push", levels=(0.0, 1.0)), Channel("pull", low=-1.0, high=1.0)), 0.5)
    push = np.array([0, 0, 1, 1, 0, 0, 0, 1.0])
    pull = np.array([-1, -0.9, -0.6, -0.4, 0.4, 0.6, 1, 1.0])
    states = np.array([0, 1, 2, 3, 4, 5, 6, 7, 8.0])[:, None]
    data = Dataset.from_arrays(
        system, [states[:5], states[4:]], [np.stack([push, pull], axis=1)[s] for s in (slice(4), slice(4, 8))]
    )
    advice = advise(data)
    first, second = advice.controls
    assert (first.levels, first.shares, first.switches) == ((0.0, 1.0), (0.625, 0.375), 2)
    assert first.per_minute == pytest.approx(30.0)
    assert (second.levels, second.shares) == ((-1.0, 0.0, 1.0), (0.375, 0.25, 0.375))
    assert (advice.cells, advice.grid) == (8, 8)
    uses = {use.levels: use for use in advice.commands}
    assert uses[0.0, -1.0].share == 0.25
    assert uses[0.0, -1.0].coverage == 0.25
    assert sum(use.share for use in advice.commands) == pytest.approx(1.0)


def test_root_mean_square_range_and_bandwidth_of_a_sinusoid():
    system = System((Channel("place", "m"),), (Channel("push", low=-1.0, high=1.0),), 0.05)
    time = 0.05 * np.arange(2001)
    x = np.stack([1.0 + 2.0 * np.sin(2.0 * np.pi * 3.0 * time)], axis=1)
    (use,) = advise(Dataset.from_arrays(system, [x], [np.sin(time)[:, None]])).states
    assert use.rms == pytest.approx(np.sqrt(3.0), rel=1e-2)
    assert (use.low, use.high) == pytest.approx((-1.0, 3.0), abs=0.05)
    assert use.bandwidth == pytest.approx(3.0, abs=0.1)


def test_white_noise_is_called_noise(rng):
    system = System((Channel("place"),), (Channel("push", low=-1.0, high=1.0),), 0.05)
    advice = advise(Dataset.from_arrays(system, [rng.normal(size=(4000, 1))], [rng.uniform(-1, 1, (4000, 1))]))
    assert advice.states[0].bandwidth > 9.0
    assert any("95 % of place lies below" in sentence for sentence in advice.suggestions)


def test_a_poor_recording_is_told_what_to_do(car):
    states = np.zeros((1200, 3))
    states[:300, 0] = 1.0
    controls = np.zeros((1200, 2))
    controls[:300, 0] = 1.0
    log = RawLog("log", 0.05 * np.arange(400) + 0.01 * (np.arange(400) % 2), np.zeros((400, 3)), np.zeros((400, 2)))
    advice = advise(Dataset.from_arrays(car, [states], [controls]), [log])
    told = "\n".join(advice.suggestions)
    assert "How fast the states answer cannot be told from this recording" in told
    assert "stands still 75% of the time" in told
    assert "drive is near -1 less than 2% of the time" in told
    assert "steer is near -1, 1 less than 2% of the time" in told
    assert "drive changes its level only once" in told
    assert "at (drive, steer) near: -1, -1; -1, 0; -1, 1; 0, -1; 0, 1; 1, -1; 1, 1." in told
    assert "The time stamps of log scatter by up to 17% of a step" in told
    (sampling,) = advice.sampling
    assert (sampling.rows, sampling.shortest, sampling.longest) == pytest.approx((400, 0.04, 0.06))


def test_a_control_without_limits_is_counted_over_its_recorded_range(rng):
    force = rng.uniform(-3.0, 5.0, 400)
    system = System(("place",), (Channel("force", "N"), Channel("pull", low=0.0)), 0.1)
    data = Dataset.from_arrays(system, [rng.normal(size=(401, 1))], [np.stack([force, np.abs(force)], axis=1)])
    advice = advise(data)
    low, middle, high = advice.controls[0].levels
    assert (low, high) == (force.min(), force.max())
    assert middle == pytest.approx((low + high) / 2)
    assert advice.controls[1].levels[::2] == (0.0, np.abs(force).max())
    json.dumps(advice_as_json(data, advice), allow_nan=False)


def test_a_system_without_controls_gets_advice_too(rng):
    data = Dataset.from_arrays(System(("place",), (), 0.1), [rng.normal(size=(400, 1))])
    advice = advise(data)
    assert advice.controls == ()
    assert advice.delays == ()
    json.dumps(advice_as_json(data, advice), allow_nan=False)
    assert "place" in render(advice_tables(data, advice))


def test_with_very_many_combinations_of_levels_only_those_that_occur_are_counted(rng):
    n, names = 600, tuple("abcde")
    system = System(("x",), tuple(Channel(name, levels=(-1.0, 0.0, 1.0)) for name in names), 0.1)
    commands = rng.integers(-1, 2, (n, 5)).astype(float)
    data = Dataset.from_arrays(system, np.cumsum(commands[:, :1], axis=0), commands)
    uses = advise(data).commands
    assert 81 < len(uses) < 3**5
    assert sorted(uses, key=lambda use: use.levels) == list(uses)
    assert sum(use.share for use in uses) == pytest.approx(1.0)
    for use in uses[::40]:
        assert use.share == pytest.approx((commands[:-1] == use.levels).all(axis=1).mean())
    step = rng.integers(len(commands) - 1)
    (use,) = [use for use in uses if use.levels == tuple(commands[step])]
    low, high = data.episodes[0].states[:-1].min(), data.episodes[0].states[:-1].max()
    cells = np.minimum((data.episodes[0].states[:-1, 0] - low) / (high - low) * 8, 7).astype(int)
    here = (commands[:-1] == use.levels).all(axis=1)
    assert use.coverage == pytest.approx(len(set(cells[here])) / len(set(cells)))


def test_advice_on_a_long_recording_needs_memory_for_few_of_its_regressors(rng):
    data = delayed_car(rng, (0, 2), n=30_000)
    regressors = data.n_steps * 8 * (4 + 4 * 11)
    tracemalloc.start()
    try:
        advise(data)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 2 * regressors
