"""The table of SECURITY.md, line by line: whose Python runs because of which file, and when."""

import py_compile
import shutil
from pathlib import Path

import numpy as np
import pytest

from evaluation import (
    Experiment,
    MeasuredResult,
    Study,
    TransferResult,
    comparison_of,
    load_measured,
    plan_study,
    run_study,
)
from evaluation.transfer.matrix import human_driver
from sysid_evo import load_plugin
from sysid_evo.cli.runs import add_measured
from sysid_evo.errors import PluginError
from tests.fixtures.commands import SMALL, Caller, forgetting, run_here
from tests.fixtures.session import without_figures

pytestmark = pytest.mark.usefixtures("blank_figures")
PLUGIN = '''
"""A task of somebody's, which leaves a trace when it runs."""
import os
from pathlib import Path
from sysid_evo import PointToPoint, register_task

with Path(os.environ["RAN"]).open("a") as trace:
    trace.write("ran\\n")


@register_task("stand")
class Stand(PointToPoint):
    """Like point to point."""
'''
STAND = (
    *SMALL, "--models", "linear", "--task", "stand(horizon=20)", "--procedure", "plain",
    "--controller", "linear",
)  # fmt: skip
PLANNED = ("compare", "--config", "run", "--dry-run")


@pytest.fixture(scope="module")
@without_figures()
def made(stored_data, tmp_path_factory):
    """A folder with a plugin, a run that used it, a study and a configuration that name it."""
    folder = tmp_path_factory.mktemp("theirs")
    (folder / "stand.py").write_text(PLUGIN)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RAN", str(folder / "ran"))
        patch.setenv("XDG_STATE_HOME", str(folder / "state"))
        done = run_here("compare", "--data", stored_data, "--plugin", "stand.py", *STAND, "--out", "run", cwd=folder)
    assert done.returncode == 0, done.stderr
    (folder / "own.toml").write_text(f'plugins = ["stand.py"]\ntask = "stand"\ndata = ["{stored_data}"]\n')
    study = '[experiment]\nplugins = ["stand.py"]\nmodels = ["linear"]\nminutes = 0.5\nstop_after = "prediction"\n'
    (folder / "study.toml").write_text(f"{study}[grid]\nseed = [0, 1]\n")
    return folder


@pytest.fixture
def theirs(made, tmp_path, monkeypatch):
    """A copy of all that, on a machine where the plugin has never run."""
    shutil.copytree(made, tmp_path / "theirs", ignore=shutil.ignore_patterns("state", "ran"))
    file = tmp_path / "theirs" / "run" / "experiment.toml"
    file.write_text(file.read_text().replace(str(made), str(tmp_path / "theirs")))
    monkeypatch.setenv("RAN", str(tmp_path / "theirs" / "ran"))
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    return tmp_path / "theirs"


@pytest.fixture
def there(theirs, capsys):
    return Caller(theirs, capsys)


@pytest.mark.parametrize(
    "command",
    [
        ("report", "run"),
        ("transfer", "run", "--on", "run"),
        ("compare", "--config", "run", "--dry-run"),
        ("compare", "--config", "run", "--preset", "standard"),
        ("compare", "--config", "own.toml"),
        ("study", "study.toml", "--out", "points"),
        ("study", "study.toml", "--dry-run"),
    ],
)
def test_a_file_that_names_a_plugin_runs_none_that_has_not_run_here(command, there, theirs):
    refused = there.refused(*command)
    assert refused.says(f"names the plugin {theirs}/stand.py, which has not run here yet")
    assert refused.says("add --plugin")
    assert not (theirs / "ran").exists()


def test_what_is_given_runs_and_is_trusted_until_it_changes(there, theirs):
    assert there(*PLANNED, "--plugin", "stand.py").code == 0
    for command in (
        ("report", "run"),
        PLANNED,
        ("study", "study.toml", "--dry-run"),
    ):
        there.works(*command)
    before = (theirs / "ran").read_text()
    with (theirs / "stand.py").open("a") as file:
        file.write("# changed\n")
    refused = there("report", "run")
    assert refused.says("has changed since it ran here")
    assert (theirs / "ran").read_text() == before
    shutil.copy(theirs / "stand.py", theirs / "run")  # elsewhere it may be something else: it reads files beside it
    file = theirs / "run" / "experiment.toml"
    file.write_text(file.read_text().replace("stand.py", "run/stand.py"))
    assert there(*PLANNED).says("has not run here yet")


def test_bytecode_beside_a_trusted_plugin_is_not_run(there, theirs):
    plugin = theirs / "stand.py"
    source = plugin.read_text()
    assert there(*PLANNED, "--plugin", "stand.py").code == 0
    plugin.write_text(source + "\nraise SystemExit('bytecode')\n")
    py_compile.compile(str(plugin), invalidation_mode=py_compile.PycInvalidationMode.UNCHECKED_HASH)
    plugin.write_text(source)
    assert there(*PLANNED).code == 0


@pytest.mark.filterwarnings("default::sysid_evo.errors.PluginWarning")
def test_a_plugin_that_stands_elsewhere_now_is_given_where_it_is(there, theirs):
    (theirs / "stand.py").rename(theirs / "run" / "stand.py")
    assert there("report", "run").says("which is not there")
    assert there.works(*PLANNED, "--plugin", "run/stand.py").says("which has the same name, is used for it")


def test_python_runs_what_it_is_given_and_nothing_that_a_file_names(there, theirs, monkeypatch):
    monkeypatch.chdir(theirs)
    Experiment.read("run")
    study = Study.read("study.toml")
    for refused in (lambda: comparison_of(Path("run")), lambda: plan_study(study), lambda: run_study("study.toml")):
        with pytest.raises(PluginError, match="in Python call load_plugin first"):
            refused()
    assert not (theirs / "ran").exists()
    with forgetting():
        load_plugin("stand.py")
        assert comparison_of(Path("run"))[0].experiment.task == "stand(horizon=20)"
        assert plan_study(study).study.experiment["plugins"] == [str(theirs / "stand.py")]
    with forgetting():
        assert plan_study(study).points


def test_a_command_that_needs_the_task_of_a_plugin_names_the_option_and_takes_it(there, theirs):
    command = ("export", "run/controllers/linear", "--to", "python", "--out", "law.py")
    refused = there.refused(*command)
    assert refused.says("no task is called 'stand'")
    assert refused.says("--plugin FILE")
    assert not (theirs / "ran").exists()
    there.works(*command, "--plugin", "stand.py")


def test_what_was_driven_is_kept_in_a_run_whose_plugins_do_not_run(there, theirs, capsys):
    driven = TransferResult("anna", "linear", np.array([5.0]), unit="waypoints")
    add_measured(theirs / "run", MeasuredResult(human_driver("anna"), driven, on_robot=False))
    assert "its report is not updated" in " ".join(capsys.readouterr().err.split())
    assert len(load_measured(theirs / "run")[0]) == 1
    assert not (theirs / "ran").exists()


def test_names_in_models_and_files_of_robots_import_nothing(there, theirs):
    (theirs / "evil.py").write_text((theirs / "stand.py").read_text())
    (theirs / "evil.toml").write_text('driver = "evil:Car"\n')
    (model,) = (theirs / "run" / "models").glob("linear-*.json")
    named = model.read_text().replace('"name": "linear"', '"name": "evil"')
    model.write_text(named.replace('"module": "model_zoo.linear"', '"module": "evil"'))
    assert '"module": "evil"' in model.read_text()
    for command, said in (
        (("models", "show", "run/models/linear"), "needs the model family 'evil', which the module 'evil' registered"),
        (("robots", "check", "evil.toml"), "no robot is called 'evil:Car'"),
        (("robots", "check", "evil.py:Car"), "expected NAME(parameter=value, ...)"),
        (("fit", "run", "--models", "evil.Model"), "expected NAME(parameter=value, ...)"),
    ):
        assert there.refused(*command).says(said)
    assert not (theirs / "ran").exists()


def test_where_nothing_can_be_remembered_a_plugin_is_given_every_time(there, monkeypatch):
    monkeypatch.setenv("XDG_STATE_HOME", "/proc")
    assert there(*PLANNED, "--plugin", "stand.py").code == 0
    assert there(*PLANNED).says("has not run here yet")


def test_no_module_of_the_current_folder_is_imported(there, theirs):
    """Nor by processes of a command, see test_interruption."""
    (theirs / "evil.py").write_text((theirs / "stand.py").read_text())
    (theirs / "evil.toml").write_text(
        'robot = "gymnasium(id=\'evil:Car-v0\')"\nstop_after = "fit"\nmodels = ["linear"]\n'
    )
    assert there("compare", "--config", "evil.toml").says("No module named 'evil'")
    assert not (theirs / "ran").exists()
