"""Any family on a long past: what it is given, what it gains, what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from sysid_evo.errors import IncompatibleSystem
from sysid_evo.registry import make_model
from tests.model_zoo.hidden.small import recording


def test_the_inner_model_sees_means_over_times_that_double() -> None:
    model = make_model("delay_embedding", family="linear", longest=7).fit(recording(0))
    assert model.model_.system.control_names == (
        "force", "position_1_to_1_ago", "position_2_to_3_ago", "position_4_to_7_ago",
        "force_1_to_1_ago", "force_2_to_3_ago", "force_4_to_7_ago",
    )  # fmt: skip
    carry = np.concatenate([[0.0], np.arange(1.0, 8.0), np.arange(10.0, 80.0, 10.0)])[None]
    seen = model._seen(carry, np.array([[5.0]]))
    np.testing.assert_allclose(seen, [[5.0, 1.0, 2.5, 5.5, 10.0, 25.0, 55.0]])


def test_a_past_tells_what_one_sample_does_not() -> None:
    training, fresh = recording(0, noise=0.01), recording(1)
    inner = make_model("linear").fit(training)
    model = make_model("delay_embedding", family="linear", longest=3).fit(training)
    assert model.score(fresh) > 0.5 * inner.score(fresh)


@pytest.mark.parametrize("family", ["nearest_neighbour", "evolved3", "parametrised"])
def test_families_with_a_part_for_each_command_are_refused(family: str) -> None:
    with pytest.raises(IncompatibleSystem, match="for each command"):
        make_model("delay_embedding", family=family).fit(recording(0))


def test_a_family_that_remembers_is_refused() -> None:
    with pytest.raises(IncompatibleSystem, match="remembers nothing"):
        make_model("delay_embedding", family="linear(control_lags=2)", longest=3).fit(recording(0))


def test_what_is_learned_depends_on_the_family_within() -> None:
    assert make_model("delay_embedding", family="linear(ridge=0.1)").uses() == ("linear",)
