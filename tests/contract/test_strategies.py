"""Every strategy in an evolution that is stopped."""

from dataclasses import replace

import pytest

from sysid_evo.artefacts import CheckpointFile
from sysid_evo.registry import strategies
from tests.fixtures.checkpoints import Stop, StopAfter
from tests.fixtures.evolutions import SETTINGS, assert_same, evolved


@pytest.mark.parametrize("strategy", strategies.names())
def test_an_evolution_that_is_stopped_again_and_again_ends_the_same(strategy, tmp_path):
    settings = replace(SETTINGS, generations=8, strategy=strategy)
    for after in (1, 5, 11):
        with pytest.raises(Stop):
            evolved(settings, CheckpointFile(tmp_path / "c"), progress=StopAfter(after))
    assert_same(evolved(settings, CheckpointFile(tmp_path / "c")), evolved(settings))
