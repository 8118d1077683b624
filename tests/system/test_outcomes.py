"""How commands end, what they print then, and what a run folder is good for afterwards."""

import json
import os
import re
import shutil
import tempfile
from contextlib import contextmanager
from pathlib import Path

import pytest

from evaluation import compare
from sysid_evo.plan import Store, stored
from sysid_evo.testing import example_dataset
from tests.fixtures.commands import SMALL, Caller

pytestmark = pytest.mark.usefixtures("blank_figures")
AGAIN = ("compare", "--config", "out", "--out", "out")
BOTH = "linear,near=nearest_neighbour"
PREDICTION = ("--stop-after", "prediction")
REASON = 'ArithmeticError: deep inside (mine.py, line 14: raise ArithmeticError("deep inside"))'
"""What is said of a family that fails: error, file and line of its own code."""


def report_in(folder):
    """Return the report of a run but for its timings."""
    found = json.loads((folder / "report.json").read_text())
    del found["timings"]
    return found


def cells_of(ended):
    """Return which cells a dry run finds done, by their titles."""
    assert ended.code == 0, ended.stderr
    return {cell["cell"]: cell["kept"] for cell in json.loads(ended.stdout)["cells"]}


def test_a_stored_experiment_run_again_elsewhere_gives_the_same_report_and_prints_it_as_json(call, run_copy):
    ended = call.works("compare", "--config", "out", "--out", "other", "--json")
    other = call.folder / "other"
    assert json.loads(ended.stdout) == json.loads((other / "report.json").read_text())
    assert report_in(other) == report_in(run_copy)
    assert (other / "experiment.toml").read_text() == (run_copy / "experiment.toml").read_text()
    by_file = call("compare", "--config", "out/experiment.toml", "--out", "other", "--dry-run", "--json")
    assert all(cells_of(by_file).values())


def test_options_on_the_line_win_over_the_experiment(call, run_copy):
    def kept(*options):
        return cells_of(call(*AGAIN, "--dry-run", "--json", *options))

    assert all(kept().values())
    assert not any(done for cell, done in kept("--seed", "5").items() if cell.startswith(("fit", "evolve")))
    longer = kept("--generations", "2")
    assert longer["fit linear"]
    assert not longer["evolve linear"]
    assert not kept("--models", "linear,near=linear(ridge=0.5)")["fit near"]


def test_another_preset_on_the_line_brings_its_own_budget(call, stored_data):
    budget = 'preset = "quick"\ngenerations = 900\ntrials = 5\nrepeats = 1\n'
    (call.folder / "quick.toml").write_text(f'data = ["{stored_data}"]\nmodels = ["linear"]\n{budget}')

    def seconds(*options):
        ended = call.works("compare", "--config", "quick.toml", "--dry-run", "--json", *options)
        (evolve,) = [cell["seconds"] for cell in json.loads(ended.stdout)["cells"] if cell["cell"] == "evolve linear"]
        return float(evolve)

    assert seconds("--preset", "standard") == pytest.approx(1200 / 900 * seconds(), rel=0.05)
    assert seconds("--preset", "standard", "--repeats", "3") == pytest.approx(4.0 * seconds(), rel=0.05)


def test_a_dry_run_prints_cells_and_seconds_and_writes_nothing(call, run_copy, stored_data):
    before = sorted(call.folder.rglob("*"))
    lines = call.works(*AGAIN, "--models", f"{BOTH},k_neighbours", "--dry-run").stdout.splitlines()
    assert any("fit linear" in line and line.rstrip().endswith("kept") for line in lines)
    assert any("fit k_neighbours" in line and line.rstrip().endswith("s") for line in lines)
    assert re.fullmatch(r"\d+ steps, \d+ kept, about .* s", lines[-1].strip())
    assert any(
        re.fullmatch(r"run linear, \d+ steps +\S+( s)?", line.strip()) for line in lines
    )  # one line for all models
    new = call("compare", "--data", stored_data, "--models", "linear", "--out", "new", "--dry-run", "--json")
    assert json.loads(new.stdout)["seconds"] > 0
    assert not any(cells_of(new).values())
    evolve = call(
        "evolve", "--run", "out", "--against", "linear", *SMALL, "--procedure", "plain", "--dry-run", "--json"
    )
    first, second, *others = cells_of(evolve)
    assert (first, second) == ("fit linear", "evolve linear")
    assert {"run linear on linear", "run linear on near"} <= set(others)
    assert sorted(call.folder.rglob("*")) == before


def test_a_report_is_made_again_of_what_the_run_holds(call, run_copy, stored_data):
    experiment = run_copy / "experiment.toml"  # where the recordings were does not matter
    experiment.write_text(experiment.read_text().replace(str(stored_data), str(call.folder / "nowhere")))
    before = report_in(run_copy)
    for name in ("report.json", "report.html"):
        (run_copy / name).unlink()
    cells = {file: file.read_bytes() for file in (run_copy / "cells").glob("*.json")}
    assert "report.html" in call.works("report", "out").stdout
    after = report_in(run_copy)
    assert after["run"]["settings"].pop("data") == [str(call.folder / "nowhere")]
    assert before["run"]["settings"].pop("data") == [str(stored_data)]
    assert after == before
    assert {file: file.read_bytes() for file in (run_copy / "cells").glob("*.json")} == cells
    assert call.told("report", "out", "--json")["title"] == before["title"]
    assert call("report", "out", "--format", "word").code == 2
    (data,) = [record for record in Store(run_copy).records() if record.kind == "data"]
    for name in data.files:
        (run_copy / name).unlink()
    assert call.refused("report", "out").says("the data of this run are missing or damaged")


def test_quiet_leaves_remarks_out_and_keeps_results_and_errors(call, run_copy):
    loud, quiet = call(*AGAIN), call(*AGAIN, "--quiet")
    assert "kept" in loud.stderr
    assert quiet.stderr == ""
    assert quiet.stdout == loud.stdout
    assert call("--quiet", "compare", "--models", "linaer").says("no model is called 'linaer'")


def test_a_report_of_80_columns_says_where_its_page_is(finished_run):
    lines = (finished_run.parent / "stdout").read_text().splitlines()
    assert "Which models predict?" in lines
    assert lines[-1] == "Report: out/report.html"
    assert max(len(line) for line in lines if not line.startswith("Use the chosen")) <= 80
    assert "done" in (finished_run.parent / "stderr").read_text()
    assert json.loads((finished_run / "report.json").read_text())["timings"]


def test_runs_are_listed_shown_and_compared(call, run_copy, stored_data):
    ended = call.works("compare", "--data", stored_data, "--test", "episode-2", "--models", "linear,k_neighbours",
                 *PREDICTION, "--out", "second")  # fmt: skip
    rows = {row["run"]: row for row in call.told("runs", "list", ".", "--json")}
    assert rows.keys() == {"out", "second"}
    out = rows["out"]
    assert (out["failed"], out["models"], out["report"]) == (0, ["linear", "near"], True)
    assert "linear" in call("runs", "list", ".").stdout
    assert call("runs", "list", "out/cells").says("no runs in out/cells")
    shown = call.told("runs", "show", "out", "--json")
    assert [record["title"] for record in shown][:2] == ["prepare made-up car", "fit linear"]
    assert "fit linear" in call("runs", "show", "out").stdout
    difference = call.told("runs", "diff", "out", "second", "--json")
    assert {"models", "stop_after", "generations"} <= set(difference["settings"])
    assert not {"seed", "test", "preset"} & set(difference["settings"])
    news = {"fit k_neighbours", "predict with k_neighbours", "advise on the models"}
    assert set(difference["only_second"]) == news
    assert "evolve linear" in difference["only_first"]
    assert "fit linear" not in difference["only_first"]
    in_both, in_second = (difference["figures"][f"N at 1 s, {name}"] for name in ("linear", "k_neighbours"))
    assert in_both[0] == in_both[1] > 0.0
    assert in_second[0] is None
    assert in_second[1] > 0.0
    controller = report_in(run_copy)["controllers"]["controllers"][0]
    assert difference["figures"]["linear: claimed"] == [controller["claimed"]["value"], None]
    ended = call("runs", "diff", "out", "second")
    (line,) = [line for line in ended.stdout.splitlines() if line.startswith("N at 1 s, k_neighbours")]
    assert line.split()[-2:] == ["-", f"{in_second[1]:.4g}"]
    (line,) = [line for line in ended.stdout.splitlines() if line.startswith("steps of this")]
    assert line.split()[-2:] == [str(len(difference["only_first"])), "3"]
    assert "no difference" in call("runs", "diff", "out", "out").stdout
    (call.folder / "second" / "report.json").unlink()
    ended = call("runs", "diff", "out", "second")
    assert ended.says("second has no report yet, so it has no results to compare")
    assert "linear: claimed" in ended.stdout


@contextmanager
def unprivileged(folder):
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


def test_the_report_of_a_run_that_cannot_be_written_is_printed(finished_run, capsys):
    with tempfile.TemporaryDirectory() as name:  # the folders of pytest are closed to others
        call = Caller(Path(name), capsys)
        call.folder.chmod(0o755)
        out = Path(shutil.copytree(finished_run, call.folder / "out"))
        written = call("report", "out")
        before = {path: path.stat().st_mtime_ns for path in out.rglob("*")}
        with unprivileged(out):
            printed = call("report", "out")
        assert printed.code == 0, printed.stderr
        assert printed.says("out cannot be written, so the report is only printed: Permission denied")
        assert printed.stdout + "Report: out/report.html\n" == written.stdout
        assert before == {path: path.stat().st_mtime_ns for path in out.rglob("*")}


def test_another_experiment_in_a_folder_is_reported_and_shared_results_are_kept(call, run_copy):
    ended = call.works(*AGAIN, "--models", "near=linear(ridge=0.5),mine=linear", *PREDICTION)
    assert ended.says("out/experiment.toml had other settings: ")
    assert ended.says("models linear,near=nearest_neighbour, now near=linear,mine=linear")
    assert ended.says("Results that both need are kept")
    records = {record.title: record for record in Store(run_copy).records()}
    assert "fit near" in records
    assert "fit mine" not in records  # it is "fit linear"
    assert "mine" in json.dumps(report_in(run_copy))


def test_clean_removes_what_no_finished_cell_needs_and_nothing_else(call, run_copy):
    def files():
        return {file.relative_to(run_copy) for file in run_copy.rglob("*") if ".locks" not in file.parts}

    whole = files()
    (run_copy / "models" / "orphan-0.safetensors").write_bytes(b"x")
    (run_copy / "cells" / "broken.json").write_text("{")
    (run_copy / "results" / ".left.json.17.tmp").write_text("half")
    (run_copy / "mine.txt").write_text("not the run's")
    assert "3 files would be removed" in call("runs", "clean", "out", "--dry-run").stdout
    assert (run_copy / "cells" / "broken.json").exists()
    store = Store(run_copy)
    with store.claim(stored(store.records()[0])) as ours:
        assert ours
        refused = call("runs", "clean", "out")
    assert refused.code == 2
    assert refused.says("a process is computing in this run")
    assert "3 files removed" in call("runs", "clean", "out").stdout
    assert files() == whole | {Path("mine.txt")}
    assert all(cells_of(call(*AGAIN, "--dry-run", "--json")).values())


def test_a_comparison_of_a_data_set_given_in_python_is_reported_in_other_forms_and_its_settings_ask_for_data(call):
    compare(example_dataset(), models=["linear"], stop_after="prediction", out=call.folder / "given")
    assert "report.md" in call.works("report", "given", "--format", "markdown").stderr
    assert (call.folder / "given" / "report.md").read_text().startswith("# ")
    assert list((call.folder / "given" / "figures").glob("*.svg"))
    refused = call.refused("compare", "--config", "given", "--out", "elsewhere")
    assert refused.says("was run on a data set given in Python: name its recordings with --data")


def test_a_family_that_fails_is_exit_code_3_with_a_report_its_reason_and_a_traceback_in_the_log(failed_run):
    said = " ".join((failed_run.parent / "stderr").read_text().split())
    assert f"fit never_fits: {REASON}" in said
    assert said.endswith("failed: 6 steps; see out/log.jsonl")
    assert "absent is a physical robot: its column is filled by sysid-evo drive --controller" in said
    printed = " ".join((failed_run.parent / "stdout").read_text().split())
    assert "What failed? 6 of 39 steps failed." in printed
    report = report_in(failed_run)
    rows = ("linear", "near", "linear+near", "polished", "pursuit")
    assert [one["step"] for one in report["run"]["failures"]] == [
        "fit never_fits",
        *(f"{row} on never_fits" for row in rows),
    ]
    assert report["transfer"]["robot"] is None
    assert (failed_run / "report.html").is_file()
    log = [json.loads(line) for line in (failed_run / "log.jsonl").read_text().splitlines()]
    failed = {line["title"]: line for line in log if line["status"] == "failed"}
    assert 'raise ArithmeticError("deep inside")' in failed["fit never_fits"]["traceback"]


def test_nothing_that_could_be_fitted_is_exit_code_3_too_and_a_quiet_command_says_why(call, failed_run, stored_data):
    given = ("--plugin", failed_run.parent / "mine.py", "--out", "none")
    done = call("compare", "--data", stored_data, *given, "--models", "never_fits", *PREDICTION)
    assert done.code == 3, done.stderr
    assert done.says("no model could be fitted")
    command = ("fit", stored_data, *given, "--models", "linear,never_fits", "--json")
    fitted = call(*command)
    assert fitted.code == 3, fitted.stderr
    rows = {row["model"]: row for row in json.loads(fitted.stdout)}
    assert (call.folder / rows["linear"]["file"]).is_file()
    assert rows["linear"]["advice"]["model"] == "linear"
    assert rows["never_fits"]["advice"] is None
    assert rows["never_fits"]["reason"] == REASON
    assert " ".join(fitted.stderr.split()).endswith("failed: 1 step; see none/log.jsonl")
    quiet = call(*command, "--quiet")
    assert quiet.code == 3
    left = "1 step was left out, because other steps failed"
    assert " ".join(quiet.stderr.split()) == f"failed fit never_fits: {REASON} {left}"


def test_an_absent_robot_is_exit_code_4_and_debug_shows_the_traceback(call, failed_run):
    plugin = ("--plugin", failed_run.parent / "mine.py")
    done = call("compare", "--robot", "absent", *plugin, "--models", "linear", *PREDICTION, "--out", "gone", "--debug")
    assert done.code == 4, done.stderr
    assert "nothing on the port" in done.stderr
    assert "Traceback" in done.stderr
    assert "in record" in (call.folder / "gone" / "log.jsonl").read_text()


def test_evolve_tells_its_claim_as_json_and_knows_a_model_by_name_and_by_file(call, run_copy):
    (file,) = (run_copy / "models").glob("linear-*.json")
    command = ("evolve", "--run", "out", *SMALL, "--preset", "quick", "--json", "--against")
    told = call.told(*command, "linear")
    assert told["controller"] == "linear"
    assert (call.folder / told["file"]).is_file()
    assert told["claims"]["linear"]["trials"] == 100
    assert told["unit"] == "waypoints"
    cells = report_in(run_copy)["transfer"]["cells"]
    (claimed,) = [cell for cell in cells if (cell["controller"], cell["column"]) == ("linear", "linear")]
    assert told["claims"]["linear"]["mean"] == pytest.approx(claimed["mean"])  # the same cells, found again
    assert all(cells_of(call(*command, file, "--dry-run")).values())
    assert call.refused(*command, "parametrised").says("'parametrised' is not among the models of out: linear")
