"""The benchmark of the device counts what is done, and says so where there is no device."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("numba_cuda", reason="needs numba-cuda: pip install 'sysid-evo[dev]'")

from sysid_evo.controllers import RecurrentNetwork
from sysid_evo.engine.cuda import device
from sysid_evo.errors import NoDevice
from sysid_evo.tasks import PointToPoint
from sysid_evo.testing.examples import ExampleDynamics, switched_car
from tests.benchmarks.cuda import __main__ as benchmark
from tests.benchmarks.cuda.operations import Counted, per_step


def test_a_larger_network_takes_as_many_more_operations_as_it_has_weights() -> None:
    dynamics, task = ExampleDynamics(switched_car()), PointToPoint(horizon=4)
    few, many = (
        per_step(dynamics, RecurrentNetwork(hidden=hidden), np.zeros((5 + hidden + 2) * hidden), task)
        for hidden in (4, 8)
    )
    of_a_tanh = 10 + 9 + 2
    assert many - few == pytest.approx(2 * (15 * 8 - 11 * 4) + 4 * of_a_tanh, rel=0.05)


def test_numbers_that_count_count() -> None:
    Counted.done = 0
    assert 1.0 + Counted(2.0) * 3.0 - abs(-Counted(1.0)) / 2.0 == 6.5
    assert Counted.done == 4


def test_without_a_device_it_says_so(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def refuse() -> None:
        raise NoDevice("there is none")

    monkeypatch.setattr(device, "check", refuse)
    benchmark.main([])
    assert "Nothing was measured: there is none" in capsys.readouterr().out
