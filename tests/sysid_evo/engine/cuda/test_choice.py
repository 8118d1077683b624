"""When the device is taken, and what is said where there is none."""

from __future__ import annotations

import importlib.util
import os
from typing import Any

import numpy as np
import pytest

from sysid_evo.controllers import RecurrentNetwork
from sysid_evo.engine import DynamicsRunner, rollout
from sysid_evo.engine.compiled.dialect import KernelSource, generate_for
from sysid_evo.engine.compiled.lanes import LANES, look_up, store
from sysid_evo.engine.cuda import device
from sysid_evo.errors import InvalidArgument, MissingExtra, NoDevice
from sysid_evo.randomness import trial_seeds
from sysid_evo.tasks import PointToPoint
from sysid_evo.testing.examples import ExampleDynamics, switched_car

from .cases import CASES

pytestmark = pytest.mark.skipif(os.environ.get("NUMBA_ENABLE_CUDASIM") == "1", reason="the simulator is a device")
CAR, TASK = ExampleDynamics(switched_car()), PointToPoint(horizon=5)
GIVEN = (CAR, RecurrentNetwork(), np.zeros((2, 78)), TASK, trial_seeds(0, 2))


def test_without_a_driver_cuda_is_refused_before_any_work(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(device, "_driver", lambda: False)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: object())
    with pytest.raises(NoDevice, match="driver was not found"):
        rollout(*GIVEN, engine="cuda")
    with pytest.raises(NoDevice, match="driver was not found"):
        DynamicsRunner(CAR, engine="cuda")


def test_without_its_package_cuda_is_refused_with_the_command_that_installs_it(monkeypatch: Any) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(MissingExtra, match=r"pip install 'sysid-evo\[cuda\]'"):
        DynamicsRunner(CAR, engine="cuda")


def test_auto_takes_the_processor_where_there_is_no_device(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(device, "at_hand", lambda: False)
    monkeypatch.setattr(device, "ENOUGH", 1)
    assert rollout(*GIVEN).engine == "compiled float32"


def test_the_device_pays_from_many_rollouts_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(device, "at_hand", lambda: True)
    assert not device.pays(device.ENOUGH - 1)
    assert device.pays(device.ENOUGH)
    monkeypatch.setattr(device, "at_hand", lambda: False)
    assert not device.pays(device.ENOUGH)


def looks_up(x, y):
    for lane in range(LANES):
        store(y, lane, look_up(x, lane))


def test_what_needs_several_lanes_is_refused_and_named() -> None:
    pytest.importorskip("numba_cuda", reason="needs numba-cuda: pip install 'sysid-evo[dev]'")
    from sysid_evo.engine.cuda.program import DEVICE

    with pytest.raises(InvalidArgument, match=r"looks_up uses 'look_up': it takes several lanes"):
        generate_for(DEVICE, KernelSource(looks_up), "", "float32")
    assert "LANES = 1" in generate_for(DEVICE, KernelSource(looks_up, one_lane=copies), "", "float32")


def copies(x, y):
    y[0] = x[0]


def test_every_shipped_kernel_has_a_form_for_one_lane() -> None:
    pytest.importorskip("numba_cuda", reason="needs numba-cuda: pip install 'sysid-evo[dev]'")
    from sysid_evo.engine.compiled.run import Kernels
    from sysid_evo.engine.cuda.program import can_run

    for make in CASES.values():
        case = make()
        task = case.task.bind(case.dynamics.system)
        given: Any = (case.dynamics.kernel(), case.controller.bind_to(task).kernel(), task.kernel())
        assert can_run(Kernels(*given))
