"""`evolved3` is judged as many steps ahead as its horizon."""

import pytest

from model_zoo.evolved3 import Evolved3
from sysid_evo.evolution import model_evolution
from sysid_evo.models.base import make_model
from tests.fixtures.systems import DRIVEN


@pytest.mark.filterwarnings("ignore::sysid_evo.errors.DataWarning")
def test_evolved3_predicts_as_many_steps_as_its_horizon(monkeypatch):
    asked: list[int] = []
    error = model_evolution.final_error

    def watched(step, population, windows, *rest, **more):
        asked.append(windows.controls.shape[1])
        return error(step, population, windows, *rest, **more)

    monkeypatch.setattr(model_evolution, "final_error", watched)
    monkeypatch.setattr(Evolved3, "_kernels", lambda self, parameters: None)
    for horizon in (3, 12):
        make_model("evolved3", generations=1, windows=5, horizon=horizon).fit(DRIVEN.recording())
    assert asked == [3, 3, 12, 12]
    assert make_model("evolved3").horizon == 10
