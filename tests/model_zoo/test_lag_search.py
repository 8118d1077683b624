"""How many earlier samples a quick model knows is read from the data."""

from __future__ import annotations

import numpy as np
import pytest

from evaluation.planning import with_preset
from sysid_evo.data import Dataset
from sysid_evo.models.base import make_model
from sysid_evo.registry import Spec
from sysid_evo.system import Channel, System
from sysid_evo.validation.folds import FOLDS
from sysid_evo.validation.held_out import GOOD, HeldOut
from tests.fixtures.systems import DRIVEN

SYSTEM = System(
    (Channel("speed", "m/s"), Channel("angle", "rad")), (Channel("force", "N", low=-1.0, high=1.0),), dt=0.1
)


def recorded(dead_time: int) -> Dataset:
    """Return recordings of a body whose force acts ``dead_time`` samples late."""
    rng = np.random.default_rng(2)
    states, controls = [], []
    for _ in range(4):
        force = np.repeat(rng.uniform(-1.0, 1.0, 40), 4)
        state = [np.zeros(2)]
        for k in range(len(force)):
            speed, angle = state[-1]
            late = force[k - dead_time] if k >= dead_time else 0.0
            after = [speed + 0.1 * (3.0 * late - 2.0 * angle - 0.5 * speed), angle + 0.1 * speed]
            state.append(np.array(after))
        states.append(np.array(state))
        controls.append(force[:, None])
    return Dataset.from_arrays(SYSTEM, states, controls)


@pytest.mark.parametrize("family", ["narx", "sindy", "sindy_discrete"])
def test_a_quick_model_has_lags_where_a_force_acts_late_and_none_where_it_acts_at_once(family: str) -> None:
    spec = with_preset(Spec(family), "quick")
    assert make_model(spec).fit(recorded(0), rng=0).lags == (0, 0)
    assert make_model(spec).fit(recorded(2), rng=0).lags[1] == 3


def test_errors_that_are_as_good_as_none_are_equal() -> None:
    """So the first of several such models is taken, which has no lags."""
    blocks = HeldOut.of(DRIVEN.recording())
    perfect, nearly = (
        blocks.error(lambda part, ridge=ridge: make_model("linear", ridge=ridge).fit(part)) for ridge in (0.0, 1e-4)
    )
    assert perfect == nearly == pytest.approx(FOLDS * GOOD)
    assert blocks.error(lambda part: make_model("linear", ridge=1.0).fit(part)) > 2.0 * perfect
