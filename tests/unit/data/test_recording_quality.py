"""The quality of recordings whose excitation, coverage and delays are known, and the advice on them."""

import io
import json
import tracemalloc

import numpy as np
import pytest
import scipy
from rich.console import Console

from evaluation.advice.advise import advise_recording
from sysid_evo.cli.recordings import quality_as_json, quality_tables
from sysid_evo.data import Dataset, RawLog, check_usable, find_delays, recording_quality
from sysid_evo.data.response import _first_peak, fit_linear
from sysid_evo.data.units import spelled_time
from sysid_evo.errors import InvalidData
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
    assert "forward_speed moves 50 ms before drive is logged" in told(data)


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
    quality = recording_quality(data)
    first, second = quality.controls
    assert (first.levels, first.shares, first.switches) == ((0.0, 1.0), (0.625, 0.375), 2)
    assert first.per_minute == pytest.approx(30.0)
    assert (second.levels, second.shares) == ((-1.0, 0.0, 1.0), (0.375, 0.25, 0.375))
    assert (quality.cells, quality.grid) == (8, 8)
    uses = {use.levels: use for use in quality.commands}
    assert uses[0.0, -1.0].share == 0.25
    assert uses[0.0, -1.0].coverage == 0.25
    assert sum(use.share for use in quality.commands) == pytest.approx(1.0)


def test_root_mean_square_range_and_bandwidth_of_a_sinusoid():
    system = System((Channel("place", "m"),), (Channel("push", low=-1.0, high=1.0),), 0.05)
    time = 0.05 * np.arange(2001)
    x = np.stack([1.0 + 2.0 * np.sin(2.0 * np.pi * 3.0 * time)], axis=1)
    (use,) = recording_quality(Dataset.from_arrays(system, [x], [np.sin(time)[:, None]])).states
    assert use.rms == pytest.approx(np.sqrt(3.0), rel=1e-2)
    assert (use.low, use.high) == pytest.approx((-1.0, 3.0), abs=0.05)
    assert use.bandwidth == pytest.approx(3.0, abs=0.1)


def test_white_noise_is_called_noise(rng):
    system = System((Channel("place"),), (Channel("push", low=-1.0, high=1.0),), 0.05)
    data = Dataset.from_arrays(system, [rng.normal(size=(4000, 1))], [rng.uniform(-1, 1, (4000, 1))])
    assert recording_quality(data).states[0].bandwidth > 9.0
    assert "95 % of place lies below" in told(data)


def test_a_poor_recording_gets_remarks_with_a_remedy(car):
    states = np.zeros((1200, 3))
    states[:300, 0] = 1.0
    controls = np.zeros((1200, 2))
    controls[:300, 0] = 1.0
    log = RawLog("log", 0.05 * np.arange(400) + 0.01 * (np.arange(400) % 2), np.zeros((400, 3)), np.zeros((400, 2)))
    data = Dataset.from_arrays(car, [states], [controls])
    quality = recording_quality(data, [log])
    remarks = advise_recording(data, quality)
    found = {remark.topic: remark.sentence for remark in remarks}
    assert "The response time of the states cannot be estimated from this recording" in found["time scale"]
    assert "is at rest 75 % of the time" in found["standstill"]
    assert found["rare commands"].startswith("drive is near -1 and steer is near -1, 1 less than 2 % of the time")
    assert found["slow switching"].startswith("steer stays near a level for 60 s on average: change it more often")
    assert found["slow switching"].endswith("Likewise drive.")
    assert "at (drive, steer) near: -1, -1; -1, 0; -1, 1; 0, -1; 0, 1; 1, -1; 1, 1." in found["rare commands"]
    assert "The time stamps of log scatter by up to 17 % of a step" in found["time stamps"]
    weights = [remark.weight for remark in remarks]
    assert weights == sorted(weights, reverse=True)
    assert remarks[0].topic == "time scale"
    (sampling,) = quality.sampling
    assert (sampling.rows, sampling.shortest, sampling.longest) == pytest.approx((400, 0.04, 0.06))


def test_a_control_without_limits_is_counted_over_its_recorded_range(rng):
    force = rng.uniform(-3.0, 5.0, 400)
    system = System(("place",), (Channel("force", "N"), Channel("pull", low=0.0)), 0.1)
    data = Dataset.from_arrays(system, [rng.normal(size=(401, 1))], [np.stack([force, np.abs(force)], axis=1)])
    quality = recording_quality(data)
    low, middle, high = quality.controls[0].levels
    assert (low, high) == (force.min(), force.max())
    assert middle == pytest.approx((low + high) / 2)
    assert quality.controls[1].levels[::2] == (0.0, np.abs(force).max())
    json.dumps(quality_as_json(data, quality), allow_nan=False)


def test_a_system_without_controls_has_a_quality_too(rng):
    data = Dataset.from_arrays(System(("place",), (), 0.1), [rng.normal(size=(400, 1))])
    quality = recording_quality(data)
    assert quality.controls == ()
    assert quality.delays == ()
    json.dumps(quality_as_json(data, quality), allow_nan=False)
    assert "place" in render(quality_tables(data, quality))


def test_with_very_many_combinations_of_levels_only_those_that_occur_are_counted(rng):
    n, names = 600, tuple("abcde")
    system = System(("x",), tuple(Channel(name, levels=(-1.0, 0.0, 1.0)) for name in names), 0.1)
    commands = rng.integers(-1, 2, (n, 5)).astype(float)
    data = Dataset.from_arrays(system, np.cumsum(commands[:, :1], axis=0), commands)
    uses = recording_quality(data).commands
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


def test_the_quality_of_a_long_recording_needs_memory_for_few_of_its_regressors(rng):
    data = delayed_car(rng, (0, 2), n=30_000)
    regressors = data.n_steps * 8 * (4 + 4 * 11)
    tracemalloc.start()
    try:
        recording_quality(data)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 2 * regressors


PENDULUM = System(
    (Channel("theta", "rad"), Channel("theta_dot", "rad/s")), (Channel("torque", "N m", -1.0, 1.0),), 0.02
)
TANK = System((Channel("level", "m", low=0.0),), (Channel("valve", low=0.0, high=1.0),), 1.0)


def held(rng, values, n, shortest, longest):
    """Values drawn at random, each held for ``shortest`` to ``longest`` samples, (n,)."""
    return np.repeat(rng.choice(values, n), rng.integers(shortest, longest + 1, n))[:n]


def pendulum(rng, *, seconds=100.0, noise=0.0, hold=(3, 25)):
    """A swinging pendulum (time scale 0.22 s), exactly solved for small angles."""
    n = round(seconds / PENDULUM.dt)
    torque = held(rng, (-1.0, 0.0, 1.0), n, *hold)
    x = np.zeros((n + 1, 2))
    for k in range(n):
        theta, rate = x[k]
        for _ in range(10):
            rate += 0.002 * (-20.0 * theta - 0.5 * rate + 6.0 * torque[k])
            theta += 0.002 * rate
        x[k + 1] = theta, rate
    return Dataset.from_arrays(PENDULUM, x + noise * rng.normal(size=x.shape), torque)


def tank(rng, *, hours=3.0, hold=(60, 400), dead_time=0):
    """A tank whose level follows the valve with a time constant of 100 s, ``dead_time`` samples late."""
    n = round(3600.0 * hours)
    valve = held(rng, (0.0, 0.3, 0.7, 1.0), n, *hold)
    level = np.full(n + 1, 0.5)
    for k in range(n):
        level[k + 1] = level[k] + (valve[max(k - dead_time, 0)] - level[k]) / 100.0 + 1e-4 * rng.normal()
    return Dataset.from_arrays(TANK, level, valve)


def told(dataset):
    return "\n".join(remark.sentence for remark in advise_recording(dataset))


def test_time_scales_are_those_of_the_system(rng):
    (scale,) = fit_linear(tank(rng), 10).scales
    assert scale == pytest.approx(100.0, rel=0.1)
    np.testing.assert_allclose(fit_linear(pendulum(rng), 10).scales, np.sqrt(1 / 20), rtol=0.05)


def test_a_good_recording_of_a_pendulum_or_a_tank_needs_no_advice(rng):
    assert told(pendulum(rng)) == ""
    assert told(tank(rng)) == ""


def test_the_length_asked_for_follows_from_the_time_scale_and_the_number_of_channels(rng):
    sentence = told(tank(rng, hours=0.5))
    assert "30 min are only 18 times the slowest time scale of the states (100 s)" in sentence
    assert "30 times for each of the 2 states and controls: record 100 min in all." in sentence
    assert "record 20 s in all" in told(pendulum(rng, seconds=10.0))


def test_a_pendulum_that_goes_round_has_the_time_scale_of_its_swing(rng):
    system = System((Channel("theta", "rad", period=2 * np.pi), PENDULUM.states[1]), PENDULUM.controls, 0.02)
    torque = held(rng, (-1.0, 0.0, 1.0), 6000, 3, 25)
    x = np.zeros((6001, 2))
    for k in range(6000):
        theta, rate = x[k]
        for _ in range(10):
            rate += 0.002 * (-20.0 * np.sin(theta) - 0.5 * rate + 15.0 * torque[k])
            theta += 0.002 * rate
        x[k + 1] = theta, rate
    assert np.ptp(x[:, 0]) > 4.0 * np.pi
    data = Dataset.from_arrays(system, x, torque)
    np.testing.assert_allclose(fit_linear(data, 10).scales, np.sqrt(1 / 20), rtol=0.1)
    assert told(data) == ""


def test_a_battery_that_runs_down_asks_for_no_hours(rng):
    swinging = pendulum(rng)
    battery = np.linspace(8.4, 7.9, 5001)[:, None] + 1e-3 * rng.normal(size=(5001, 1))
    system = System((*PENDULUM.states, Channel("battery", "V", low=6.0)), PENDULUM.controls, PENDULUM.dt)
    (episode,) = swinging.episodes
    drained = Dataset.from_arrays(system, np.concatenate([episode.states, battery], axis=1), episode.controls)
    assert recording_quality(drained).scales[-1] < 1.0
    assert "in all" not in told(drained)


def test_a_tank_may_hold_its_valve_for_minutes_and_a_pendulum_may_not_hold_its_torque(rng):
    assert told(tank(rng, hold=(100, 400))) == ""
    sentence = told(pendulum(rng, hold=(200, 400)))
    assert "torque stays near a level for" in sentence
    assert "but the states settle within 1.1 s: change it more often" in sentence


def test_noise_free_states_that_change_within_a_sample_are_not_called_noisy(rng):
    n = 2000
    push = rng.uniform(-1.0, 1.0, n)
    place = np.zeros(n + 1)
    for k in range(n):
        place[k + 1] = 0.1 * place[k] + push[k]
    system = System(("place",), (Channel("push", low=-1.0, high=1.0),), 0.05)
    sentence = told(Dataset.from_arrays(system, place, push))
    assert "95 % of place lies below" in sentence
    assert "changes within few samples: a shorter dt" in sentence
    assert "noisy" not in sentence
    noise = rng.normal(size=n + 1)
    assert "it is noisy, or dt is too long" in told(Dataset.from_arrays(system, noise, push))


def test_episodes_in_which_nothing_moves_are_named(rng):
    moving = tank(rng, hours=0.4)
    still = [np.full((200, 1), 0.5)] * 6
    data = Dataset.from_arrays(TANK, [moving.episodes[0].states, *still], [moving.episodes[0].controls, *still])
    sentence = "Nothing moves in 6 of 7 episodes: episode-1, episode-2, episode-3, episode-4 and 2 more."
    assert sentence in told(data)
    pieces = moving.with_episodes([moving.episodes[0], moving.episodes[0][5:8]])
    assert "Nothing moves" not in told(pieces)


def test_manoeuvres_without_motion_are_listed(car, rng):
    driven = np.cumsum(rng.normal(size=(400, 3)), axis=0)
    controls = rng.choice([-1.0, 0.0, 1.0], (400, 2))
    noise = 1e-3 * rng.normal(size=(400, 3))
    data = Dataset.from_arrays(car, [driven, noise], [controls, controls], names=["drive", "rest"])
    assert "Nothing moves in 1 of 2 episodes: rest. Leave them out" in told(data)


def test_a_backswing_is_no_delay_however_large(rng):
    n = 4000
    push = held(rng, (-1.0, 0.0, 1.0), n, 1, 6)
    answer = np.convolve(push, [0.0, 0.8, 0.3, -1.0, -0.4, 0.15])[:n]
    speed = np.zeros(n + 1)
    for k in range(n):
        speed[k + 1] = speed[k] + 0.05 * (2.0 * answer[k] - 0.8 * speed[k]) + 0.01 * rng.normal()
    (delay,) = find_delays(Dataset.from_arrays(System(("speed",), ("push",), 0.05), speed, push))
    assert (delay.steps, delay.clear) == (1, True)
    assert delay.strength > 0.0


def test_a_control_that_does_nothing_is_shown_with_its_largest_correlation(rng):
    free = Dataset.from_arrays(System(("speed",), ("push",), 0.05), rng.normal(size=4001), rng.normal(size=4000))
    (delay,) = find_delays(free)
    assert not delay.clear
    assert 0.01 < abs(delay.strength) < 0.1
    assert _first_peak(np.array([0.01, 0.02, -0.05, 0.03]), 0.1) == 2
    assert _first_peak(np.array([0.01, 0.2, 0.3, -0.9, 0.5]), 0.1) == 3
    assert _first_peak(np.array([0.01, 0.5, 0.6, -0.9, 0.5]), 0.1) == 2


def test_a_position_that_follows_its_speed_is_not_late(rng):
    found = {delay.state: delay for delay in find_delays(pendulum(rng))}
    assert (found["theta"].steps, found["theta"].clear) == (0, True)
    assert (found["theta_dot"].steps, found["theta_dot"].clear) == (0, True)


@pytest.mark.parametrize("late, seconds", [((0.6, 0.4), 2.25), ((0.8, 0.2), 2.07), ((1.0, 0.0), 2.0)])
def test_a_delay_between_two_samples_is_estimated_between_them(rng, late, seconds):
    """The vertex of the parabola through 0, a, b lies at 0.5 b / (2 a - b)."""
    n = 8000
    push = rng.choice([-1.0, 1.0], n)
    answer = np.convolve(push, [0.0, 0.0, *late])[:n]
    speed = np.concatenate([[0.0], np.cumsum(answer)]) * 0.1
    (delay,) = find_delays(Dataset.from_arrays(System(("speed",), ("push",), 0.1), speed, push))
    assert delay.steps == 2
    assert delay.seconds == pytest.approx(0.1 * seconds, abs=0.004)


def test_the_past_of_a_smooth_control_does_not_move_its_delay(rng):
    """Without whitening the parabola would lie over 0.6 r^|k| + 0.4 r^|k - 1| with r = 0.9."""
    n = 8000
    push = scipy.signal.lfilter([1.0], [1.0, -0.9], rng.normal(size=n))
    answer = np.convolve(push, [0.0, 0.0, 0.6, 0.4])[:n]
    speed = np.concatenate([[0.0], np.cumsum(answer)]) * 0.1
    (delay,) = find_delays(Dataset.from_arrays(System(("speed",), ("push",), 0.1), speed, push))
    assert delay.steps == 2
    assert delay.seconds == pytest.approx(0.225, abs=0.003)


def test_the_dead_time_of_a_slow_system_is_found_in_its_own_steps(rng):
    (delay,) = find_delays(tank(rng, hold=(5, 40), dead_time=6))
    assert (delay.steps, delay.clear) == (6, True)


def test_six_minutes_of_a_car_are_long_enough(rng):
    n = 7080
    system = System(
        (Channel("forward_speed", "m/s"), Channel("yaw_rate", "rad/s")),
        (Channel("drive", levels=(-1.0, 0.0, 1.0)), Channel("steer", levels=(-1.0, 0.0, 1.0))),
        0.05,
        PlanarBody(lateral=None),
    )
    u = np.stack([held(rng, (-1.0, 0.0, 1.0), n, 5, 30) for _ in range(2)], axis=1)
    x = np.zeros((n + 1, 2))
    for k in range(n):
        x[k + 1] = x[k] + 0.05 * (u[k] * [2.0, 5.0 * x[k, 0]] - 1.5 * x[k])
    assert "record" not in told(Dataset.from_arrays(system, x, u))


def test_a_log_of_ten_rows_is_refused_before_any_work(rng):
    whole = pendulum(rng, seconds=10.0)
    short = whole.with_episodes([whole.episodes[0][:9]])
    with pytest.raises(InvalidData, match=r"expected an episode of 15 steps or more.*40 steps in all.*got 9 steps"):
        check_usable(short)
    assert "expected an episode of 15 steps or more" in told(short)
    pieces = whole.with_episodes([whole.episodes[0][20 * i : 20 * i + 14] for i in range(10)])
    with pytest.raises(InvalidData, match="test set: expected an episode of 15 steps"):
        check_usable(pieces, name="test set")
    with pytest.raises(InvalidData, match="40 steps in all for 3 states and controls; got 39 steps"):
        check_usable(whole.with_episodes([whole.episodes[0][:39]]))
    check_usable(whole)


def test_a_recording_without_motion_is_refused(car):
    with pytest.raises(InvalidData, match="data set: the robot never moves"):
        check_usable(Dataset.from_arrays(car, np.zeros((200, 3)), np.zeros((200, 2))))


def test_lengths_of_time_read_well():
    spelt = [spelled_time(seconds) for seconds in (0.047, 0.9996, 2.14, 45.0, 119.0, 288.0, 5400.0, 10_000.0, 1e6)]
    assert spelt == ["47 ms", "1 s", "2.1 s", "45 s", "119 s", "4.8 min", "90 min", "2.8 h", "278 h"]
