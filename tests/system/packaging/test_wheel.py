"""A wheel in an empty environment, outside the checkout, is the whole program."""

import email
import json
import os
import re
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest

pytestmark = pytest.mark.nightly

ROOT = Path(__file__).parents[3]
PYTHON = os.environ.get("PYTHON", sys.executable)
"""The interpreter that the wheel is tried with; another one is named as for make: ``PYTHON=python3.13``."""
PACKAGES = ("sysid_evo", "model_zoo", "evaluation", "hardware")
OPTIONAL = (
    *("torch", "torchdiffeq", "pysindy", "control", "cobs", "serial", "starlette", "uvicorn"),
    "distributed",
)
LEFT_OUT = {"sindy": "sindy"}
"""Families of a comparison with no options that cannot run without extras, and the extra of each."""
STUDY = """
[experiment]
models = ["linear"]
minutes = 0.5
generations = 2
trials = 2
polish_generations = 1
transfer_trials = 5
traces = 0
reference = false
task = "point_to_point(horizon=100)"

[grid]
robot = ["emulated_car", "emulated_car(seed=1)"]
seed = "0..1"
"""


class Environment:
    """A virtual environment of its own, and a folder outside the checkout that commands run in."""

    def __init__(self, folder):
        self.folder, self.work = folder / "venv", folder / "work"
        subprocess.run([PYTHON, "-m", "venv", self.folder], check=True)
        self.work.mkdir()

    def python(self, *arguments, cwd=None):
        """Run its interpreter in the working folder; nothing of this test's own environment is seen there."""
        hidden = ("PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV")
        return subprocess.run(
            [self.folder / "bin" / "python", *arguments],
            cwd=cwd or self.work,
            env={name: value for name, value in os.environ.items() if name not in hidden},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
        )

    def install(self, *requirements):
        """Install with pip from wherever it is configured to look."""
        done = self.python("-m", "pip", "install", "--quiet", "--disable-pip-version-check", *requirements)
        assert done.returncode == 0, done.stderr

    def build(self, source, out):
        """Build wheel and sdist of the tree ``source``; return them by those names."""
        done = self.python("-m", "hatchling", "build", "-d", out, cwd=source)
        assert done.returncode == 0, done.stderr
        return {"wheel": next(out.glob("*.whl")), "sdist": next(out.glob("*.tar.gz"))}


@pytest.fixture(scope="module")
def project():
    """What stands in pyproject.toml."""
    return tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def builder(tmp_path_factory, project):
    """An environment with what builds the distribution."""
    found = Environment(tmp_path_factory.mktemp("builder"))
    found.install(*project["build-system"]["requires"])
    return found


@pytest.fixture(scope="module")
def distribution(builder, tmp_path_factory):
    """Wheel and sdist of this tree, built as for a package index."""
    return builder.build(ROOT, tmp_path_factory.mktemp("distribution"))


@pytest.fixture(scope="module")
def bare(distribution, tmp_path_factory):
    """An environment that holds the wheel and what it cannot do without."""
    found = Environment(tmp_path_factory.mktemp("bare"))
    found.install("-c", ROOT / "constraints.txt", distribution["wheel"])
    return found


def of_the_tree(*folders):
    """Return the files of ``folders``, without what Python keeps beside them."""
    files = (file for folder in folders for file in (ROOT / folder).rglob("*") if file.is_file())
    return {file.relative_to(ROOT).as_posix() for file in files if "__pycache__" not in file.parts}


def in_wheel(wheel):
    with zipfile.ZipFile(wheel) as archive:
        return {name for name in archive.namelist() if ".dist-info/" not in name}


def metadata_of(wheel):
    with zipfile.ZipFile(wheel) as archive:
        name = next(name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
        return email.message_from_bytes(archive.read(name))


def test_the_wheel_holds_templates_pages_firmware_and_types(distribution):
    held = in_wheel(distribution["wheel"])
    assert held == of_the_tree(*PACKAGES)
    assert {f"{package}/py.typed" for package in PACKAGES} <= held
    assert {Path(name).suffix for name in held} >= {".txt", ".j2", ".html", ".css", ".js", ".c", ".h", ".toml", ".pyi"}


def test_the_source_distribution_builds_the_same_wheel(distribution, builder, tmp_path):
    with tarfile.open(distribution["sdist"]) as archive:
        archive.extractall(tmp_path, filter="data")
    source = next(path for path in tmp_path.iterdir() if path.is_dir())
    again = builder.build(source, tmp_path / "out")["wheel"]
    assert in_wheel(again) == in_wheel(distribution["wheel"])
    assert (source / "tests" / "conftest.py").is_file()
    assert (source / "docs" / "models.md").is_file()


def test_what_a_package_index_shows_is_complete(distribution, project):
    metadata = metadata_of(distribution["wheel"])
    assert {metadata[field] for field in ("Author", "Keywords", "Summary", "License-Expression")}.isdisjoint({None, ""})
    for version in ("3.11", "3.12", "3.13"):
        assert f"Programming Language :: Python :: {version}" in metadata.get_all("Classifier", [])
    text = str(metadata.get_payload())
    assert text.startswith("# sysid-evo")
    links = re.findall(r"\]\(([^)]+)\)", re.sub(r"```.*?```", "", text, flags=re.DOTALL))
    assert [link for link in links if not link.startswith("https://")] == []


def test_all_is_every_extra_but_those_of_developers(distribution, project):
    brought: dict[str, set[str]] = {}
    for line in metadata_of(distribution["wheel"]).get_all("Requires-Dist", []):
        extra = re.search(r"(.*);.*extra == '([\w-]+)'", line)
        if extra:
            brought.setdefault(extra[2], set()).add(extra[1].strip())
    assert set(brought) == {*project["project"]["optional-dependencies"]}
    jobs = set(brought) - {"all", "dev", "docs", "field"}
    assert brought["all"] == set().union(*(brought[job] for job in jobs))


def test_nothing_optional_is_installed_by_default(bare):
    asked = f"import importlib.util as u, json; print(json.dumps([n for n in {OPTIONAL} if u.find_spec(n)]))"
    assert json.loads(bare.python("-c", asked).stdout) == []
    where = bare.python("-c", "import sysid_evo; print(sysid_evo.__file__)").stdout
    assert Path(where.strip()).is_relative_to(bare.folder)


def test_compare_runs_without_extras_and_names_what_installs_the_rest(bare):
    done = bare.python("-m", "sysid_evo", "compare", "--generations", "2", "--minutes", "1", "--out", "run")
    assert done.returncode == 0, done.stderr
    told = " ".join(done.stderr.split())
    for family, extra in LEFT_OUT.items():
        assert re.search(rf'{family} is left out:[^"]* pip install "sysid-evo\[{extra}\]"', told), told
    report = json.loads((bare.work / "run" / "report.json").read_text(encoding="utf-8"))
    assert (bare.work / "run" / "report.html").is_file()
    families = {model["family"] for model in report["models"]}
    usual = {"backprop27", "evolved3", "mlp_ensemble", "narx", "nearest_neighbour", "parametrised"}
    assert families == {*usual, "gaussian_process"}
    assert report["run"]["failures"] == []


def test_a_study_runs_without_extras_and_its_tables_can_be_read(bare):
    (bare.work / "two.toml").write_text(STUDY, encoding="utf-8")
    done = bare.python("-m", "sysid_evo", "study", "two.toml", "--out", "study")
    assert done.returncode == 0, done.stderr
    held = {file.name for file in (bare.work / "study").iterdir()}
    assert {"study.html", "study.md", "study.toml"} <= held
    tables = [name for name in held if name.endswith(".parquet")]
    read = f"import pandas as pd; print(sum(len(pd.read_parquet('study/' + n)) for n in {sorted(tables)}))"
    assert int(bare.python("-c", read).stdout) > 0
    again = bare.python("-m", "sysid_evo", "study", "two.toml", "--out", "study", "--render", "--json")
    assert again.returncode == 0, again.stderr
    json.loads(again.stdout)


def test_a_plugin_that_is_installed_beside_the_wheel_is_found_by_its_entry_point(bare):
    written = bare.python("-m", "sysid_evo", "plugin", "new", "visitor")
    assert written.returncode == 0, written.stderr
    bare.install("--no-deps", bare.work / "visitor")
    listed = bare.python("-m", "sysid_evo", "models", "list")
    assert re.search(r"\bvisitor\b", listed.stdout), listed.stderr
    compared = bare.python(
        "-m",
        "sysid_evo",
        "compare",
        "--models",
        "visitor",
        "--stop-after",
        "prediction",
        "--minutes",
        "0.5",
        "--out",
        "seen",
    )
    assert compared.returncode == 0, compared.stderr
    report = json.loads((bare.work / "seen" / "report.json").read_text(encoding="utf-8"))
    assert [model["family"] for model in report["models"]] == ["visitor"]


def test_a_family_asked_for_by_name_is_refused_before_any_work(bare):
    done = bare.python("-m", "sysid_evo", "compare", "--models", "sindy", "--out", "with_sindy")
    assert done.returncode == 2, done.stderr
    assert 'pip install "sysid-evo[sindy]"' in " ".join(done.stderr.split())
    assert not (bare.work / "with_sindy").exists()


def test_commands_that_need_no_extra_work_and_the_others_say_which(bare):
    listed = bare.python("-m", "sysid_evo", "models", "list")
    assert listed.returncode == 0, listed.stderr
    assert "neural_ode" in listed.stdout
    written = bare.python("-m", "sysid_evo", "plugin", "new", "my_model")
    assert written.returncode == 0, written.stderr
    assert (bare.work / "my_model" / "pyproject.toml").is_file()
    driven = bare.python("-m", "sysid_evo", "drive")
    assert driven.returncode == 2
    assert 'pip install "sysid-evo[drive]"' in " ".join(driven.stderr.split())
