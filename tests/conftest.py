"""Fixtures shared by all tests."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import hypothesis
import numpy as np
import pytest
from playwright.sync_api import Browser

from sysid_evo.motion import PlanarBody
from sysid_evo.registry import KINDS, Registry
from sysid_evo.system import Channel, System
from tests.fixtures.browser import Visitor, chromium

ROOT = Path(__file__).parents[1]


hypothesis.settings.register_profile(  # other work on the machine is no fault of a test
    "suite", deadline=None, suppress_health_check=[hypothesis.HealthCheck.too_slow]
)
hypothesis.settings.load_profile("suite")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--slow", action="store_true", help="also run the heavy tests")


def pytest_configure(config: pytest.Config) -> None:
    """One thread and one job, unless a test asks for more; compiled kernels and trusted plugins are this session's."""
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "SYSID_EVO_JOBS"):
        os.environ.setdefault(name, "1")
    decisions = tempfile.TemporaryDirectory(prefix="sysid-evo-state-")
    os.environ["XDG_STATE_HOME"] = decisions.name  # which plugins the user trusts
    config.add_cleanup(decisions.cleanup)
    if "SYSID_EVO_CACHE" not in os.environ:
        folder = tempfile.TemporaryDirectory(prefix="sysid-evo-tests-")
        os.environ["SYSID_EVO_CACHE"] = folder.name
        config.add_cleanup(folder.cleanup)
        config.add_cleanup(lambda: os.environ.__delitem__("SYSID_EVO_CACHE"))


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if not config.getoption("--slow"):
        for item in items:
            if "slow" in item.keywords:
                item.add_marker(pytest.mark.skip(reason="heavy: run with --slow"))


@pytest.fixture(scope="module", autouse=True)
def forgotten() -> Iterator[None]:
    """What the tests of a module register is forgotten after it; what entry points name has been imported for good."""
    before = {kind: set(registry.loaded) for kind, registry in KINDS.items()}
    yield
    for kind, registry in KINDS.items():
        for name in set(registry.loaded) - before[kind]:
            if not registry._points(name):
                del registry._entries[name]


@pytest.fixture(scope="session")
def recordings() -> Path:
    """The folder with recordings of real cars, from SYSID_EVO_DATA or beside the project."""
    path = Path(os.environ.get("SYSID_EVO_DATA", ROOT.parent / "shared" / "data"))
    if not path.is_dir():
        pytest.skip(f"no recordings at {path}: set SYSID_EVO_DATA to the folder that holds them")
    return path


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20070707)


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    """A headless Chromium; once it is open, nothing in this thread can call `asyncio.run`."""
    with chromium() as browser:
        yield browser


@pytest.fixture
def visitor(browser: Browser) -> Iterator[Visitor]:
    """Opens pages; a page that asks for anything of another machine, or complains, fails the test."""
    visitor = Visitor(browser)
    yield visitor
    visitor.leave()


@pytest.fixture(scope="session")
def car() -> System:
    """The toy car of the paper: three speeds, two three-way switches, 20 Hz."""
    return System(
        states=(
            Channel("forward_speed", "m/s"),
            Channel("lateral_speed", "m/s"),
            Channel("yaw_rate", "rad/s"),
        ),
        controls=(Channel("drive", levels=(-1.0, 0.0, 1.0)), Channel("steer", levels=(-1.0, 0.0, 1.0))),
        dt=0.05,
        motion=PlanarBody(),
        name="toy car",
    )


@pytest.fixture
def register() -> Iterator[Callable[[Registry[Any], str, Any], Any]]:
    """A function that registers something until the test ends."""
    added: list[tuple[Registry[Any], str]] = []

    def add(registry: Registry[Any], name: str, thing: Any) -> Any:
        registry.register(name)(thing)
        added.append((registry, name))
        return thing

    yield add
    for registry, name in added:
        del registry._entries[name]
