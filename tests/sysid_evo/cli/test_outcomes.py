"""How commands end, what they print then, and what a run folder is good for afterwards."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from evaluation import compare
from evaluation.cells.data import GivenData
from sysid_evo.plan import Store, StoredCell
from sysid_evo.testing import example_dataset
from tests.fixtures.commands import Caller, Ended, run, run_here

BUDGET = ("--generations", "1", "--trials", "1", "--runs", "1", "--strategy", "mu_plus_lambda(parents=2, children=2)")
SMALL = ("--only", "prediction")
WHOLE = (*BUDGET, "--task", "point_to_point(horizon=40)")
NEAR = "nearest_neighbour"

PLUGIN = '''
"""A family that never fits, and a robot that is not there."""
from hardware.robot import Robot
from sysid_evo import DynamicsModel, register_model, register_robot
from sysid_evo.errors import LinkLost
from sysid_evo.registry import make_robot


@register_model("never_fits")
class NeverFits(DynamicsModel):
    """Cannot be fitted to anything."""

    def fit(self, dataset, *, rng, progress=None):
        raise ArithmeticError("deep inside")

    def next_state(self, carry, control):
        return carry


@register_robot("absent")
class Absent(Robot):
    """A car that is not there."""

    name, dynamics = "absent", None

    def __init__(self):
        self.system = make_robot("emulated_car").system

    def connect(self, *, seed=None):
        raise LinkLost("nothing on the port")
'''

REASON = 'ArithmeticError: deep inside (mine.py, line 14: raise ArithmeticError("deep inside"))'
"""What is said of a family that fails: error, file and line of its own code."""


def report_in(folder: Path) -> dict[str, object]:
    """Return the report of a run but for what may differ: timings, and where the plugin stands."""
    found: dict[str, object] = json.loads((folder / "report.json").read_text())
    del found["timings"]
    return found


@pytest.fixture(scope="module")
def compared(tmp_path_factory: pytest.TempPathFactory, logs: Path) -> Path:
    """A folder with a finished comparison in ``out``."""
    folder = tmp_path_factory.mktemp("compared")
    done = run("compare", "--data", logs, "--models", "linear", *WHOLE, "--out", "out", "--json", cwd=folder)
    assert done.returncode == 0, done.stderr
    (folder / "stdout").write_text(done.stdout)
    return folder


@pytest.fixture
def there(compared: Path, capsys: pytest.CaptureFixture[str]) -> Caller:
    """Calls the command line in the folder of the finished comparison."""
    return Caller(compared, capsys)


def test_json_of_a_comparison_is_its_report_and_nothing_else(compared: Path) -> None:
    assert json.loads((compared / "stdout").read_text()) == json.loads((compared / "out" / "report.json").read_text())


def test_a_stored_experiment_run_again_elsewhere_gives_the_same_report(compared: Path, there: Caller) -> None:
    ended = there("compare", "--config", "out", "--out", "other")
    assert ended.code == 0, ended.stderr
    assert report_in(compared / "other") == report_in(compared / "out")
    assert (compared / "other" / "experiment.toml").read_text() == (compared / "out" / "experiment.toml").read_text()
    by_file = there("compare", "--config", "out/experiment.toml", "--out", "other", "--dry-run", "--json")
    assert all(cell["kept"] for cell in json.loads(by_file.stdout)["cells"])


def test_options_on_the_line_win_over_the_experiment(there: Caller) -> None:
    def kept(*options: str) -> dict[str, bool]:
        ended = there("compare", "--config", "out", "--out", "out", "--dry-run", "--json", *options)
        assert ended.code == 0, ended.stderr
        return {cell["cell"]: cell["kept"] for cell in json.loads(ended.stdout)["cells"]}

    assert all(kept().values())
    assert not any(done for cell, done in kept("--seed", "5").items() if cell.startswith(("fit", "evolve")))
    assert kept("--generations", "2")["fit linear"]
    assert not kept("--generations", "2")["evolve linear"]
    assert "fit nearest_neighbour" in kept("--models", "nearest_neighbour")


def test_a_schedule_on_the_line_is_that_of_the_experiment(there: Caller) -> None:
    stages = "stage(task=point_to_point(waypoint_radius=0.5), at_most=2)"
    ended = there("compare", "--config", "out", "--out", "out", "--schedule", stages, "--dry-run", "--json")
    evolve = [cell for cell in json.loads(ended.stdout)["cells"] if cell["cell"].startswith("evolve")]
    assert evolve
    assert not any(cell["kept"] for cell in evolve)  # other work than that without a schedule
    wrong = there("compare", "--config", "out", "--out", "out", "--schedule", "stage(at_most=0)", "--dry-run")
    assert wrong.code == 2
    assert wrong.says("expected over and at_most >= 1")


def test_a_dry_run_prints_cells_and_seconds_and_writes_nothing(there: Caller, logs: Path) -> None:
    before = sorted(there.folder.rglob("*"))
    ended = there(
        "compare", "--data", logs, "--models", "linear,nearest_neighbour", *WHOLE, "--out", "out", "--dry-run"
    )
    assert ended.code == 0, ended.stderr
    lines = ended.stdout.splitlines()
    assert any("fit linear" in line and line.rstrip().endswith("kept") for line in lines)
    assert any("fit nearest_neighbour" in line and line.rstrip().endswith("s") for line in lines)
    assert "cells," in lines[-1]
    new = there("compare", "--data", logs, "--models", "linear", "--out", "new", "--dry-run", "--json")
    plan = json.loads(new.stdout)
    assert plan["seconds"] > 0
    assert not any(cell["kept"] for cell in plan["cells"])
    evolve = there("evolve", "--run", "out", "--against", "linear", *WHOLE, "--dry-run", "--json")
    assert [cell["cell"] for cell in json.loads(evolve.stdout)["cells"]] == [
        "fit linear", "evolve linear", "run linear on linear",
    ]  # fmt: skip
    assert sorted(there.folder.rglob("*")) == before


def test_a_report_is_made_again_of_what_the_run_holds(compared: Path, there: Caller) -> None:
    before = report_in(compared / "out")
    for name in ("report.json", "report.html"):
        (compared / "out" / name).unlink()
    cells = {file: file.read_bytes() for file in (compared / "out" / "cells").glob("*.json")}
    ended = there("report", "out")
    assert ended.code == 0, ended.stderr
    assert "report.html" in ended.stdout
    assert report_in(compared / "out") == before
    assert {file: file.read_bytes() for file in (compared / "out" / "cells").glob("*.json")} == cells
    assert json.loads(there("report", "out", "--json").stdout)["title"] == before["title"]


def test_a_report_is_written_in_other_forms_beside_the_page(compared: Path, there: Caller) -> None:
    ended = there("report", "out", "--format", "markdown")
    assert ended.code == 0, ended.stderr
    assert "report.md" in ended.stderr
    run = compared / "out"
    assert (run / "report.md").read_text().startswith("# ")
    assert list((run / "figures").glob("*.svg"))
    assert there("report", "out", "--format", "word").code == 2


def test_quiet_leaves_remarks_out_and_keeps_results_and_errors(there: Caller) -> None:
    loud, quiet = there("compare", "--config", "out", "--out", "out"), None
    quiet = there("compare", "--config", "out", "--out", "out", "--quiet")
    assert "kept" in loud.stderr
    assert quiet.stderr == ""
    assert quiet.stdout == loud.stdout
    wrong = there("--quiet", "compare", "--models", "linaer")
    assert wrong.says("no model is called 'linaer'")


def test_version_and_module_are_the_same_program(tmp_path: Path, there: Caller) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "sysid_evo", "--version"], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert done.stdout == there("--version").stdout
    assert done.stdout.startswith("sysid-evo ")


def test_runs_are_listed_shown_and_compared(there: Caller, logs: Path) -> None:
    rows = json.loads(there("runs", "list", ".", "--json").stdout)
    assert {"out"} <= {row["run"] for row in rows}
    (out,) = [row for row in rows if row["run"] == "out"]
    assert (out["failed"], out["models"], out["report"]) == (0, ["linear"], True)
    assert "linear" in there("runs", "list", ".").stdout
    assert there("runs", "list", "out/cells").says("no runs in out/cells")
    shown = json.loads(there("runs", "show", "out", "--json").stdout)
    assert [record["title"] for record in shown][:2] == ["prepare made-up car", "fit linear"]
    assert "fit linear" in there("runs", "show", "out").stdout
    ended = there("compare", "--data", logs, "--models", f"linear,{NEAR}", *SMALL, "--out", "second")
    assert ended.code == 0, ended.stderr
    difference = json.loads(there("runs", "diff", "out", "second", "--json").stdout)
    assert {"models", "only", "generations"} <= set(difference["settings"])
    assert not {"seed", "test", "preset"} & set(difference["settings"])
    assert set(difference["only_second"]) == {
        f"fit {NEAR}",
        f"predict with {NEAR}",
        "advise on the models",
    }
    assert "evolve linear" in difference["only_first"]
    assert "fit linear" not in difference["only_first"]
    in_both, in_second = (difference["figures"][f"N at 1 s, {name}"] for name in ("linear", NEAR))
    assert in_both[0] == in_both[1] > 0.0
    assert in_second[0] is None
    assert in_second[1] > 0.0
    (controller,) = json.loads((there.folder / "out" / "report.json").read_text())["controllers"]["controllers"]
    assert difference["figures"]["linear: claimed"] == [controller["claimed"]["value"], None]
    ended = there("runs", "diff", "out", "second")
    (line,) = [line for line in ended.stdout.splitlines() if line.startswith(f"N at 1 s, {NEAR}")]
    assert line.split()[-2:] == ["-", f"{in_second[1]:.4g}"]
    (line,) = [line for line in ended.stdout.splitlines() if line.startswith("cells only")]
    assert line.split()[-2:] == [str(len(difference["only_first"])), "3"]
    assert "no difference" in there("runs", "diff", "out", "out").stdout


@contextmanager
def unprivileged(folder: Path) -> Iterator[None]:
    """Take the right to write in a folder; from root, who may write anywhere, by being somebody else meanwhile."""
    places = [folder, *folder.rglob("*")]
    for place in places:
        place.chmod(0o555 if place.is_dir() else 0o444)
    user = os.geteuid()
    try:
        if user == 0:
            os.seteuid(65534)
        yield
    finally:
        os.seteuid(user)
        for place in places:
            place.chmod(0o755 if place.is_dir() else 0o644)


def test_the_report_of_a_run_that_cannot_be_written_is_printed(
    compared: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        folder.chmod(0o755)
        shutil.copytree(compared / "out", folder / "out")
        call = Caller(folder, capsys)
        written = call("report", "out")
        before = {path: path.stat().st_mtime_ns for path in (folder / "out").rglob("*")}
        with unprivileged(folder / "out"):
            printed = call("report", "out")
        assert printed.code == 0, printed.stderr
        assert printed.says("out cannot be written, so the report is printed only: Permission denied")
        assert printed.stdout + "Report: out/report.html\n" == written.stdout
        assert before == {path: path.stat().st_mtime_ns for path in (folder / "out").rglob("*")}


def test_a_run_without_a_report_is_compared_without_figures(compared: Path, there: Caller) -> None:
    shutil.copytree(compared / "out", compared / "stopped")
    (compared / "stopped" / "report.json").unlink()
    ended = there("runs", "diff", "out", "stopped")
    assert ended.says("stopped has no report yet, so it has no figures")
    assert "linear: claimed" in ended.stdout


def test_another_experiment_in_a_folder_is_remarked_and_what_both_need_is_kept(there: Caller, logs: Path) -> None:
    first = there("compare", "--data", logs, "--models", "linear", *SMALL, "--out", "third")
    assert first.code == 0, first.stderr
    second = there(
        "compare", "--data", logs, "--models", "near=linear(ridge=0.5),mine=linear", *SMALL, "--out", "third"
    )
    assert second.code == 0, second.stderr
    assert second.says("third/experiment.toml had other models; what both need is kept")
    records = {record.title: record for record in Store(there.folder / "third").records()}
    assert "fit near" in records
    assert "fit mine" not in records  # it is "fit linear"
    assert "mine" in json.dumps(report_in(there.folder / "third"))


def test_clean_removes_what_no_finished_cell_needs_and_nothing_else(there: Caller, logs: Path) -> None:
    done = there("compare", "--data", logs, "--models", "linear", *SMALL, "--out", "dirty")
    assert done.code == 0, done.stderr
    run_folder = there.folder / "dirty"
    whole = {file.relative_to(run_folder) for file in run_folder.rglob("*") if ".locks" not in file.parts}
    (run_folder / "models" / "orphan-0.safetensors").write_bytes(b"x")
    (run_folder / "cells" / "broken.json").write_text("{")
    (run_folder / "results" / ".left.json.17.tmp").write_text("half")
    (run_folder / "mine.txt").write_text("not the run's")
    listed = there("runs", "clean", "dirty", "--dry-run")
    assert "3 files would go" in listed.stdout
    assert (run_folder / "cells" / "broken.json").exists()
    assert "3 files removed" in there("runs", "clean", "dirty").stdout
    left = {file.relative_to(run_folder) for file in run_folder.rglob("*") if ".locks" not in file.parts}
    assert left == whole | {Path("mine.txt")}
    again = there("compare", "--config", "dirty", "--out", "dirty", "--dry-run", "--json")
    assert all(cell["kept"] for cell in json.loads(again.stdout)["cells"])


def test_clean_waits_for_a_process_that_computes_in_the_run(there: Caller) -> None:
    store = Store(there.folder / "out")
    cell = StoredCell(store.records()[0], GivenData)
    with store.claim(cell) as ours:
        assert ours
        refused = there("runs", "clean", "out")
    assert refused.code == 2
    assert refused.says("a process is computing in this run")
    assert there("runs", "clean", "out").code == 0


def test_a_report_is_made_of_the_run_alone(there: Caller, logs: Path, tmp_path: Path) -> None:
    moved = shutil.copytree(logs, tmp_path / "moved")
    done = there("compare", "--data", moved, "--models", "linear", *SMALL, "--out", "alone")
    assert done.code == 0, done.stderr
    shutil.rmtree(moved)
    before = report_in(there.folder / "alone")
    again = there("report", "alone")
    assert again.code == 0, again.stderr
    assert report_in(there.folder / "alone") == before
    (data,) = [record for record in Store(there.folder / "alone").records() if record.kind == "data"]
    for name in data.files:
        (there.folder / "alone" / name).unlink()
    lost = there("report", "alone")
    assert lost.code == 2
    assert lost.says("the data of this run are missing or damaged")


def test_a_comparison_of_a_data_set_given_in_python_is_reported_and_its_settings_ask_for_data(there: Caller) -> None:
    folder = there.folder / "given"
    compare(example_dataset(), models=["linear"], only="prediction", out=folder)
    assert there("report", "given").code == 0
    refused = there("compare", "--config", "given", "--out", "elsewhere")
    assert refused.code == 2
    assert refused.says("was run on a data set given in Python: name its recordings with --data")


@pytest.fixture(scope="module")
def half(tmp_path_factory: pytest.TempPathFactory, logs: Path) -> tuple[Path, Ended]:
    """A comparison of which one family fails, and how it ended."""
    folder = tmp_path_factory.mktemp("half")
    (folder / "mine.py").write_text(PLUGIN)
    done = run_here(
        "compare", "--data", logs, "--plugin", "mine.py", "--models", "linear,never_fits", *SMALL, "--out", "out",
        "--debug", cwd=folder,
    )  # fmt: skip
    return folder, Ended(done.returncode, done.stdout, done.stderr)


def test_a_family_that_fails_is_exit_code_3_with_a_report_and_its_reason(half: tuple[Path, Ended]) -> None:
    folder, ended = half
    assert ended.code == 3, ended.stderr
    assert ended.says(f"fit never_fits: {REASON}")
    assert ended.says("failed: 1 part; see out/log.jsonl")
    assert "What failed? 1 part; the reasons are listed below." in " ".join(ended.stdout.split())
    report = json.loads((folder / "out" / "report.json").read_text())
    assert [failure["what"] for failure in report["failures"]] == ["fit never_fits"]
    assert (folder / "out" / "report.html").is_file()


def test_what_fails_is_said_by_a_quiet_command_too(half: tuple[Path, Ended], logs: Path) -> None:
    command = ("fit", logs, "--plugin", "mine.py", "--models", "never_fits", "--out", "quiet", "--quiet")
    done = run_here(*command, cwd=half[0])
    assert done.returncode == 3
    assert " ".join(done.stderr.split()).startswith(f"failed fit never_fits: {REASON} failed")


def test_the_log_of_a_run_holds_the_traceback_of_every_failure(half: tuple[Path, Ended]) -> None:
    folder, _ = half
    log = [json.loads(line) for line in (folder / "out" / "log.jsonl").read_text().splitlines()]
    (failed,) = [line for line in log if line["status"] == "failed"]
    assert 'raise ArithmeticError("deep inside")' in failed["traceback"]


def test_nothing_that_could_be_fitted_is_exit_code_3_too(half: tuple[Path, Ended], logs: Path) -> None:
    folder, _ = half
    command = ("compare", "--data", logs, "--plugin", "mine.py", "--models", "never_fits", *SMALL, "--out", "none")
    done = run_here(*command, cwd=folder)
    assert done.returncode == 3, done.stderr
    assert "no model could be fitted" in " ".join(done.stderr.split())
    fitted = run_here(
        "fit", logs, "--plugin", "mine.py", "--models", "linear,never_fits", "--json", "--out", "f", cwd=folder
    )
    assert fitted.returncode == 3, fitted.stderr
    rows = {row["model"]: row for row in json.loads(fitted.stdout)}
    assert Path(folder, rows["linear"]["file"]).is_file()
    assert rows["linear"]["advice"]["model"] == "linear"
    assert rows["never_fits"]["advice"] is None
    assert rows["never_fits"]["reason"] == REASON
    assert " ".join(fitted.stderr.split()).endswith("failed: 1 part; see f/log.jsonl")


def test_a_robot_that_is_absent_is_exit_code_4_and_its_traceback_is_shown_when_asked_for(
    half: tuple[Path, Ended],
) -> None:
    folder, _ = half
    command = ("compare", "--robot", "absent", "--plugin", "mine.py", "--models", "linear", *SMALL, "--out", "gone")
    done = run_here(*command, "--debug", cwd=folder)
    assert done.returncode == 4, done.stderr
    assert "nothing on the port" in done.stderr
    assert "Traceback" in done.stderr
    assert "in record" in (folder / "gone" / "log.jsonl").read_text()


def test_without_debug_there_is_no_traceback(call: Caller) -> None:
    assert "Traceback" not in call("compare", "--models", "linaer").stderr
    assert "Traceback" in call("compare", "--models", "linaer", "--debug").stderr


def test_another_preset_on_the_line_brings_its_own_budget(call: Caller, logs: Path) -> None:
    settings = f'data = ["{logs}"]\nmodels = ["linear"]\npreset = "quick"\ngenerations = 900\ntrials = 5\nruns = 1\n'
    (call.folder / "quick.toml").write_text(settings)

    def seconds(*options: str) -> float:
        ended = call("compare", "--config", "quick.toml", "--dry-run", "--json", *options)
        assert ended.code == 0, ended.stderr
        (evolve,) = [cell["seconds"] for cell in json.loads(ended.stdout)["cells"] if cell["cell"] == "evolve linear"]
        return float(evolve)

    assert seconds("--preset", "standard") == pytest.approx(1200 / 900 * seconds(), rel=0.05)
    assert seconds("--preset", "standard", "--runs", "3") == pytest.approx(4.0 * seconds(), rel=0.05)


def test_evolve_tells_its_claim_as_json_and_knows_a_model_by_name_and_by_file(there: Caller) -> None:
    (file,) = (there.folder / "out" / "models").glob("linear-*.json")
    by_name = there("evolve", "--run", "out", "--against", "linear", *WHOLE, "--preset", "quick", "--json")
    assert by_name.code == 0, by_name.stderr
    told = json.loads(by_name.stdout)
    assert told["controller"] == "linear"
    assert (there.folder / told["file"]).is_file()
    assert told["claims"]["linear"]["trials"] == 100
    assert told["unit"] == "waypoints"
    report = json.loads((there.folder / "out" / "report.json").read_text())
    (claimed,) = [cell for cell in report["transfer"]["cells"] if cell["column"] == "linear"]
    assert told["claims"]["linear"]["mean"] == pytest.approx(claimed["mean"])  # the same cells, found again
    by_file = there("evolve", "--run", "out", "--against", file, *WHOLE, "--preset", "quick", "--dry-run", "--json")
    assert by_file.code == 0, by_file.stderr
    assert all(cell["kept"] for cell in json.loads(by_file.stdout)["cells"])
    stranger = there("evolve", "--run", "out", "--against", "parametrised", *WHOLE)
    assert stranger.code == 2
    assert stranger.says("'parametrised' is not among the models of out: linear")
