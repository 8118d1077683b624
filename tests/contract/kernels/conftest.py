"""Where kernels are the subject, they are compiled."""

import pytest


@pytest.fixture(scope="module", autouse=True)
def kernels_run():
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SYSID_EVO_ENGINE", "auto")
        yield
