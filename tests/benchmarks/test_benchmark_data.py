"""The data of the prediction and fit benchmarks can be had."""

import pytest

from tests.benchmarks import prediction


def test_the_emulated_car_is_recorded_for_the_benchmarks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(prediction, "RECORDED_TIME", 24.0)
    training, test = prediction.recording(prediction.EMULATED)
    assert training.system == test.system
    assert len(training) > 0
    assert len(test) > 0
