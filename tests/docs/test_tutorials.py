"""Tutorials and the page for a system of one's own, from an empty folder, as pages and as notebooks."""

import os
import re
import subprocess
import sys
from pathlib import Path

import nbformat
import numpy as np
import pytest

from hardware.robot import find_robot
from sysid_evo import Champion, load_plugin, make_controller, make_task, trial_seeds
from sysid_evo.data import Dataset
from sysid_evo.export.exported_controller import exported_controller
from sysid_evo.export.python_file import python_text
from tests.docs.page import PAGES, QUICK, importable, notebook_of, picture, words_of
from tests.fixtures.commands import forgetting

OWN_SYSTEM = "your_own_system.md"
WIDTH = 80


def of_a_system_of_ones_own(folder, printed):
    checks = [one.text for one in printed if "robots check" in one.line]
    assert len(checks) == 2
    assert not any(line.startswith("wrong") for text in checks for line in text.splitlines())
    assert Dataset.read(folder / "data").system.state_names == ("upper", "lower")
    for run in ("first", "turntable"):
        assert "Which controller to use?" in (folder / "runs" / run / "report.html").read_text()
    assert any("on tank" in one.text for one in printed if " drive " in one.line)
    ran = subprocess.run(["python3", "recommended.py"], cwd=folder, capture_output=True, text=True, check=False)
    assert ran.stdout.startswith("ok"), ran.stderr
    assert "(target - lower) / (0.2 m)" in (folder / "recommended.c").read_text()


@pytest.mark.nightly
@pytest.mark.parametrize("name", [OWN_SYSTEM, *(name for name in PAGES if name.startswith("tutorials/"))])
def test_a_page_works_from_an_empty_folder(name, tmp_path, monkeypatch):
    """No line that is printed is wider than the terminal, but paths and commands; the pictures are those of the runs.

    A picture of a smaller budget has other numbers, so it is told by what is written in it.
    """
    monkeypatch.setenv("COLUMNS", str(WIDTH))
    monkeypatch.setenv("SYSID_EVO_ENGINE", "auto")
    options = {**QUICK, "record": ("--minutes", "9")} if name == OWN_SYSTEM else QUICK
    printed = list(PAGES[name].visit(tmp_path, options))
    for one in printed:
        wide = [row for row in one.text.splitlines() if len(row.rstrip()) > WIDTH]
        assert not [row for row in wide if not re.search(rf"\S{os.sep}\S|use:|check:", row)], one.line
    for run, figure in PAGES[name].pictures:
        made = tmp_path / "runs" / run / "figures" / f"{figure}.svg"
        assert words_of(picture(run, figure)) == words_of(made), "make pictures"
    if name == OWN_SYSTEM:
        of_a_system_of_ones_own(tmp_path, printed)


@pytest.mark.nightly
@pytest.mark.parametrize("name", [name for name in PAGES if name.startswith("tutorials/")])
def test_a_tutorial_runs_as_the_notebook_that_is_offered(name, tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setenv("SYSID_EVO_ENGINE", "auto")
    notebook = notebook_of(PAGES[name], QUICK)
    assert {cell.cell_type for cell in notebook.cells} == {"code", "markdown"}
    nbformat.write(notebook, tmp_path / "tutorial.ipynb")
    execute = "from nbclient.cli import main; main()"
    command = [sys.executable, "-c", execute, "--inplace", "--kernel_name", "python3", "tutorial.ipynb"]
    subprocess.run(command, cwd=tmp_path, check=True)


def test_controls_at_rest_do_not_win_the_task_of_ones_own(tmp_path):
    """A reward must ask for something: a pole that stands, not the one that hangs where nobody acts."""
    file = tmp_path / "near_the_middle.py"
    file.write_text(PAGES["tutorials/own_task.md"].blocks("python")[0].text)
    robot = find_robot("cart_pole")
    with forgetting():
        load_plugin(file)
        task = make_task("near_the_middle").bind(robot.system)
        feedback = make_controller("linear(inputs=[position, speed, sin_angle, angular_speed])").bind_to(task)
        # at rest, and a linear-quadratic regulator of the upright pole, as shares of the largest force
        gains = np.array([np.zeros(5), [2.09, 1.82, 7.85, -1.45, 0.0]])
        rest, balanced = robot.runner().bind(feedback, task)(gains, trial_seeds(1, 20)).fitness.mean(axis=1)
    assert rest < 0.1
    assert balanced > 0.95


def test_the_loop_of_the_pendulum_earns_what_the_controller_earns_as_a_robot(tmp_path, capsys):
    name = "Pendulum-v1"
    robot, task = find_robot(f'gymnasium(id="{name}")'), make_task(f'environment(id="{name}")')
    controller = make_controller("recurrent(hidden=4)").bind_to(task.bind(robot.system))
    weights = np.random.default_rng(0).standard_normal(controller.n_parameters)
    champion = Champion(
        "recommended",
        weights,
        ("x",),
        "min",
        0,
        np.empty((0, 3)),
        controller="recurrent(hidden=4)",
        task=f'environment(id="{name}")',
        system=robot.system,
    )
    (tmp_path / "recommended.py").write_text(python_text(exported_controller(champion)))
    with importable(tmp_path):
        exec(PAGES["tutorials/pendulum.md"].blocks("python")[-1].text, {})
    earned = robot.runner().bind(controller, task)(weights[None], np.zeros(1, dtype=np.uint64)).fitness
    assert capsys.readouterr().out == f"{earned.item():.0f} in 200 steps\n"
