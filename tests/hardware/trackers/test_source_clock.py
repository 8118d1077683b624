"""From a tracker's clock to the host's."""

import numpy as np
import pytest

from hardware.trackers.tracker import LEAK, SourceClock


def mapped(clock, source, arrival):
    return np.array([clock.map(s, a) for s, a in zip(source, arrival, strict=True)])


@pytest.mark.parametrize("drift", [-1e-4, 0.0, 1e-4])
def test_mapped_times_are_late_by_the_shortest_way_whatever_the_jitter_and_drift(drift, rng):
    true = 1000.0 + np.arange(20_000) * 0.005
    arrival = true + 0.002 + rng.exponential(0.003, len(true))
    source = (true - 990.0) * (1.0 + drift)
    error = mapped(SourceClock(), source, arrival) - true
    assert np.all(np.abs(error[200:] - 0.002) < 3e-4)


def test_backlog_read_at_once_keeps_the_ages_of_its_frames():
    clock = SourceClock()
    mapped(clock, np.arange(200) * 0.005, 50.0 + np.arange(200) * 0.005)
    stalled = np.arange(200, 1200) * 0.005
    times = mapped(clock, stalled, np.full(1000, 56.0))
    assert times == pytest.approx(50.0 + stalled, abs=2 * LEAK * 5.0)


def test_mapped_times_are_never_after_the_arrival(rng):
    source, arrival = np.sort(rng.uniform(0, 9, 500)), np.sort(rng.uniform(0, 9, 500))
    assert np.all(mapped(SourceClock(), source, arrival) <= arrival)


def test_rounding_does_not_map_a_time_after_its_arrival():
    source, arrival = 472.14271545271333, 100.7012080683658
    assert source + (arrival - source) > arrival
    assert SourceClock().map(source, arrival) <= arrival


@pytest.mark.parametrize("jump", [-3600.0, 3600.0])
def test_source_that_sets_its_clock_is_mapped_anew(jump):
    clock = SourceClock()
    mapped(clock, np.arange(100) * 0.005, 50.0 + np.arange(100) * 0.005)
    after = np.arange(100, 200) * 0.005
    assert mapped(clock, after + jump, 50.0 + after) == pytest.approx(50.0 + after, abs=1e-3)
    assert clock.restarts == 1
