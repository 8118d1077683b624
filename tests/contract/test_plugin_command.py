"""The plugin path: for every public kind a new package that works as it is written."""

import json
import os
import subprocess
import sys

import pytest
from typer.testing import CliRunner

from sysid_evo.cli.app import app
from sysid_evo.errors import InvalidArgument, SysidEvoError
from sysid_evo.registry.registry import KINDS
from sysid_evo.testing.template import PLUGINS, write_plugin
from tests.fixtures.commands import run_here

PYTEST = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--import-mode=prepend"]
SLOW = '''
import numpy as np
from sysid_evo import DynamicsModel, register_model


@register_model("slow_one")
class SlowOne(DynamicsModel):
    """The mean change."""

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
'''


@pytest.fixture(scope="module")
def packages(tmp_path_factory):
    """A folder with a new package of every kind, called my_KIND."""
    folder = tmp_path_factory.mktemp("plugins")
    for kind in PLUGINS:
        assert folder / f"my_{kind}" / f"my_{kind}.py" in write_plugin(f"my_{kind}", folder / f"my_{kind}", kind)
    return folder


def test_the_own_test_of_a_new_plugin_of_every_kind_passes(packages):
    tests = [str(path) for path in sorted(packages.glob("*/tests/test_*.py"))]
    assert len(tests) == len(PLUGINS)
    done = subprocess.run(  # as the author of a plugin runs them, outside this suite
        [*PYTEST, "-c", os.devnull, "--rootdir", ".", *tests],
        cwd=packages,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(str(packages / f"my_{kind}") for kind in PLUGINS)},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert f"{len(PLUGINS)} passed" in done.stdout, done.stdout + done.stderr


@pytest.mark.parametrize("kind", PLUGINS)
def test_a_new_plugin_of_every_kind_keeps_the_contract_by_the_command(kind, packages):
    options = PLUGINS[kind].check.replace("tests/", f"my_{kind}/tests/").split()
    done = run_here("plugin", "check", f"my_{kind}", "--plugin", f"my_{kind}/my_{kind}.py", *options, cwd=packages)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count("ok     ") >= 7
    assert "FAILED" not in done.stdout


def test_a_kind_of_which_there_is_no_template_is_refused(tmp_path):
    for kind in set(KINDS) - set(PLUGINS):
        with pytest.raises(InvalidArgument, match=f"expected a kind among .*, got '{kind}'"):
            write_plugin("mine", tmp_path, kind)


def test_new_prints_the_check_command_and_overwrites_nothing(tmp_path):
    written = run_here("plugin", "new", "my_log", "--kind", "reader", cwd=tmp_path)
    assert written.returncode == 0, written.stderr
    command = written.stderr.split("check it with: ")[1].split()
    assert command[:3] == ["sysid-evo", "plugin", "check"]
    checked = run_here(*command[1:], cwd=tmp_path)
    assert checked.returncode == 0, checked.stdout + checked.stderr
    assert max(map(len, checked.stdout.splitlines())) <= 80
    assert "compare it with" not in written.stderr
    model = run_here("plugin", "new", "my_model", cwd=tmp_path)
    command = model.stderr.split("compare it with: ")[1].split()
    compared = run_here(*command[1:], "--dry-run", cwd=tmp_path)
    assert "fit my_model" in compared.stdout, compared.stderr
    again = run_here("plugin", "new", "my_log", "--kind", "reader", cwd=tmp_path)
    assert again.returncode == 2
    assert "would be overwritten" in " ".join(again.stderr.split())


def test_a_broken_rule_of_the_contract_is_printed(tmp_path):
    path, *_ = write_plugin("my_model", tmp_path / "my_model")
    path.write_text(
        path.read_text().replace("return self._regressors(carry", "carry[:] = 0\n        return self._regressors(carry")
    )
    checked = run_here("plugin", "check", "my_model", "--plugin", path, cwd=tmp_path)
    assert checked.returncode == 1
    assert "FAILED step changes neither its arguments nor its later results" in checked.stdout


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (("new", "my-model"), "expected a lower-case Python name such as my_model, got 'my-model'"),
        (("new", "linear"), "model 'linear' is already registered by the module model_zoo.linear: choose another name"),
        (
            ("new", "niches", "--kind", "strategy"),
            "strategy 'niches' is already registered by the module sysid_evo.evolution.",
        ),
        (("new", "random", "--kind", "task"), "a module called 'random' already exists"),
        (
            ("new", "mine", "--kind", "modle"),
            "expected a kind among model, task, controller, strategy, adapter, robot, reader",
        ),
        (
            ("check", "linnear"),
            "no model, task, controller, strategy, adapter, robot or reader is called 'linnear'. Did you mean",
        ),
        (("check", "unlike_any"), "is called 'unlike_any'. If it is defined in your own file, add --plugin FILE"),
        (("check", "linear"), "'linear' is a model and a controller: choose one with --kind"),
        (("check", "linear", "--kind", "task"), "no task is called 'linear'"),
        (("check", "linear", "--kind", "modle"), "plugin: expected a kind among model, task, controller, strategy"),
        (("check", "csv"), "a reader is checked on an example file: name one with --data"),
        (("check", "niches", "--data", "logs"), "kind strategy is checked without recordings: leave --data out"),
    ],
)
def test_a_mistake_is_reported_before_anything_is_written(arguments, reason, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(app, ["plugin", *arguments])
    assert isinstance(done.exception, SysidEvoError)
    assert reason in str(done.exception)
    assert not list(tmp_path.iterdir())


def test_a_shipped_thing_is_checked_by_its_name_alone_with_parameters():
    done = CliRunner().invoke(app, ["plugin", "check", "mu_plus_lambda(parents=5, children=5)"])
    assert done.exit_code == 0, done.output
    assert "ok     Fitness is maximised: the elite approaches the optimum of a quadratic" in done.output


def test_a_check_is_on_the_recordings_that_are_given(stored_data, tmp_path):
    for command in (("linear", "--kind", "model"), ("point_to_point",)):
        done = run_here("plugin", "check", *command, "--data", stored_data, cwd=tmp_path)
        assert done.returncode == 0, done.stdout + done.stderr


def test_a_check_reports_a_missing_compiled_form_and_wrapped_lines_are_indented(tmp_path, monkeypatch):
    monkeypatch.setenv("SYSID_EVO_ENGINE", "auto")
    (tmp_path / "slow.py").write_text(SLOW)
    lines = run_here("plugin", "check", "slow_one", "--plugin", "slow.py", cwd=tmp_path).stdout.splitlines()
    assert any(line.startswith("-      The compiled form gives the results of step: it has no") for line in lines)
    assert not any(line.startswith("ok     The compiled form") for line in lines)
    assert all(line[:7] in ("ok     ", "-      ", "FAILED ", "       ") for line in lines)
    assert any(line.startswith("       ") for line in lines)


def test_names_lists_the_kinds_first_and_takes_their_plural(tmp_path):
    kinds = run_here("names", cwd=tmp_path).stdout
    assert len(kinds.splitlines()) < 40
    assert all(kind in kinds for kind in KINDS)
    one, several = run_here("names", "strategy", cwd=tmp_path), run_here("names", "strategies", cwd=tmp_path)
    assert one.returncode == several.returncode == 0
    assert one.stdout == several.stdout
    assert "sigma" in one.stdout
    assert "`" not in run_here("names", "model", cwd=tmp_path).stdout
    assert {row["kind"] for row in json.loads(run_here("names", "--json", cwd=tmp_path).stdout)} == set(KINDS)


def test_a_reward_in_a_file_of_its_own_has_a_name_on_the_command_line(tmp_path):
    (tmp_path / "warm.py").write_text(
        "from sysid_evo import register_reward\n\n\n"
        '@register_reward("warm", min_reward=-100.0)\n'
        "def warm(temperature, heater, wanted=50.0):\n"
        '    """As warm as is wanted, and little heating."""\n'
        "    return -abs(temperature - wanted) - heater\n"
    )
    listed = run_here("names", "task", "--plugin", "warm.py", "--json", cwd=tmp_path)
    (row,) = [row for row in json.loads(listed.stdout) if row["name"] == "warm"]
    assert row["summary"] == "As warm as is wanted, and little heating."
    assert row["parameters"] == "horizon=300, wanted=50.0"
    done = run_here(
        "evolve", "--plugin", "warm.py", "--against", "thermal", "--task", "warm(wanted=40, horizon=20)",
        "--controller", "linear", "--generations", "2", "--trials", "2", "--strategy", "mu_plus_lambda(children=5)",
        "--run", ".", cwd=tmp_path,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
