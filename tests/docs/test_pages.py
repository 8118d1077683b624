"""Every block of code in README and docs works as it stands."""

from __future__ import annotations

import importlib.util
import re
import shlex
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from sysid_evo.cli.app import loaded
from sysid_evo.data import Dataset
from sysid_evo.registry import KINDS
from sysid_evo.testing import example_dataset
from sysid_evo.testing.template import PLUGINS, write_plugin
from tests.docs.blocks import PAGES, ROOT, blocks, commands, program

OWN_TEST = {
    "data.md": "tests/data/test_data_page.py",
    "kernels.md": "tests/sysid_evo/engine/test_kernels_page.py",
    "robots.md": "tests/hardware/test_robots_page.py",
    "your_own_system.md": "tests/docs/test_your_own_system.py",
}
"""Pages whose Python wants more than a folder of logs; tutorials have a test of their own, too."""
PYTHON = [page for page in PAGES if blocks(page, "python") and page not in OWN_TEST and "tutorials/" not in page]
EXAMPLES = {
    "model": ("models.md", "bilinear"),
    "task": ("tasks.md", "hold"),
    "controller": ("controllers.md", "feedback"),
    "strategy": ("strategies.md", "cross_entropy"),
    "reader": ("readers.md", "json_lines"),
}
"""The page of each kind, and what its example is called."""
LANGUAGES = {"", "python", "toml", "sh", "py", "matlab"}
"""``py`` and ``matlab`` are other programs' and are not run: what is ours is ``python``."""
OTHER_PROGRAMS = {"make", "pip", "cd", "python3"}


@pytest.fixture
def workplace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder, made the current one, with two logs and an example file of another kind."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "logs").mkdir()
    write_logs(example_dataset(episodes=2), tmp_path / "logs")
    rows = (f'{{"t": {0.05 * i:g}, "speed": {i % 3}}}\n' for i in range(4))
    (tmp_path / "example.jsonl").write_text("".join(rows))
    return tmp_path


def write_logs(dataset: Dataset, folder: Path) -> None:
    """Write the episodes as CSV with the columns of a shipped map."""
    system = dataset.system
    for episode in dataset.episodes:
        steps = len(episode.controls)
        pose = np.zeros((steps + 1, 3))
        for k in range(steps):
            pose[k + 1] = system.motion.move(
                pose[k], episode.states[k], episode.states[k + 1], system.dt, system.state_names
            )
        columns = {
            "t": system.dt * np.arange(steps),
            **dict(zip(("u", "v", "r"), episode.states[:-1].T, strict=True)),
            "throttle": np.maximum(episode.controls[:, 0], 0.0),
            "safety": np.ones(steps),
            "steering": episode.controls[:, 1],
            **dict(zip(("x", "y", "yaw"), pose[:-1].T, strict=True)),
        }
        pd.DataFrame(columns).to_csv(folder / f"{episode.name}.csv", index=False)


def what_a_user_has() -> dict[str, Any]:
    """Arrays and a table of a pendulum, under the names that the pages use for them."""
    rng = np.random.default_rng(0)
    states, controls = rng.standard_normal((6, 2)), rng.uniform(-1.0, 1.0, 5)
    frame = pd.DataFrame(states, columns=["theta", "theta_dot"]).assign(torque=[*controls, 0.0], run=[*"aaabbb"])
    return {"states": states, "controls": controls, "frame": frame}


@pytest.fixture
def forgetting() -> Iterator[None]:
    """Whatever is registered during the test is forgotten after it."""
    before = {kind: dict(registry.loaded) for kind, registry in KINDS.items()}
    yield
    for kind, registry in KINDS.items():
        for name, factory in dict(registry.loaded).items():
            if before[kind].get(name) is None and factory.__module__.startswith("page_"):
                registry.forget(name)


@pytest.mark.parametrize("page", PAGES)
def test_a_page_has_only_blocks_that_a_test_understands(page: str) -> None:
    assert len(re.findall(r"^```", PAGES[page].read_text(), re.MULTILINE)) % 2 == 0
    found = set(re.findall(r"^```(\w+)", PAGES[page].read_text(), re.MULTILINE))
    assert found <= LANGUAGES


@pytest.mark.parametrize("page", PYTHON)
def test_the_python_of_a_page_runs(
    page: str, workplace: Path, monkeypatch: pytest.MonkeyPatch, forgetting: None
) -> None:
    """All blocks of a page are one program, in a module of its own, because kernels are read from their file."""
    path = workplace / f"page_{page.removesuffix('.md').lower()}.py"
    path.write_text(program(page))
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    module.__dict__.update(what_a_user_has())
    monkeypatch.setitem(sys.modules, path.stem, module)
    spec.loader.exec_module(module)


@pytest.mark.parametrize("page", ["README.md"])
def test_the_first_python_of_a_page_runs_in_an_empty_folder(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    exec(compile(blocks(page, "python")[0].text, page, "exec"), {})
    assert "standard deviations" in capsys.readouterr().out


@pytest.mark.parametrize("page", [page for page in PAGES if commands(page)])
def test_the_commands_of_a_page_exist_with_these_options(page: str) -> None:
    group = loaded()
    for line in commands(page):
        called, *arguments = shlex.split(line)
        assert called in {"sysid-evo", *OTHER_PROGRAMS}, line
        if called == "sysid-evo":
            accepted(group, arguments, line)


def accepted(command: Any, arguments: list[str], line: str) -> None:
    """Fail unless ``command`` takes ``arguments``; nothing is run."""
    while hasattr(command, "commands"):
        name, *arguments = arguments or [""]
        assert name in command.commands, f"no such command: {line}"
        command = command.commands[name]
    command.make_context("sysid-evo", [argument for argument in arguments if argument != "--help"])


@pytest.mark.parametrize("page", [page for page in PAGES if blocks(page, "toml")])
def test_the_toml_of_a_page_is_read_and_its_entry_points_are_of_a_known_kind(page: str) -> None:
    groups = {registry.group for registry in KINDS.values()}
    for block in blocks(page, "toml"):
        project = tomllib.loads(block.text).get("project", {})
        assert set(project.get("entry-points", {})) <= groups


@pytest.mark.parametrize("kind", EXAMPLES)
def test_the_example_of_a_kind_is_what_plugin_new_writes(kind: str, tmp_path: Path) -> None:
    page, name = EXAMPLES[kind]
    path, *_ = write_plugin(name, tmp_path / name, kind)
    assert path.read_text() in [block.text for block in blocks(page, "python")]


def test_every_kind_has_a_page() -> None:
    assert set(EXAMPLES) | {"robot"} == set(PLUGINS)


@pytest.mark.parametrize("page", PAGES)
def test_a_page_links_only_to_what_is_there(page: str) -> None:
    links = re.findall(r"\]\(([^)#:]+)\)", PAGES[page].read_text())
    assert [link for link in links if not (PAGES[page].parent / link).exists()] == []


FAMILIES_TOLD = {"README.md": r"(\d+) behind one contract", "CHANGELOG.md": r"(\d+) model families"}


@pytest.mark.parametrize("page", FAMILIES_TOLD)
def test_as_many_families_are_told_of_as_there_are(page: str) -> None:
    told = re.search(FAMILIES_TOLD[page], (ROOT / page).read_text())
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert told is not None
    assert int(told[1]) == len(project["entry-points"]["sysid_evo.models"])
