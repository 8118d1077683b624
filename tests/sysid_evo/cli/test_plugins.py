"""The plugin path: for every public kind a new package that works as it is written."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from sysid_evo.cli.plugins import app
from sysid_evo.errors import InvalidArgument, SysidEvoError
from sysid_evo.registry import KINDS
from sysid_evo.testing.template import PLUGINS, write_plugin
from tests.fixtures.commands import run_here

OPTIONS = ["-q", "-p", "no:cacheprovider", "--import-mode=prepend", "-c", os.devnull, "--rootdir", "."]

CHECK_ALL = """
import sys
from typer.testing import CliRunner
from sysid_evo.cli.plugins import app

for line in sys.stdin.read().splitlines():
    done = CliRunner().invoke(app, ["check", *line.split()])
    print(line.split()[0], done.exit_code, done.output.count("ok     "), done.output.count("BROKEN"), done.exception)
"""


@pytest.fixture(scope="module")
def packages(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a new package of every kind, called my_KIND."""
    folder = tmp_path_factory.mktemp("plugins")
    for kind in PLUGINS:
        assert folder / f"my_{kind}" / f"my_{kind}.py" in write_plugin(f"my_{kind}", folder / f"my_{kind}", kind)
    return folder


def python(*arguments: str, cwd: Path, path: str = "", given: str = "") -> str:
    """What a Python process prints that ends well."""
    done = subprocess.run(
        [sys.executable, *arguments],
        cwd=cwd,
        env={**os.environ, "PYTHONPATH": path},
        input=given,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def test_the_own_test_of_a_new_plugin_of_every_kind_passes(packages: Path) -> None:
    tests = [str(path) for path in sorted(packages.glob("*/tests/test_*.py"))]
    assert len(tests) == len(PLUGINS)
    path = os.pathsep.join(str(packages / f"my_{kind}") for kind in PLUGINS)
    assert f"{len(PLUGINS)} passed" in python("-m", "pytest", *OPTIONS, *tests, cwd=packages, path=path)


def test_a_new_plugin_of_every_kind_keeps_the_contract_by_the_command(packages: Path) -> None:
    lines = [
        f"my_{kind} --plugin my_{kind}/my_{kind}.py{of_kind.check.replace('tests/', f'my_{kind}/tests/')}"
        for kind, of_kind in PLUGINS.items()
    ]
    told = python("-c", CHECK_ALL, cwd=packages, given="\n".join(lines)).splitlines()
    assert [line.split()[0] for line in told] == [f"my_{kind}" for kind in PLUGINS]
    for line in told:
        _, code, kept, broken, *error = line.split()
        assert (code, broken, error) == ("0", "0", ["None"]), line
        assert int(kept) >= 7


def test_a_kind_of_which_there_is_no_template_is_refused(tmp_path: Path) -> None:
    for kind in set(KINDS) - set(PLUGINS):
        with pytest.raises(InvalidArgument, match=f"expected a kind among .*, got '{kind}'"):
            write_plugin("mine", tmp_path, kind)


def test_new_says_how_to_check_and_overwrites_nothing(tmp_path: Path) -> None:
    written = run_here("plugin", "new", "my_log", "--kind", "reader", cwd=tmp_path)
    assert written.returncode == 0, written.stderr
    command = written.stderr.split("check it with: ")[1].split()
    assert command[:3] == ["sysid-evo", "plugin", "check"]
    checked = run_here(*command[1:], cwd=tmp_path)
    assert checked.returncode == 0, checked.stdout + checked.stderr
    assert max(map(len, checked.stdout.splitlines())) <= 80
    again = run_here("plugin", "new", "my_log", "--kind", "reader", cwd=tmp_path)
    assert again.returncode == 2
    assert "would be overwritten" in " ".join(again.stderr.split())


def test_a_plugin_that_breaks_the_contract_is_told_which_sentence(tmp_path: Path) -> None:
    folder = tmp_path / "my_model"
    path, *_ = write_plugin("my_model", folder)
    path.write_text(
        path.read_text().replace("return self._regressors(carry", "carry[:] = 0\n        return self._regressors(carry")
    )
    checked = run_here("plugin", "check", "my_model", "--plugin", path, cwd=tmp_path)
    assert checked.returncode == 1
    assert "BROKEN A step changes neither its arguments nor its own later results" in checked.stdout


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (("new", "my-model"), "expected a lower-case Python name such as my_model, got 'my-model'"),
        (("new", "linear"), "model 'linear' is taken by the module model_zoo.linear, so that the new module linear"),
        (("new", "niches", "--kind", "strategy"), "strategy 'niches' is taken by the module sysid_evo.evolution."),
        (("new", "random", "--kind", "task"), "a module called 'random' can be imported already"),
        (("new", "mine", "--kind", "modle"), "expected a kind among model, task, controller, strategy, robot, reader,"),
        (("check", "linnear"), "no model, task, controller, strategy, robot or reader is called 'linnear'"),
        (("check", "linear", "--kind", "task"), "no task is called 'linear'"),
        (("check", "csv"), "a reader is checked on a file of its kind: name one with --data"),
        (("check", "niches", "--data", "logs"), "kind strategy is checked without recordings: leave --data out"),
    ],
)
def test_a_mistake_is_told_before_anything_is_written(
    arguments: tuple[str, ...], reason: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(app, list(arguments))
    assert isinstance(done.exception, SysidEvoError)
    assert reason in str(done.exception)
    assert not list(tmp_path.iterdir())


def test_a_name_in_use_is_exit_code_2(tmp_path: Path) -> None:
    done = run_here("plugin", "new", "linear", cwd=tmp_path)
    assert done.returncode == 2
    assert "model 'linear' is taken by the module model_zoo.linear" in " ".join(done.stderr.split())


def test_a_shipped_thing_is_checked_by_its_name_alone_with_parameters() -> None:
    done = CliRunner().invoke(app, ["check", "mu_plus_lambda(parents=5, children=5)"])
    assert done.exit_code == 0, done.output
    assert "ok     Fitness is maximised: on a hill the elite climbs" in done.output


def test_a_check_says_where_there_is_no_compiled_form_and_wrapped_sentences_hang(tmp_path: Path) -> None:
    checked = run_here("plugin", "check", "k_neighbours", cwd=tmp_path)
    assert checked.returncode == 0, checked.stdout
    (tmp_path / "slow.py").write_text(SLOW)
    slow = run_here("plugin", "check", "slow_one", "--plugin", "slow.py", cwd=tmp_path)
    lines = slow.stdout.splitlines()
    assert any(line.startswith("-      The compiled form steps as step does: it has none") for line in lines)
    assert not any(line.startswith("ok     The compiled form") for line in lines)
    assert all(line[:7] in ("ok     ", "-      ", "BROKEN ", "       ") for line in lines)
    assert any(line.startswith("       ") for line in lines)


SLOW = """
import numpy as np
from sysid_evo import DynamicsModel, register_model


@register_model("slow_one")
class SlowOne(DynamicsModel):
    \"\"\"The mean change.\"\"\"

    def fit(self, dataset, *, rng, progress=None):
        if progress:
            progress(0, 1)
        steps = dataset.transitions()
        self.mean_ = dataset.system.acceleration(steps.carry, steps.after).mean(axis=0)
        if progress:
            progress(1, 1)
        return self

    def acceleration(self, carry, control):
        return np.tile(self.mean_, (len(carry), 1))
"""


def test_names_lists_the_kinds_first_and_takes_their_plural(tmp_path: Path) -> None:
    kinds = run_here("names", cwd=tmp_path).stdout
    assert len(kinds.splitlines()) < 40
    assert all(kind in kinds for kind in KINDS)
    one, several = run_here("names", "strategy", cwd=tmp_path), run_here("names", "strategies", cwd=tmp_path)
    assert one.returncode == several.returncode == 0
    assert one.stdout == several.stdout
    assert "sigma" in one.stdout
    assert "`" not in run_here("names", "model", cwd=tmp_path).stdout
    assert {row["kind"] for row in json.loads(run_here("names", "--json", cwd=tmp_path).stdout)} == set(KINDS)
