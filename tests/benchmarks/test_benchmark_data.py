"""The data of the benchmarks can be had."""

import pytest

from tests.benchmarks import cars


def test_the_emulated_car_is_recorded_for_the_benchmarks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cars, "RECORDED_TIME", 24.0)
    training, test = cars.recording(cars.EMULATED)
    assert training.system == test.system
    assert len(training) > 0
    assert len(test) > 0
