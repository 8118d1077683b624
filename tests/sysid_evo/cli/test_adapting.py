"""`sysid-evo adapt`: what it prints of the gate, what it stores, what it refuses."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from sysid_evo.models import load_model, save_model
from sysid_evo.models.base import make_model
from tests.fixtures.commands import Caller
from tests.fixtures.systems import FloorCar, drive


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A fitted model, what it learned from, and two new recordings: of another floor, and of the same."""
    place = tmp_path_factory.mktemp("adapt")
    training = drive(FloorCar(), seconds=40.0, seed=1)
    training.save(place / "old")
    drive(FloorCar(thrust=1.8, turn=2.0), seconds=30.0, seed=2).save(place / "other")
    drive(FloorCar(), seconds=15.0, seed=3).save(place / "same")
    save_model(make_model("narx", degree=2, terms=8, state_lags=1).fit(training, rng=0), place / "base")
    return place


def test_adapt_prints_what_the_gate_saw_and_stores_a_model_that_is_better_there(folder: Path, call: Caller) -> None:
    done = call("adapt", folder / "base", "--data", folder / "other", "--out", "there")
    assert done.code == 0, done.stderr
    assert "products, ridge" in done.stdout
    assert "better than none on 3 blocks it did not learn from" in " ".join(done.stdout.split())
    assert "Free runs over 3 blocks, 30 s in all, each by what was learned" in " ".join(done.stdout.split())
    (more,) = [line for line in done.stdout.splitlines() if "that were worse (--json has them)" in line]
    shown = [line for line in done.stdout.splitlines() if line.count(", ridge") or line.startswith("fit anew")]
    assert int(more.split()[1]) == 14 - 12
    assert len([line for line in shown if "better than none" not in line]) == 12
    assert max(map(len, done.stdout.splitlines())) <= 80
    test = drive(FloorCar(thrust=1.8, turn=2.0), seconds=20.0, seed=9)
    assert load_model(call.folder / "there").score(test) > 0.6 * load_model(folder / "base").score(test)
    again = call("adapt", folder / "base", "--data", folder / "other", "--out", "there")
    assert again.code == 2
    assert again.says("exists already")


def test_where_nothing_has_changed_it_says_so_and_tries_a_refit_if_asked(folder: Path, call: Caller) -> None:
    done = call(
        "adapt", folder / "base", "--data", folder / "same", "--train", folder / "old", "--seconds", "12", "--json",
        "--out", "there",
    )  # fmt: skip
    assert done.code == 0, done.stderr
    told = json.loads(done.stdout)
    assert told["decision"].startswith("no correction: the best")
    assert not told["corrected"]
    assert "refit" in [row["correction"] for row in told["tried"]]
    blocks = {row["correction"]: len(row["blocks"]) for row in told["tried"]}
    assert all(count == 3 for name, count in blocks.items() if name.count("ridge") == 1 and " and " not in name)
    assert blocks["fit anew"] < 3  # it is no better in the first


def test_a_network_that_is_trained_further_fits_eighty_columns(folder: Path, call: Caller) -> None:
    model = make_model("mlp_ensemble", members=2, hidden=[4], one_step_updates=20, updates=2, horizon=5, state_lags=0,
                       control_lags=0)  # fmt: skip
    save_model(model.fit(drive(FloorCar(), seconds=20.0, seed=1), rng=0), folder / "network")
    done = call("adapt", folder / "network", "--data", folder / "same", "--out", "there")
    assert done.code == 0, done.stderr
    lines = done.stdout.splitlines()
    assert max(map(len, lines)) <= 80
    ways = [line for line in lines if "ridge" in line or "updates" in line]
    assert ways
    table = [line for line in ways if "better than" not in line and "worse than" not in line]
    assert all(len(line.split("  ")[-1]) == 4 for line in table), table
