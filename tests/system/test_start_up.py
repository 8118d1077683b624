"""The command line answers fast because it imports what is heavy only when it is needed."""

import importlib.util
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from evaluation.experiment import Experiment
from sysid_evo.cli.app import COMMANDS, load, summary
from sysid_evo.registry import models
from sysid_evo.registry.plugins import declared
from tests.fixtures.commands import COMMAND

HEAVY = {"torch", "sklearn", "scipy", "matplotlib", "numba", "pandas", "pyarrow", "pysindy"}
MOST_MODULES = 450
"""Modules that help may import, so that it is there in half a second; the time on a busy machine says nothing."""

WATCHED = """
import atexit, json, os, sys

def told():
    with open(os.environ["TOLD"], "w") as file:
        json.dump([sorted(sys.modules), os.environ["OMP_NUM_THREADS"]], file)

atexit.register(told)
"""
ASK_FOR_HELP = """
import json, sys
from sysid_evo.cli.app import COMMANDS, main

def ask(*arguments):
    sys.argv = ["sysid-evo", *arguments, "--help"]
    try:
        main()
    except SystemExit as end:
        return [end.code, sorted({name.partition(".")[0] for name in sys.modules})]

print(json.dumps({"": ask(), **{command: ask(command) for command in sorted(COMMANDS)}}))
"""
ASK_FOR_NAMES = """
import json, sys
import sysid_evo
early = sorted({name.partition(".")[0] for name in sys.modules})
for name in sysid_evo.__all__:
    getattr(sysid_evo, name)
print(json.dumps([early, sysid_evo.__all__]))
"""
COMPUTE = """
import json, sys
from evaluation.experiment import Experiment
from evaluation.planning import plan_comparison
from sysid_evo.data import Dataset
from sysid_evo.plan import Store, execute, processes as working
settings = dict(models=("linear", "nearest_neighbour"), ensembles=(), generations=1, trials=1, selection_trials=1,
                transfer_trials=1, held_back=0.3, task="point_to_point(horizon=20)",
                strategy="mu_plus_lambda(children=4)", recipe="plain")
comparison = plan_comparison(Experiment.of(settings), dataset=Dataset.load(sys.argv[2]))
ended = execute(comparison.plan, Store(sys.argv[1]))
assert not any(outcome.failed for outcome in ended.values())
print(json.dumps(sorted(sys.modules)))
"""


def answer(source, *arguments):
    """Return all that a fresh interpreter prints, and its last line."""
    command = [sys.executable, "-c", source, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return done.stdout, json.loads(done.stdout.splitlines()[-1])


def watched(folder, *arguments, threads=None):
    """Run ``sysid-evo`` in an empty folder; return how it ended, what it imported, and the threads of libraries."""
    environment = {**os.environ, "COLUMNS": "80", "TERM": "dumb", "TOLD": str(folder / "told.json")}
    environment.pop("OMP_NUM_THREADS", None)
    if threads is not None:
        environment["OMP_NUM_THREADS"] = threads
    (folder / "empty").mkdir()
    command = [sys.executable, "-c", WATCHED + COMMAND[-1], *arguments]
    done = subprocess.run(
        command, cwd=folder / "empty", env=environment, capture_output=True, text=True, timeout=240, check=False
    )
    return done, *json.loads((folder / "told.json").read_text())


def test_help_imports_nothing_heavy():
    printed, asked = answer(ASK_FOR_HELP)
    assert {"", "compare", "evolve", "fit", "models"} <= set(asked)
    assert printed.count("Usage: sysid-evo") == len(asked)
    for command, (code, imported) in asked.items():
        assert code == 0, command
        assert not HEAVY & set(imported), command
        assert "typer" in imported


@pytest.mark.parametrize("name", COMMANDS)
def test_the_short_help_of_a_command_is_the_first_paragraph_of_its_own(name):
    first, *_ = load(name).help.split("\n\n")
    assert summary(name, COMMANDS) == " ".join(first.split())


def test_families_are_listed_as_they_are_without_importing_one(tmp_path):
    done, imported, threads = watched(tmp_path, "models", "list", "--json", threads="4")
    assert not (HEAVY | {"numpy"}) & set(imported)
    assert threads == "4"
    rows = {row["name"]: row for row in json.loads(done.stdout)}
    assert set(rows) == set(models.names())
    for name, family in models.load_all():
        missing = [module for module in family.requires if importlib.util.find_spec(module) is None]
        assert rows[name]["knowledge"] == family.knowledge, f"{name}: state its knowledge in the class itself"
        assert (rows[name]["lacking"] is None) == (not missing), f"{name}: state requires in the class itself"
        assert rows[name]["summary"] == (family.__doc__ or "").partition("\n")[0].replace("`", "")


@pytest.mark.parametrize("name", sorted(models.names()))
def test_what_a_family_requires_stands_in_its_own_class(name):
    assert tuple(declared(models.module(name), name).get("requires") or ()) == models.get(name).requires


def test_the_default_preset_is_one_and_stands_in_the_help_of_every_command_that_has_one():
    named = Experiment.model_fields["preset"].default
    presets = {name: option for name in COMMANDS for option in load(name).params if option.name == "preset"}
    assert set(presets) == {"compare", "fit", "evolve", "exploit"}
    for option in presets.values():
        assert option.default is None
        assert f"{named} (default)" in option.help
    assert f"`compare` with the default preset, `{named}`" in (Path(__file__).parents[2] / "README.md").read_text()


def test_the_module_is_the_same_program_and_imports_few_modules_for_its_help(call):
    command = [sys.executable, "-X", "importtime", "-m", "sysid_evo", "--help"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stderr.count("import time:") < MOST_MODULES
    assert "Usage: python -m sysid_evo" in done.stdout
    assert all(name in done.stdout for name in COMMANDS)
    assert call("--version").stdout.startswith("sysid-evo ")


def test_a_mistake_is_told_on_standard_error_alone_without_what_only_the_work_needs(tmp_path):
    done, imported, threads = watched(tmp_path, "compare", "--models", "linaer")
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    assert not done.stdout
    assert not list((tmp_path / "empty").iterdir())
    assert not {"matplotlib", "numba", "torch", "control", "pysindy"} & set(imported)
    assert threads == "1"  # libraries work on one thread unless they are told otherwise


def test_the_package_is_imported_lazily_and_every_public_name_is_there():
    _, (early, names) = answer(ASK_FOR_NAMES)
    assert not (HEAVY | {"numpy"}) & set(early)
    assert {"Dataset", "System", "evolve_controller", "make_model", "rollout"} <= set(names)


@pytest.mark.parametrize(
    ("module", "lacks"),
    [
        ("tests.system.rig.__main__", {"sklearn", "pandas", "scipy.stats", "numba", "torch", "matplotlib"}),
        (
            "sysid_evo.plan.processes",
            {*HEAVY - {"scipy"}, "scipy.stats", "scipy.signal", "rich.progress", "typer"},
        ),
    ],
    ids=["the emulated car", "a process that waits for cells"],
)
def test_what_starts_often_has_imported_little(module, lacks):
    _, imported = answer(f"import json, sys, {module}\nprint(json.dumps(sorted(sys.modules)))")
    assert module in imported
    assert not lacks & set(imported)


def test_models_that_need_no_heavy_library_are_fitted_driven_and_judged_without_any(tmp_path, stored_data):
    _, imported = answer(COMPUTE, tmp_path / "run", stored_data)
    assert {"model_zoo.linear", "sysid_evo.engine.rollout"} <= set(imported)
    heavy = {"torch", "sklearn", "matplotlib", "scipy.stats", "scipy.signal", "scipy.optimize", "pysindy", "typer"}
    assert not heavy & set(imported)
