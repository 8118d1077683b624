"""What the tests of the core share: systems, a recording of a made-up car."""

import pytest

from sysid_evo.system import Channel, System
from sysid_evo.testing import example_dataset


@pytest.fixture(scope="session")
def ladder():
    """One state, one continuous control whose neutral value is not zero, no motion."""
    return System((Channel("height", "m"),), (Channel("climb", "m", -1.0, 1.0, neutral=0.25),), dt=0.1)


@pytest.fixture(scope="session")
def recording():
    """A recording of the made-up car of the contract's tests."""
    return example_dataset()
