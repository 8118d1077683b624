"""The shipped rules on numbers that can be followed by hand."""

from __future__ import annotations

import numpy as np
import pytest

from sysid_evo.registry import make_aggregate

FITNESS = np.array(
    [
        [[1.0, 3.0], [5.0, 5.0]],
        [[0.0, 8.0], [9.0, 9.0]],
        [[9.0, 9.0], [0.0, 2.0]],
    ]
)
"""Three models, two candidates, two trials; the models' means are 2, 4, 9 and 5, 9, 1."""


@pytest.mark.parametrize(("name", "expected"), [("min", [2.0, 1.0]), ("mean", [5.0, 5.0]), ("median", [4.0, 5.0])])
def test_the_rule_is_taken_over_the_models_of_their_means_over_the_trials(name: str, expected: list[float]) -> None:
    np.testing.assert_array_equal(make_aggregate(name)(FITNESS), expected)
