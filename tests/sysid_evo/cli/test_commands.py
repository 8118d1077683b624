"""The command line: what goes to standard output, what to standard error, and how it ends."""

from __future__ import annotations

import json
from pathlib import Path

from tests.fixtures.commands import run, run_here

PLUGIN = '''
"""A family outside the repository: the mean acceleration, whatever the state."""
import numpy as np
from sysid_evo import DynamicsModel, register_model


@register_model("mean_acceleration")
class MeanAcceleration(DynamicsModel):
    """The mean acceleration seen in the data, whatever the state."""

    def fit(self, dataset, *, rng, progress=None):
        steps = dataset.transitions()
        self.mean_ = dataset.system.acceleration(steps.carry, steps.after).mean(axis=0)
        return self

    def acceleration(self, carry, control):
        return np.tile(self.mean_, (len(carry), 1))
'''


def test_compare_runs_from_recordings_to_a_report_with_a_family_from_outside(logs: Path, tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(PLUGIN)
    done = run(
        "compare", "--data", logs, "--test", "episode-2", "--plugin", "mine.py", "--models", "mean_acceleration,linear",
        "--generations", "1", "--out", "out", "--verbose", cwd=tmp_path,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "Transfer matrix" in done.stdout
    assert done.stdout.splitlines()[-1] == "Report: out/report.html"
    assert "mean_acceleration" in done.stdout
    assert max(map(len, done.stdout.splitlines())) <= 80
    assert "done" in done.stderr
    assert "Traceback" not in done.stderr
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["timings"]
    assert (tmp_path / "out" / "report.html").is_file()


def test_fit_then_evolve_against_an_ensemble(logs: Path, tmp_path: Path) -> None:
    fitted = run_here("fit", logs, "--models", "linear,nearest_neighbour", "--out", "mine", cwd=tmp_path)
    assert fitted.returncode == 0, fitted.stderr
    assert "Nothing stands out that limits linear. Judged on the last quarter of each" in fitted.stdout
    rows = dict(line.split()[:2] for line in fitted.stdout.splitlines() if line.startswith(("linear ", "nearest")))
    errors = {name: float(error) for name, error in rows.items()}
    assert errors.keys() == {"linear", "nearest_neighbour"}
    assert 0.0 < errors["linear"] < errors["nearest_neighbour"]
    assert "mean error after 20 steps (1 s) on the last quarter of the data, which" in " ".join(fitted.stdout.split())
    assert "too few to compare models; record more" in fitted.stderr
    tested = run_here(
        "fit", logs, "--models", "linear", "--test", "episode-2", "--json", "--out", "tested", cwd=tmp_path
    )
    (row,) = json.loads(tested.stdout)
    assert (row["judged_on"], row["steps"]) == ("the test part", 20)
    assert row["error"] > 0.0
    evolved = run_here(
        "evolve", "--run", "mine", "--against", "linear,nearest_neighbour", "--aggregate", "min",
        "--noise", "envelope(sensor=0.1, latency=1)", "--caution", "doubt(outside=2)",
        "--generations", "1", "--trials", "2", "--runs", "1", cwd=tmp_path,
    )  # fmt: skip
    assert evolved.returncode == 0, evolved.stderr
    assert "linear:" in evolved.stdout
    assert " fresh trials, whose standard deviation is " in evolved.stdout
    assert "Forecast for the robot, by 2 models: " in evolved.stdout
    controller = tmp_path / evolved.stdout.split("stored as ")[1].strip()
    assert controller.parent == tmp_path / "mine" / "controllers"
    assert controller.with_suffix(".safetensors").is_file()
    assert "what to record next" in evolved.stdout
    told = [line for line in evolved.stdout.splitlines() if not line.startswith("stored as")]
    assert max(map(len, told)) <= 80
    inspected = run_here("inspect", logs, "--controller", controller, cwd=tmp_path)
    assert inspected.returncode == 0, inspected.stderr
    assert "what to record next" in inspected.stdout
    assert " of the steps" in inspected.stdout
    elsewhere = run_here("inspect", logs, "--controller", "nowhere.json", cwd=tmp_path)
    assert elsewhere.returncode == 2, elsewhere.stderr


def test_a_controller_evolves_on_the_emulated_car_without_any_model(tmp_path: Path) -> None:
    evolved = run_here(
        "evolve", "--against", "emulated_car:4", "--generations", "1", "--trials", "2", "--runs", "1", cwd=tmp_path
    )
    assert evolved.returncode == 0, evolved.stderr
    assert "emulated_car:4:" in evolved.stdout
    assert len(list(tmp_path.glob("runs/*/controllers/emulated_car-4-*.safetensors"))) == 1


def test_the_yardstick_of_a_comparison_is_a_row_of_its_matrix(logs: Path, tmp_path: Path) -> None:
    command = ("compare", "--data", logs, "--models", "linear", "--generations", "1", "--out", "out", "--yardstick")
    done = run_here(*command, "--robot", "emulated_car", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "evolve emulated_car" in done.stderr
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert [champion["name"] for champion in report["champions"]] == ["linear", "emulated_car"]


def test_models_list_names_every_family_as_table_and_as_json(tmp_path: Path) -> None:
    table, document = run_here("models", "list", cwd=tmp_path), run_here("models", "list", "--json", cwd=tmp_path)
    rows = json.loads(document.stdout)
    assert {"linear", "nearest_neighbour", "parametrised"} <= {row["name"] for row in rows}
    assert all(row["name"] in table.stdout and row["summary"] for row in rows)


def test_fit_without_models_fits_auto_and_says_what_was_chosen(logs: Path, tmp_path: Path) -> None:
    planned = run_here("fit", logs, "--dry-run", cwd=tmp_path)
    assert planned.returncode == 0, planned.stderr
    assert "fit auto" in planned.stdout
    chosen = "auto(candidates=[linear(state_lags=1), 'linear(ridge=1e5)'])"
    fitted = run_here("fit", logs, "--models", chosen, "--out", "mine", cwd=tmp_path)
    assert fitted.returncode == 0, fitted.stderr
    assert "kept 1 of 2 candidates and is their mean: linear(state_lags=1) (" in " ".join(fitted.stdout.split())
    (stored,) = (tmp_path / "mine" / "models").glob("auto-*.json")
    card = json.loads(run_here("models", "show", stored, "--json", cwd=tmp_path).stdout)
    assert [row["weight"] for row in card["candidates"]] == ["1.00", ""]
    shown = run_here("models", "show", stored, cwd=tmp_path)
    assert "linear(ridge=100000" in shown.stdout
    assert max(map(len, shown.stdout.splitlines())) <= 80


def test_models_show_gives_the_card_of_a_family_and_of_a_fitted_model(logs: Path, tmp_path: Path) -> None:
    family = run_here("models", "show", "parametrised", cwd=tmp_path)
    assert family.returncode == 0, family.stderr
    assert "generations" in family.stdout
    assert "thrust" in family.stdout
    fitted = run_here("fit", logs, "--models", "linear", "--out", "mine", cwd=tmp_path)
    assert fitted.returncode == 0, fitted.stderr
    (stored,) = (tmp_path / "mine" / "models").glob("linear-*.json")
    card = json.loads(run_here("models", "show", stored, "--json", cwd=tmp_path).stdout)
    assert card["family"] == "linear"
    assert card["timings"]["fit_seconds"] >= 0
    assert "million_steps_per_second" not in card["timings"]
    measured = json.loads(run_here("models", "show", stored, "--speed", "--json", cwd=tmp_path).stdout)
    assert measured["timings"]["million_steps_per_second"] > 0
    assert measured["timings"]["engine"].startswith("compiled")
    shown = run_here("models", "show", stored, cwd=tmp_path)
    assert "speed" in shown.stdout
    assert "not measured, --speed does" in shown.stdout
    assert max(map(len, shown.stdout.splitlines())) <= 80


def test_tune_prints_the_line_to_use_and_goes_on_in_the_same_folder(logs: Path, tmp_path: Path) -> None:
    command = ("tune", "linear(intercept=true)", "--data", logs, "--horizon", "10", "--out", "out")
    done = run_here(*command, "--trials", "3", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1].startswith("linear(intercept=true, ")
    further = run_here(*command, "--trials", "5", "--json", cwd=tmp_path)
    assert further.returncode == 0, further.stderr
    found = json.loads(further.stdout)
    assert len(found["trials"]) == 5
    assert found["horizons"] == [10]
    assert found["best"] == found["trials"][0]["spec"]
    wrong = run_here(*command, "--budget", "soon", cwd=tmp_path)
    assert wrong.returncode == 2
    assert "expected a time such as 90s, 5m or 1h, got 'soon'" in " ".join(wrong.stderr.split())
