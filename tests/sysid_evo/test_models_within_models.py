"""Models that hold other models on disk: they come back together, or are refused with a reason."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from sysid_evo.data import Dataset, Trajectory
from sysid_evo.errors import ArtefactError
from sysid_evo.models import DynamicsModel, load_model, save_model
from sysid_evo.models.base import make_model
from sysid_evo.registry import models
from sysid_evo.system import System
from tests.sysid_evo.test_artefacts import rewrite


class Parts(DynamicsModel):
    """Learns other models: one by itself, and two in a list, of which one sees fewer states."""

    def fit(self, dataset, *, rng, progress=None):
        system = System(("forward_speed",), dataset.system.controls, dataset.system.dt)
        fewer = Dataset(system, [Trajectory(e.states[:, :1], e.controls, e.dt, name=e.name) for e in dataset.episodes])
        self.base_ = make_model("linear", ridge=0.5).fit(dataset, rng=rng)
        self.members_ = [make_model("linear", ridge=ridge).fit(data) for ridge, data in ((0.1, dataset), (0.2, fewer))]
        self.weight_ = 0.25
        return self

    def next_state(self, carry, control):
        return self.base_.next_state(carry, control)


@pytest.fixture
def parts(register, recording, tmp_path):
    model = register(models, "parts", Parts)().fit(recording, rng=np.random.default_rng(0))
    save_model(model, tmp_path / "parts")
    return model


def test_models_that_a_model_learned_come_back_with_it(parts, tmp_path):
    loaded: Any = load_model(tmp_path / "parts")
    assert loaded.weight_ == 0.25
    pairs = [(loaded.base_, parts.base_), *zip(loaded.members_, parts.members_, strict=True)]
    for inner, before in pairs:
        assert inner.get_params() == before.get_params()
        assert inner.system == before.system
        np.testing.assert_array_equal(inner.envelope_, before.envelope_)
        carry, control = np.full((1, before.system.nx), 0.3), np.full((1, 2), 1.0)
        np.testing.assert_array_equal(inner.next_state(carry, control), before.next_state(carry, control))
    assert [inner.system.nx for inner in loaded.members_] == [parts.system.nx, 1]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda learned: learned["base_"].pop("module"), "base_: expected a model with name, module"),
        (lambda learned: learned["members_"][1].update(name="no_such"), "no_such"),
        (lambda learned: learned["members_"].append(3), "members_: expected a model"),
        (lambda learned: learned["base_"].update(system=None), "system of a model cannot be a NoneType"),
        (lambda learned: learned["base_"]["learned"].update(fit=1), "'fit' cannot be the name"),
    ],
)
def test_a_damaged_model_within_a_model_is_refused_with_the_reason(parts, tmp_path, change, said):
    rewrite(tmp_path / "parts", lambda manifest: change(manifest["learned"]))
    with pytest.raises(ArtefactError, match=said):
        load_model(tmp_path / "parts")
