"""No wrong command comes out of a wire that damages bytes."""

import pytest

from tests.benchmarks.link.__main__ import RATES, damage


@pytest.mark.parametrize("rate", RATES)
def test_damaged_frames_are_refused_and_intact_ones_after_a_delimiter_accepted(rate):
    found = damage(100_000, rate, seed=1)
    assert found.damaged == pytest.approx(found.frames * (1.0 - (1.0 - rate) ** 13), rel=0.1)
    assert found.wrong == 0
    assert found.missed == 0
    assert found.accepted > 0.2 * found.frames


@pytest.mark.nightly
@pytest.mark.parametrize("rate", RATES)
def test_no_wrong_command_is_accepted_in_ten_million_frames(rate):
    found = damage(10**7, rate, seed=1)
    assert found.wrong == 0
    assert found.missed == 0
