"""Every tutorial works as it stands: files, commands and Python, from an empty folder, in the order of the page."""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path

import numpy as np
import pytest

from hardware.robot import find_robot
from sysid_evo import Champion, load_plugin, make_controller, make_task, trial_seeds
from sysid_evo.export.exported_controller import law_of
from sysid_evo.export.python_file import python_text
from tests.docs.blocks import PAGES, blocks
from tests.docs.running import SMALL, picture, run_page, shown_on, words_of
from tests.fixtures.commands import forgetting

TUTORIALS = [page for page in PAGES if page.startswith("tutorials/")]
WIDTH = 80
LARGEST = 120_000
"""Bytes of a picture, so that a page is there at once."""


@pytest.mark.parametrize("page", TUTORIALS)
def test_a_tutorial_runs_from_an_empty_folder(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No line that is printed is wider than the terminal, but paths and commands; the pictures are those of the runs.

    A picture of a smaller budget has other numbers, so it is told by what is written in it.
    """
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", str(WIDTH))
    for said in run_page(page, tmp_path, SMALL):
        wide = [row for row in said.printed.splitlines() if len(row.rstrip()) > WIDTH]
        assert not [row for row in wide if not re.search(rf"\S{os.sep}\S|use:|check:", row)], said.line
    for run, figure in shown_on(page):
        shown, made = picture(run, figure), tmp_path / "runs" / run / "figures" / f"{figure}.svg"
        assert words_of(shown) == words_of(made), "make pictures"
        assert shown.stat().st_size < LARGEST


def test_every_picture_of_a_run_is_shown_somewhere() -> None:
    shown = {picture(run, figure) for page in PAGES for run, figure in shown_on(page)}
    assert set(picture("any", "any").parent.glob("*.svg")) == shown


def test_controls_at_rest_do_not_win_the_task_of_ones_own(tmp_path: Path) -> None:
    """A reward must ask for something: a pole that stands, not the one that hangs where nobody acts."""
    file = tmp_path / "near_the_middle.py"
    file.write_text(blocks("tutorials/own_task.md", "python")[0].text)
    robot = find_robot("cart_pole")
    with forgetting():
        load_plugin(file)
        task = make_task("near_the_middle").bind(robot.system)
        feedback = make_controller("linear(inputs=[position, speed, sin_angle, angular_speed])").bind_to(task)
        # at rest, and a linear-quadratic regulator of the upright pole, as shares of the largest force
        gains = np.array([np.zeros(5), [2.09, 1.82, 7.85, -1.45, 0.0]])
        rest, balanced = robot.runner().run(feedback, gains, task, trial_seeds(1, 20)).fitness.mean(axis=1)
    assert rest < 0.1
    assert balanced > 0.95


def test_the_loop_of_the_pendulum_earns_what_the_controller_earns_as_a_robot(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.syspath_prepend(tmp_path)
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
    (tmp_path / "recommended.py").write_text(python_text(law_of(champion)))
    sys.modules.pop("recommended", None)  # of the page, where that ran before
    exec(blocks("tutorials/pendulum.md", "python")[-1].text, {})
    del sys.modules["recommended"]
    earned = robot.runner().run(controller, weights[None], task, np.zeros(1, dtype=np.uint64)).fitness
    assert capsys.readouterr().out == f"{earned.item():.0f} in 200 steps\n"
