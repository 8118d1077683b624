"""The command line answers fast because it imports what is heavy only when it is needed."""

import importlib.util
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from evaluation.experiment import Experiment
from sysid_evo.cli.app import COMMANDS, load
from sysid_evo.registry import models
from sysid_evo.registry.plugins import declared
from sysid_evo.settings import option_of

HEAVY = {"torch", "sklearn", "scipy", "matplotlib", "numba", "numpy", "pandas", "pyarrow", "pysindy", "packaging"}
MOST_MODULES = 450
"""Modules that help may import, so that it is there in half a second; the time on a busy machine says nothing."""

ASKED = """
import contextlib, io, json, os, sys
from sysid_evo.__main__ import main
from sysid_evo.cli.app import COMMANDS

os.environ["COLUMNS"] = "80"

def ask(*arguments, **environment):
    os.environ.pop("OMP_NUM_THREADS", None)
    os.environ.update(environment)
    sys.argv = ["sysid-evo", *arguments]
    out, wrong = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(wrong):
        try:
            main()
        except SystemExit as end:
            code = end.code
    return [code, out.getvalue(), wrong.getvalue(), sorted(sys.modules), os.environ["OMP_NUM_THREADS"]]

listed = ask("models", "list", "--json", OMP_NUM_THREADS="4")

def commands(table, before=""):
    for name, entry in table.items():
        yield f"{before}{name}"
        if not isinstance(entry.target, str):
            yield from commands(entry.target, f"{before}{name} ")

helped = {command: ask(*command.split(), "--help") for command in ("", *sorted(commands(COMMANDS)))}
print(json.dumps([listed, helped, ask("compare", "--models", "linaer")]))
"""
"""Answers of one process; what it imports for one is there for the next, so they are in the order of what they may."""
CORE = [f"sysid_evo.{name}" for name in ("models", "tasks", "controllers", "engine", "evolution", "testing")]
STAGES = """
import importlib, json, sys

def lists(*names):
    for name in names:
        importlib.import_module(name)
    told.append(sorted(sys.modules))

told = []
lists("sysid_evo")
lists("sysid_evo.plan.processes", "joblib.externals.loky.process_executor")
lists("tests.system.rig.__main__")
from evaluation.experiment import Experiment
from evaluation.planning import plan_comparison
from sysid_evo.data import Dataset
from sysid_evo.plan import Store, execute
settings = dict(models=("linear", "nearest_neighbour"), ensembles=(), generations=1, trials=1, selection_trials=1,
                transfer_trials=1, held_out=0.3, task="point_to_point(horizon=20)",
                strategy="mu_plus_lambda(children=4)", procedure="plain")
comparison = plan_comparison(Experiment.of(settings), dataset=Dataset.load(sys.argv[2]))
ended = execute(comparison.plan, Store(sys.argv[1]))
assert not any(outcome.failed for outcome in ended.values())
lists()
lists(*sys.argv[3:])
import sysid_evo
for name in sysid_evo.__all__:
    getattr(sysid_evo, name)
print(json.dumps([*told, sysid_evo.__all__]))
"""
"""Each stage has what those before it have imported, too: they are in the order of what they may import."""
SILENT = """
import sys

import gymnasium

gymnasium.make("Pendulum-v1")  # the spaces of an environment are known once it is made; its code is read here
from sysid_evo.registry import robots, trackers

tracker = {"driver": "udp", "body": "car", "port": 5005}
made = {
    "awkward_car": {"seed": 3, "stuck": 0.5},
    "emulated_car": {"seed": 3}, "cart_pole": {"seed": 3}, "pendulum": {"seed": 3}, "thermal": {"seed": 3},
    "gymnasium": {"id": "Pendulum-v1"},
    "serial": {"port": "/dev/nowhere", "tracker": tracker, "gate": {"speed": 8.0}},
    "natnet": {"body": "car"}, "udp": {"body": "car", "port": 5005},
    "vicon": {"body": "car"}, "vrpn": {"body": "car"},
}
factories = {name: registry.get(name) for registry in (robots, trackers) for name in registry.names()}
others = {"drift_car", "mujoco", "quadrotor"}  # they read the parameters of their packages, or the file of their user
assert made.keys() == factories.keys() - others, factories
touched = []
watched = ("open", "os.listdir", "os.scandir", "socket.", "subprocess.", "os.fork", "os.posix_spawn", "pty.")
sys.addaudithook(lambda event, values: event.startswith(watched) and touched.append((event, *map(str, values))))
for name, values in made.items():
    factories[name](**values)
    assert not touched, (name, touched)
sys.modules.update(dict.fromkeys(("serial", "cobs")))
robot = robots.make("serial", port="/dev/null")
for attempt in (robot.check, robot.connect):
    try:
        attempt()
    except ImportError as error:
        print(error)
"""


def answer(source, *arguments, cwd=None):
    """Return the last line of what a fresh interpreter prints."""
    command = [sys.executable, "-c", source, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=cwd)
    return json.loads(done.stdout.splitlines()[-1])


@pytest.fixture(scope="module")
def asked(tmp_path_factory):
    """Exit code, output, errors, imported modules and threads of libraries, of each of `ASKED`; nothing is written."""
    folder = tmp_path_factory.mktemp("empty")
    told = answer(ASKED, cwd=folder)
    assert not list(folder.iterdir())
    return told


def test_help_imports_nothing_heavy(asked):
    assert {"", "compare", "evolve", "fit", "models", "models show"} <= set(asked[1])
    for command, (code, out, _, imported, _) in asked[1].items():
        assert code == 0, command
        assert out.count("Usage: sysid-evo") == 1
        assert not HEAVY & set(imported), command
        assert "typer" in imported


LONGEST_PAGE = 70
METAVARS = {"PATH", "FILE", "DIR", "SPEC", "LIST", "NAME", "N", "TIME", "ADDR", "yes|no", ""}


def every_command():
    """Yield every command that is no group, by its name, with its entry."""
    for name, entry in COMMANDS.items():
        if isinstance(entry.target, str):
            yield name, entry, load(name)
        else:
            yield from ((f"{name} {part}", entry.target[part], load(part, entry.target)) for part in entry.target)


def test_every_help_page_has_at_most_seventy_lines_of_eighty_characters(asked):
    assert asked[1].keys() >= {name for name, *_ in every_command()}
    for command, (_, out, *_) in asked[1].items():
        lines = out.rstrip().splitlines()
        assert len(lines) <= LONGEST_PAGE, command
        assert max(map(len, lines)) <= 80, command
    panels = re.findall(r"^╭─ ([A-Z][a-z ]+) ─", asked[1]["compare"][1], re.MULTILINE)
    assert panels == ["Data and models", "Controllers", "Robustness", "Budget", "Run"]


def test_an_option_has_a_short_metavar_and_a_description_that_ends_with_one_full_stop():
    for command, _, loaded in every_command():
        for option in loaded.params:
            assert re.search(r"[^.,;]\.$", option.help), f"{command} {option.name}"
            assert "default" not in option.help, f"{command} {option.name}"
            if option.param_type_name == "option":
                assert (option.metavar or "") in METAVARS, f"{command} {option.name}"


def test_every_setting_is_described_and_those_of_the_command_line_are_options_of_compare():
    options = {option.name for option in load("compare").params}
    for name, field in Experiment.model_fields.items():
        assert re.search(r"[^.]$", field.description or ""), name
        assert (name in options) == bool(option_of(Experiment, name).panel), name


def test_the_line_of_a_command_is_the_first_paragraph_of_its_own_help():
    for name, entry, command in every_command():
        first, *_ = command.help.split("\n\n")
        assert entry.line == " ".join(first.split()), name


def test_families_are_listed_as_they_are_without_importing_one(asked):
    _, out, _, imported, threads = asked[0]
    assert not HEAVY - {"packaging"} & set(imported)
    assert threads == "4"
    rows = {row["name"]: row for row in json.loads(out)}
    assert set(rows) == set(models.names())
    for name, family in models.load_all():
        missing = [module for module in family.requires if importlib.util.find_spec(module) is None]
        assert tuple(declared(models.module(name), name).get("requires") or ()) == family.requires, name
        assert rows[name]["knowledge"] == family.knowledge, f"{name}: state its knowledge in the class itself"
        assert (rows[name]["lacking"] is None) == (not missing), f"{name}: state requires in the class itself"
        assert rows[name]["summary"] == (family.__doc__ or "").partition("\n")[0].replace("`", "")


def test_there_is_one_default_preset_and_every_help_page_with_a_preset_shows_it():
    named = Experiment.model_fields["preset"].default
    presets = {name: option for name in COMMANDS for option in load(name).params if option.name == "preset"}
    assert set(presets) == {"compare", "fit", "evolve", "exploit"}
    for option in presets.values():
        assert option.default is None
        assert f"({named})" in option.help
    assert f"`compare` with the default preset, `{named}`" in (Path(__file__).parents[2] / "README.md").read_text()


def test_the_module_is_the_same_program_and_imports_few_modules_for_its_help(call):
    command = [sys.executable, "-X", "importtime", "-m", "sysid_evo", "--help"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stderr.count("import time:") < MOST_MODULES
    assert "Usage: python -m sysid_evo" in done.stdout
    assert all(name in done.stdout for name in COMMANDS)
    assert call("--version").stdout.startswith("sysid-evo ")


def test_a_mistake_is_reported_on_standard_error_and_imports_nothing_that_only_the_work_needs(asked):
    code, out, wrong, imported, threads = asked[2]
    assert (code, out) == (2, "")
    assert "no model is called 'linaer'" in wrong
    assert "Traceback" not in wrong
    assert not {"matplotlib", "numba", "torch", "control", "pysindy"} & set(imported)
    assert threads == "1"  # libraries work on one thread unless they are told otherwise


@pytest.fixture(scope="module")
def stages(tmp_path_factory, stored_data):
    """What one process has imported after each of `STAGES`, and the public names of the package."""
    return answer(STAGES, tmp_path_factory.mktemp("stages") / "run", stored_data, *CORE, "model_zoo")


def test_the_package_is_imported_lazily_and_every_public_name_is_there(stages):
    early, *_, names = stages
    assert not HEAVY & set(early)
    assert {"Dataset", "System", "evolve_controller", "make_model", "rollout"} <= set(names)


COMPILER = {"numba", "llvmlite", "torch"}
COSTLY = {"sklearn", "scipy.stats", "scipy.signal", "scipy.optimize", "torch", "matplotlib", "pysindy", "typer"}


@pytest.mark.parametrize(
    ("stage", "has", "lacks"),
    [
        (
            1,
            {"sysid_evo.plan.processes"},
            {*HEAVY - {"scipy", "numpy"}, "scipy.stats", "scipy.signal", "rich.progress", "typer"},
        ),
        (2, {"tests.system.rig.__main__"}, {"sklearn", "pandas", "scipy.stats", "numba", "torch", "matplotlib"}),
        (3, {"model_zoo.linear", "sysid_evo.engine.rollout"}, COSTLY),
        (4, {*CORE, "model_zoo"}, COMPILER),
    ],
    ids=["a process that waits for cells", "the emulated car", "a comparison of simple models", "what can be compiled"],
)
def test_what_starts_often_and_what_needs_no_heavy_library_has_imported_little(stage, has, lacks, stages):
    imported = set(stages[stage])
    assert has <= imported
    assert not lacks & imported


def test_making_a_robot_or_tracker_opens_nothing_and_without_its_packages_it_says_what_to_install(tmp_path):
    done = subprocess.run([sys.executable, "-c", SILENT], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    advice = 'which is not installed. Install it with: pip install "sysid-evo[hardware]"'
    assert done.stdout.splitlines() == 2 * [f"robot 'serial' needs the package 'cobs', {advice}"]
