"""Every block of code in docs/data.md, and the one on data in the README, runs as it stands."""

from __future__ import annotations

import re
import shlex
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from typer.testing import CliRunner

from sysid_evo.cli.app import app, loaded
from sysid_evo.data import Dataset, load_columns
from sysid_evo.data.columns import parse_columns, shipped_names

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "data.md").read_text()
README = (ROOT / "README.md").read_text()


def blocks(page: str, language: str) -> list[str]:
    """Return the blocks of code in this language."""
    return re.findall(rf"```{language}\n(.*?)```", page, re.DOTALL)


@pytest.fixture
def workplace(tmp_path, monkeypatch, rng) -> Path:
    """A folder, made the current one, with two logs and the column map of the page."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "logs").mkdir()
    (tmp_path / "my_robot.toml").write_text(blocks(PAGE, "toml")[0])
    time = 0.05 * np.arange(200)
    speed, yaw_rate = 1.0 + 0.5 * np.sin(time), 0.4 * np.cos(0.7 * time)
    heading = np.concatenate([[0.0], np.cumsum(0.05 * yaw_rate)])[:-1]
    for name in ("first_drive", "last_drive"):
        columns = {
            "stamp": 1e3 * time,
            "v": speed,
            "gyro_z": -np.degrees(yaw_rate),
            "voltage": np.linspace(8.2, 7.9, 200),
            "throttle": rng.uniform(0.0, 1.0, 200),
            "armed": np.ones(200),
            "servo": rng.choice(["right", "straight", "left"], 200),
            "px": 1e3 * np.cumsum(0.05 * speed * np.cos(heading)),
            "py": 1e3 * np.cumsum(0.05 * speed * np.sin(heading)),
            "yaw": np.degrees(heading),
            "wheel": speed,
        }
        pd.DataFrame(columns).to_csv(tmp_path / "logs" / f"{name}.csv", index=False)
    return tmp_path


@pytest.fixture
def mine(rng) -> Mapping[str, object]:
    """Arrays and a table, under the names that the pages use for them."""
    states, controls = rng.normal(size=(6, 2)), rng.uniform(-1.0, 1.0, 5)
    frame = pd.DataFrame(states, columns=["theta", "theta_dot"]).assign(
        torque=[*controls, 0.0], run=["a", "a", "a", "b", "b", "b"]
    )
    return {"states": states, "controls": controls, "frame": frame}


def test_the_column_map_of_the_page_is_read_and_its_defaults_are_those_of_its_table(workplace):
    columns = load_columns("my_robot.toml")
    assert columns.differentiated == ()
    system = Dataset.read("logs", columns="my_robot.toml").system
    channels = {channel.name: channel for channel in (*system.states, *system.controls)}
    assert (channels["battery"].low, channels["battery"].neutral) == (6.0, 7.4)
    assert channels["yaw_rate"].unit == "rad/s"
    assert channels["steer"].levels == (-1.0, 0.0, 1.0)


def test_every_column_map_of_the_page_is_valid():
    car, pendulum = (parse_columns(block, "docs/data.md") for block in blocks(PAGE, "toml"))
    assert (car.name, pendulum.name) == ("my robot", "pendulum")
    assert [channel.unit for channel in pendulum.system({}).states] == ["rad", "rad/s"]


def test_a_state_that_is_never_0_needs_no_neutral_value(workplace):
    path = workplace / "my_robot.toml"
    path.write_text(path.read_text().replace(", neutral = 7.4", ""))
    assert Dataset.read("logs", columns=path).system.states[2].neutral == 6.0


def test_the_python_of_the_page_runs(workplace, mine):
    scope = dict(mine)
    for block in blocks(PAGE, "python"):
        exec(compile(block, "docs/data.md", "exec"), scope)
    assert scope["test"].names == ("last_drive",)
    assert scope["data"].names == ("a", "b")
    assert scope["pendulum"].controls[0].unit == "N m"


def test_the_python_of_the_readme_on_data_runs(mine):
    section = README.partition("## On your own recordings")[2].partition("\n## ")[0]
    scope = dict(mine)
    for block in blocks(section, "python"):
        exec(compile(block, "README.md", "exec"), scope)
    assert len(scope["data"].episodes[0]) == 5


def test_the_commands_of_the_page_exist_with_these_options(workplace):
    group = loaded()
    lines = [line.partition("#")[0] for block in blocks(PAGE, "sh") for line in block.splitlines()]
    assert len(lines) == 3
    for line in lines:
        program, name, *arguments = shlex.split(line)
        assert program == "sysid-evo"
        command = group.commands[name]
        with command.make_context(name, arguments):
            pass


@pytest.mark.parametrize("name", ["inspect", "import"])
def test_the_commands_on_logs_run(workplace, name):
    (line,) = [line for line in blocks(PAGE, "sh")[0].splitlines() if line.startswith(f"sysid-evo {name}")]
    result = CliRunner().invoke(app, shlex.split(line.partition("#")[0])[1:], catch_exceptions=False)
    assert result.exit_code == 0


def test_every_shipped_map_is_named_on_the_page():
    assert set(shipped_names()) <= set(re.findall(r"`(\w+)`", PAGE))
