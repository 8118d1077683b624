"""Options, marks by folder, the engine, and what tests of all folders share.

Fixtures import what they need themselves, so that a unit test does not wait for a browser or a report.
"""

import os

os.environ.setdefault("SYSID_EVO_ENGINE", "reference")  # before the product is imported; processes inherit it

import random
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path

import hypothesis
import numpy as np
import pytest

from sysid_evo.registry.registry import KINDS
from sysid_evo.testing import example_dataset
from tests.fixtures import recordings as made

TESTS = Path(__file__).parent
FOLDERS = ("system", "contract", "docs", "unit")
"""In this order they are run: long waits begin first, short tests fill the end. Each is a mark, too."""
GROUPS = {
    "browser": ("system/browser",),
    "dask": ("system/test_dask",),
    "realtime": ("system/test_fail_safes", "system/test_serial_robot", "system/test_drive_server", "system/test_real"),
    "site": ("docs/test_site",),
    "regressors": (
        "contract/kernels/test_equality", "contract/kernels/test_changed", "contract/kernels/test_compiled_forms",
        "contract/model_zoo/test_regressor", "contract/model_zoo/test_stored_objects", "contract/test_families",
        "unit/evaluation/test_slow_models",
    ),
}  # fmt: skip
"""Modules whose paths begin so share what is costly, or each other's time: one worker runs all of them."""
UNIT_LIMIT = 0.5
"""Seconds of processor time that a unit test may take."""

hypothesis.settings.register_profile(  # other work on the machine is no fault of a test
    "suite", deadline=None, suppress_health_check=[hypothesis.HealthCheck.too_slow]
)
hypothesis.settings.load_profile("suite")


def pytest_addoption(parser):
    parser.addoption("--nightly", action="store_true", help="also run the tests that take long")
    parser.addoption("--shuffle", type=int, metavar="SEED", help="modules, and tests within a module, in random order")


def pytest_configure(config):
    """One thread and one job, unless a test asks for more; compiled kernels and trusted plugins are this session's."""
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "SYSID_EVO_JOBS"):
        os.environ.setdefault(name, "1")
    if "PYTEST_XDIST_WORKER" not in os.environ:  # workers share these decisions, as they share the data of the session
        decisions = tempfile.TemporaryDirectory(prefix="sysid-evo-state-")
        os.environ["XDG_STATE_HOME"] = decisions.name  # which plugins the user trusts
        config.add_cleanup(decisions.cleanup)
    if "SYSID_EVO_CACHE" not in os.environ:
        folder = tempfile.TemporaryDirectory(prefix="sysid-evo-tests-")
        os.environ["SYSID_EVO_CACHE"] = folder.name
        config.add_cleanup(folder.cleanup)
        config.add_cleanup(lambda: os.environ.__delitem__("SYSID_EVO_CACHE"))


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """Run the tests of a module, and of a group of modules, on one worker."""
    from xdist.scheduler import LoadScopeScheduling

    class ByGroup(LoadScopeScheduling):
        def _split_scope(self, nodeid):
            module = nodeid.partition("::")[0].removeprefix("tests/")
            return next((name for name, starts in GROUPS.items() if module.startswith(starts)), module)

    return ByGroup(config, log)


def pytest_itemcollected(item):
    """Mark each test by its folder."""
    parts = item.path.relative_to(TESTS).parts
    for mark in {parts[0], *parts[:2]} & {*FOLDERS, "kernels"}:
        item.add_marker("kernel" if mark == "kernels" else mark)


def pytest_collection_modifyitems(config, items):
    """Leave out what is for the night, and put the folders in order, or modules in a random one."""
    for item in items:
        if "nightly" in item.keywords and not config.getoption("--nightly"):
            item.add_marker(pytest.mark.skip(reason="takes long: run with --nightly"))
    seed = config.getoption("--shuffle")
    if seed is not None:
        rng = random.Random(seed)
        places = {path: rng.random() for path in sorted({item.path for item in items})}
        rng.shuffle(items)
        items.sort(key=lambda item: places[item.path])
    else:
        items.sort(key=lambda item: FOLDERS.index(folder) if (folder := _folder(item)) in FOLDERS else -1)


def _folder(item):
    return item.path.relative_to(TESTS).parts[0]


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_call(item):
    """Measure a unit test by processor time, which other work on the machine does not change."""
    began = time.process_time()
    yield
    if _folder(item) == "unit" and "nightly" not in item.keywords:
        item.user_properties.append(("processor seconds", time.process_time() - began))


def pytest_terminal_summary(terminalreporter, config):
    """Report unit tests that take too long."""
    for report in terminalreporter.stats.get("passed", ()):
        seconds = dict(report.user_properties).get("processor seconds", 0.0)
        if report.when == "call" and seconds > UNIT_LIMIT:
            terminalreporter.line(f"{seconds:.1f} s of processor time, {UNIT_LIMIT} are a unit test's: {report.nodeid}")


@pytest.fixture(scope="module", autouse=True)
def forgotten():
    """What the tests of a module register is forgotten after it; what entry points name has been imported for good."""
    before = {kind: set(registry.loaded) for kind, registry in KINDS.items()}
    yield
    for kind, registry in KINDS.items():
        for name in set(registry.loaded) - before[kind]:
            if not registry._points(name):
                registry.forget(name)


@pytest.fixture
def register():
    """A function that registers something until the test ends."""
    with ExitStack() as ends:

        def add(registry, name, thing):
            registry.register(name)(thing)
            ends.callback(registry.forget, name)
            return thing

        yield add


@pytest.fixture
def rng():
    return np.random.default_rng(20070707)


@pytest.fixture
def call(tmp_path, capsys):
    """Calls the command line in this process, in the test's own folder."""
    from tests.fixtures.commands import Caller

    return Caller(tmp_path, capsys)


@pytest.fixture(scope="session")
def browser():
    """A headless Chromium; once it is open, nothing in this thread can call `asyncio.run`."""
    from tests.fixtures.browser import chromium

    with chromium() as browser:
        yield browser


@pytest.fixture
def visitor(browser):
    """Opens pages; a page that asks for anything of another machine, or complains, fails the test."""
    from tests.fixtures.browser import Visitor

    visitor = Visitor(browser)
    yield visitor
    visitor.leave()


@pytest.fixture(scope="session")
def recordings():
    """The folder with recordings of real cars, from SYSID_EVO_DATA or next to the project."""
    path = Path(os.environ.get("SYSID_EVO_DATA", TESTS.parents[1] / "shared" / "data"))
    if not path.is_dir():
        pytest.skip(f"no recordings at {path}: set SYSID_EVO_DATA to the folder that holds them")
    return path


@pytest.fixture(scope="session")
def slippery(recordings):
    """Training and test set of a real car on a slippery floor."""
    return made.slippery(recordings)


@pytest.fixture
def emulated():
    """The emulated toy car, as a robot."""
    from sysid_evo.registry import make_robot

    return make_robot("emulated_car")


@pytest.fixture(scope="session")
def car():
    """The toy car of the paper: three speeds, two three-way switches, 20 Hz."""
    return made.toy_car()


@pytest.fixture(scope="session")
def ladder():
    """One state, one continuous control whose neutral value is not zero, no motion."""
    return made.ladder()


@pytest.fixture(scope="session")
def car_data():
    """Three episodes of 200 steps of the made-up car under three-way switches."""
    return example_dataset()


@pytest.fixture(scope="session")
def throttle_car_data():
    """Three episodes of 200 steps of a made-up car: throttle from 0 to 1, steering from -1 to 1."""
    return made.throttle_car_data()


@pytest.fixture(scope="session")
def oscillator_data():
    """Two episodes of 200 steps of a damped oscillator under a force: no motion, nothing of a car."""
    return made.oscillator_data()


@pytest.fixture(scope="session")
def session_folder(tmp_path_factory):
    """A folder that all workers share; see `tests.fixtures.session`."""
    from tests.fixtures import session

    base = tmp_path_factory.getbasetemp()
    return session.SessionFolder((base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "session")


@pytest.fixture(scope="session")
def stored_data(session_folder):
    """The folder of `car_data`, as a data set. Nothing may be written into it."""
    from tests.fixtures import session

    return session_folder.get("data", session.store_data) / "car"


@pytest.fixture(scope="session")
def car_logs(session_folder):
    """A folder with `car_data` as one CSV file per episode, and their column map car.toml. Read only."""
    from tests.fixtures import session

    return session_folder.get("logs", session.write_logs)


@pytest.fixture(scope="session")
def fitted(session_folder):
    """Six models of `car_data` by name, of six kinds: `tests.fixtures.session.MODELS`. Nothing may change them."""
    from tests.fixtures import session

    return session.load_models(session_folder.get("models", session.fit_models))


@pytest.fixture(scope="session")
def finished_run(session_folder, stored_data):
    """The folder of a finished comparison, `tests.fixtures.session.COMPARISON`. Read only: change a `run_copy`."""
    from tests.fixtures import session

    return session_folder.get("run", lambda folder: session.compare(folder, stored_data)) / "out"


@pytest.fixture
def run_copy(finished_run, tmp_path):
    """A copy of the finished run in the test's own folder, as ``out``."""
    from tests.fixtures import session

    return session.copy_run(finished_run, tmp_path / "out")


@pytest.fixture
def blank_figures():
    """Pages and files are written without drawing their figures, which takes most of the time of a report."""
    from tests.fixtures.session import without_figures

    with without_figures():
        yield


@pytest.fixture(scope="session")
def failed_run(session_folder, finished_run):
    """The folder of a run of which one family failed and the robot is absent; `tests.fixtures.session.fail`."""
    from tests.fixtures import session

    return session_folder.get("failed", lambda folder: session.fail(folder, finished_run)) / "out"


@pytest.fixture(scope="session")
def study_folder(session_folder):
    """The folder of a finished study of two emulated cars and two seeds, read only."""
    from tests.fixtures import session

    return session_folder.get("study", session.study) / "study"


@pytest.fixture(scope="session")
def report():
    """The report of three models that are known exactly, their controllers, and the known car as robot."""
    from tests.fixtures.known_models import Known, Sliding, Weak
    from tests.fixtures.known_models import fitted as known
    from tests.fixtures.reports import make_report

    return make_report({"known": known(Known()), "weak": known(Weak()), "sliding": known(Sliding())})


@pytest.fixture(scope="session")
def report_page(report, tmp_path_factory):
    """The page of `report`."""
    from evaluation.report.report import save_report

    return save_report(report, tmp_path_factory.mktemp("page"))[1]
