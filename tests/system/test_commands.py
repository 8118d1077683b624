"""Commands of recordings, models and studies: import, inspect, fit, models, adapt, study."""

import json
import re
from types import SimpleNamespace

import numpy as np
import pytest

from evaluation.study.planning import plan_study, seconds_about
from evaluation.study.study import Study
from sysid_evo.data import Dataset
from sysid_evo.models import load_model, save_model
from sysid_evo.models.base import make_model
from tests.fixtures.recordings import CAR_MAP
from tests.fixtures.systems import FloorCar, drive

pytestmark = pytest.mark.usefixtures("blank_figures")


def write_log(folder, name="log.csv", **changes):
    """Write 10 s of a car at 20 Hz, with some columns changed or added, and the column map map.toml."""
    time = np.arange(201) / 20
    columns = {
        "t": time,
        "u": 1.0 + 0.5 * np.sin(2.5 * time),
        "r": 1.5 * np.sin(2.5 * time) + 0.3,
        "throttle": 0.8 * np.cos(2.0 * time),
        "steering": np.sign(np.sin(3.0 * time)),
        **changes,
    }
    header = ",".join(columns)
    np.savetxt(folder / name, np.column_stack(list(columns.values())), "%.17g", ",", header=header, comments="")
    (folder / "map.toml").write_text(CAR_MAP)
    return "--columns", "map.toml"


def test_import_stores_what_read_returns_and_prints_notes_and_warnings(call):
    columns = write_log(call.folder, battery=np.repeat([1.0, 2.0], [100, 101]))
    (call.folder / "map.toml").write_text(CAR_MAP.replace(", low = -1.0, high = 1.0", ""))
    done = call.works("import", "log.csv", *columns, "--condition-column", "battery", "--out", "data")
    stored = Dataset.load(call.folder / "data")
    again = Dataset.read(call.folder / "log.csv", columns=call.folder / "map.toml", condition_column="battery")
    assert stored.fingerprint == again.fingerprint
    assert stored.conditions == ("1", "2")
    assert "log" in done.stdout
    assert "data set stored in" in done.stdout
    assert "note: control 'drive' has no limits" in done.stderr
    assert "note" not in done.stdout
    write_log(call.folder, throttle=np.full(201, 0.25))
    done = call("import", "log.csv", *columns, "--out", "constant")
    assert done.says("warning: log.csv, every row, column 'throttle': control 'drive' is constant")


def test_import_leaves_nothing_behind_when_a_log_is_bad(call):
    speed = np.ones(201)
    speed[3] = np.nan
    done = call.refused("import", "log.csv", *write_log(call.folder, u=speed), "--out", "data")
    assert done.says("log.csv, row 5, column 'u'")
    assert not (call.folder / "data").exists()


def test_inspect_shows_tables_of_at_most_80_columns_and_json_that_a_program_can_read(call):
    name = "a_recording_with_a_rather_long_name_of_forty.csv"
    columns = write_log(call.folder, name)
    shown = call("inspect", name, *columns).stdout
    assert max(len(line.rstrip()) for line in shown.splitlines()) <= 80
    for heading in (
        "Excitation",
        "States",
        "Coverage",
        "Delay of a control",
        "Time between rows",
        "What to record next?",
    ):
        assert heading in shown
    call("import", name, *columns, "--out", "data")
    advice = call.told("inspect", "data", "--json")
    assert advice["fingerprint"] == Dataset.load(call.folder / "data").fingerprint
    assert advice["episodes"] == [{"name": name.removesuffix(".csv"), "steps": 200}]
    assert [state["name"] for state in advice["states"]] == ["forward_speed", "yaw_rate"]
    assert advice["sampling"] == []
    assert list(advice["remarks"][0]) == ["topic", "sentence", "weight", "figures"]


def test_a_log_without_controls_or_motion_is_imported_and_inspected(call):
    level = 0.5 + 2.0 * np.exp(-np.arange(400.0) / 60.0)
    np.savetxt(call.folder / "log.csv", level, "%.17g", header="h", comments="")
    tank = 'name = "leaking tank"\ndt = 1.0\n[states]\nlevel = { column = "h", unit = "m", low = 0.5 }\n'
    (call.folder / "free.toml").write_text(tank)
    assert call("import", "log.csv", "--columns", "free.toml", "--out", "data").code == 0
    shown = call("inspect", "data").stdout
    assert "in motion" not in shown
    assert "leaking tank: 1 episode, 399 s at 1 Hz" in shown
    assert Dataset.load(call.folder / "data").system.states[0].neutral == 0.5


def test_fit_prints_the_error_of_every_model_and_the_data_behind_it(call, stored_data):
    fitted = call.works("fit", stored_data, "--models", "nearest_neighbour,linear", "--out", "mine")
    assert "What limits linear, and what to record next?" in fitted.stdout  # the best one, not the first
    assert "30 s in motion are only 47 times the slowest time scale of the states" in fitted.stdout
    assert "Evaluated on the last quarter of each" in fitted.stdout
    rows = dict(line.split()[:2] for line in fitted.stdout.splitlines() if line.startswith(("linear ", "nearest")))
    errors = {name: float(error) for name, error in rows.items()}
    assert errors.keys() == {"linear", "nearest_neighbour"}
    assert 0.0 < errors["linear"] < errors["nearest_neighbour"]
    assert "mean error after 20 steps (1 s) on the last quarter of the data (a copy" in " ".join(fitted.stdout.split())
    assert "too few to compare models; record more" in fitted.stderr
    tested = call("fit", stored_data, "--models", "linear", "--test", "episode-2", "--json", "--out", "tested")
    (row,) = json.loads(tested.stdout)
    assert (row["evaluated_on"], row["steps"]) == ("the test part", 20)
    assert row["error"] > 0.0


def test_fit_without_models_fits_auto_and_prints_the_selected_families(call, stored_data):
    assert "fit auto" in call.works("fit", stored_data, "--dry-run").stdout
    chosen = "auto(candidates=[linear(state_lags=1), 'linear(ridge=1e5)'])"
    fitted = call.works("fit", stored_data, "--models", chosen, "--out", "mine")
    assert "mean of 1 of 2 candidates: linear(state_lags=1) (" in " ".join(fitted.stdout.split())
    (stored,) = (call.folder / "mine" / "models").glob("auto-*.json")
    card = call.told("models", "show", stored, "--json")
    assert [row["weight"] for row in card["candidates"]] == ["1.00", ""]
    shown = call("models", "show", stored)
    assert "linear(ridge=100000" in shown.stdout
    assert max(map(len, shown.stdout.splitlines())) <= 80


def test_models_list_names_every_family_as_table_and_as_json(call):
    table, document = call("models", "list"), call("models", "list", "--json")
    rows = json.loads(document.stdout)
    assert {"linear", "nearest_neighbour", "parametrised"} <= {row["name"] for row in rows}
    assert all(row["name"] in table.stdout and row["summary"] for row in rows)
    explained = " ".join(table.stdout.split()).partition("assumes: ")[2]
    assert {row["knowledge"] for row in rows} <= {"black", "dark grey", "grey"}
    assert all(f"{row['knowledge']} " in explained for row in rows)


def test_models_list_writes_a_markdown_table_for_the_documentation(call):
    head, rule, *rows = call.works("models", "list", "--format", "markdown").stdout.splitlines()
    assert {line.replace(r"\|", "").count("|") for line in (head, rule, *rows)} == {7}
    assert any(row.startswith("| `linear` | ") and row.endswith(" | black | polynomial | no | 0.1 s |") for row in rows)
    assert "expected table or markdown" in call("models", "list", "--format", "html").stderr


def test_models_show_gives_the_card_of_a_family_and_of_a_fitted_model(call, finished_run):
    family = call.works("models", "show", "parametrised")
    assert "generations" in family.stdout
    assert "thrust" in family.stdout
    (stored,) = (finished_run / "models").glob("linear-*.json")
    card = call.told("models", "show", stored, "--json")
    assert card["family"] == "linear"
    assert card["timings"]["fit_seconds"] >= 0
    shown = call("models", "show", stored)
    assert max(map(len, shown.stdout.splitlines())) <= 80


@pytest.fixture(scope="module")
def floors(tmp_path_factory):
    """A fitted model, what it learned from, and two new recordings: of another floor, and of the same."""
    place = tmp_path_factory.mktemp("adapt")
    training = drive(FloorCar(), seconds=40.0, seed=1)
    training.save(place / "old")
    drive(FloorCar(thrust=1.8, turn=2.0), seconds=15.0, seed=2).save(place / "other")
    drive(FloorCar(), seconds=15.0, seed=3).save(place / "same")
    save_model(make_model("narx", degree=2, terms=8, state_lags=1).fit(training, rng=0), place / "base")
    return place


def test_adapt_prints_the_acceptance_test_and_stores_a_better_model(floors, call, monkeypatch):
    monkeypatch.setattr("model_zoo.polynomial.narx.Narx.fine_tuned", lambda self, data, updates, *, rng: self)
    monkeypatch.setattr("sysid_evo.models.adaptation.selection.KINDS", ("action", "linear", "products"))
    monkeypatch.setattr("sysid_evo.models.adaptation.selection.RIDGES", (0.3, 0.03))
    command = ("adapt", floors / "base", "--data", floors / "other", "--out", "there")
    done = call.works(*command)
    assert "products, ridge" in done.stdout
    assert "lower on 3 blocks it was not fitted to" in " ".join(done.stdout.split())
    assert "Simulation over 3 blocks, 15 s in all, each held out in turn" in " ".join(done.stdout.split())
    lines = done.stdout.splitlines()
    (more,) = [line for line in lines if "worse ones (listed by --json)" in line]
    assert int(more.split()[1]) == 14 - 12
    table = [line for line in lines if re.search(", ridge|^fit to the|updates", line) and "lower on" not in line]
    assert len(table) == 12
    assert any("fine-tuned, 800 updates" in line for line in table)
    assert all(len(line.split("  ")[-1]) == 4 or line.endswith(" -") for line in table), table
    assert max(map(len, lines)) <= 80
    test = drive(FloorCar(thrust=1.8, turn=2.0), seconds=20.0, seed=9)
    assert load_model(call.folder / "there").score(test) > 0.6 * load_model(floors / "base").score(test)
    assert call.refused(*command).says("exists already")


def test_without_a_change_adapt_reports_it_and_tries_a_refit_with_train(floors, call, monkeypatch):
    monkeypatch.setattr("sysid_evo.models.adaptation.selection.RIDGES", (0.3, 0.03))
    command = ("adapt", floors / "base", "--data", floors / "same", "--train", floors / "old", "--seconds", "12")
    told = call.told(*command, "--json", "--out", "there")
    assert told["decision"].startswith("not adapted: the best candidate")
    assert not told["corrected"]
    assert "refit" in [row["correction"] for row in told["candidates"]]
    blocks = {row["correction"]: len(row["blocks"]) for row in told["candidates"]}
    assert all(count == 3 for name, count in blocks.items() if name.count("ridge") == 1 and " and " not in name)
    assert blocks["fit to the new data"] < 3  # it is no better in the first


def study(folder, *, models='"linear", "nearest_neighbour"', robots='"emulated_car"', seeds="[0, 1]", more=""):
    """Write a study without controllers, and return its file."""
    file = folder / "tiny.toml"
    experiment = f'models = [{models}]\nminutes = 0.3\nstop_after = "prediction"\n'
    grid = f"robot = [{robots}]\nseed = {seeds}\n{more}"
    file.write_text(f'title = "Tiny"\n[experiment]\n{experiment}[grid]\n{grid}')
    return file


def test_a_dry_run_of_a_study_shows_points_and_cells_and_makes_nothing(call):
    study(call.folder, robots='"emulated_car", "emulated_car(seed=1)"')
    plan = call.told("study", "tiny.toml", "--dry-run", "--json")
    assert [point["point"] for point in plan["points"]][:2] == ["emulated_car, seed 0", "emulated_car, seed 1"]
    assert plan["kept"] == 0
    assert plan["cells"] == sum(point["cells"] for point in plan["points"])
    assert not (call.folder / "runs").exists()


def test_cells_that_points_share_are_expected_once(call):
    models = '"linear", "ridge=linear(ridge=0.5)"'  # no preset of which changes anything
    study(call.folder, models=models, more='preset = ["quick", "paper"]\n')
    plan = call.told("study", "tiny.toml", "--dry-run", "--json")
    one, other = plan["points"][:2]
    assert one["cells"] == other["cells"]
    assert one["seconds"] > 0.0
    assert other["seconds"] == 0.0
    assert plan["seconds"] == pytest.approx(sum(point["seconds"] for point in plan["points"]), abs=0.5)
    assert 2 * plan["cells"] == sum(point["cells"] for point in plan["points"])


def test_the_expected_time_of_a_cell_is_corrected_by_measured_times_of_its_kind(tmp_path):
    planned = plan_study(Study.read(study(tmp_path)))
    fits = [cell for cell in planned.plan if cell.kind == "fit"]
    tried = {cell.digest: None for cell in planned.plan}
    tried[fits[0].digest] = SimpleNamespace(status="done", seconds=3.0 * fits[0].expected_seconds)
    tried[fits[1].digest] = SimpleNamespace(status="failed", seconds=1000.0)
    about = seconds_about(planned, tried)
    assert about[fits[2].digest] == pytest.approx(3.0 * fits[2].expected_seconds)
    others = [cell for cell in planned.plan if cell.kind == "predict"]
    assert [about[cell.digest] for cell in others] == [cell.expected_seconds for cell in others]


def test_a_study_resumes_and_a_finished_one_is_only_rendered(call):
    study(call.folder, seeds="[0]")
    call.works("study", "tiny.toml")
    study(call.folder)
    more = call.told("study", "tiny.toml", "--dry-run", "--json")
    assert more["kept"] == more["cells"] / 2
    done, todo = more["points"]
    assert done["seconds"] == 0.0
    assert more["seconds"] == pytest.approx(todo["seconds"], abs=0.1)
    assert "1 of 2 points are not finished" in " ".join(call("study", "tiny.toml", "--render").stdout.split())
    assert "not finished" not in call.works("study", "tiny.toml").stdout
    document = call.folder / "runs" / "tiny" / "study.json"
    before = document.read_text()
    again = call("study", "runs/tiny")
    assert "done" not in again.stderr.replace("are done already", "")
    assert document.read_text() == before
    assert max(len(line) for line in again.stdout.splitlines() if "study." not in line) <= 80
    assert "nearest_neighbour" in again.stdout


def test_a_failed_cell_of_a_study_is_reported_with_its_reason(call):
    study(call.folder, models='"linear", "bad=nearest_neighbour(state_lags=2000)"')
    done = call("study", "tiny.toml", "--verbose")
    assert done.code == 3
    assert "fit bad" in done.stdout
    assert "2 of" in done.stderr
