"""A comparison in rounds: the same for any number of workers, resumed, with the recorded episodes in its data."""

import json

import numpy as np
import pytest

from evaluation.running import compare
from sysid_evo.artefacts import read_artefact
from sysid_evo.data import Dataset
from sysid_evo.evolution.champion import load_champion
from tests.fixtures.session import without_figures

SMALL = {
    "robot": 'gymnasium(id="CartPole-v1")', "rounds": 2, "models": ("linear", "nearest_neighbour"), "minutes": 0.3,
    "generations": 2, "trials": 2, "repeats": 1, "selection_trials": 2, "transfer_trials": 2, "traces": 0,
    "max_steps": 5000, "noisy_share": 0.4,
}  # fmt: skip


@pytest.fixture(scope="module")
@without_figures()
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("rounds")
    return folder, compare(out=folder, jobs=1, **SMALL)


def test_every_round_is_recorded_under_its_controller_and_what_it_achieves_is_kept(run):
    folder, report = run
    first, second = report.rounds.rounds
    recorded = report.rounds.first + first.steps.sum() + second.steps.sum()
    assert report.rounds.steps == recorded + report.rounds.steps_again
    assert report.rounds.steps_again == sum(one.again.sum() for one in report.rounds.compared)  # a reward of 1 each
    assert len(report.rounds.rest) == len(report.rounds.compared[0].again) >= 3
    assert report.rounds.rest.max() <= 20  # the pole falls
    assert report.rounds.better_than_rest
    assert not report.rounds.whole  # 250 steps of 500
    assert len(first.steps) - len(first.achieved) == 4  # with noise on the commands, of at most 100 steps
    assert first.steps[:4].max() <= 100
    assert 100 < first.steps[4:].max() <= 250  # a twentieth of all
    assert len(first.achieved) == 3  # fewer, as they last longer
    np.testing.assert_array_equal(first.achieved, first.steps[4:])  # 1 for every step until the pole falls
    assert set(first.errors) == {"linear", "nearest_neighbour"}
    names = [episode.name for part in (report.data.training, report.data.test) for episode in part]
    assert sum(name.startswith("round-2-") for name in set(names)) == len(second.steps)
    chosen = load_champion((folder / report.controllers["rounds"]).with_suffix(""))
    most = max(one.again.mean() for one in report.rounds.compared)
    best = [one.parameters for one in report.rounds.compared if one.again.mean() >= 0.99 * most]
    assert any(np.array_equal(chosen.parameters, parameters) for parameters in best)
    assert [one.behaviour_class for one in chosen.finalists] == ["round 1", "round 2"]


def test_episodes_without_noise_begin_the_same_in_all_rounds_and_those_with_noise_do_not(run):
    folder, _ = run
    (whole,) = (Dataset.load(path / "data") for path in (folder / "rounds").glob("round-2-*"))
    begins = {episode.name: episode.states[0] for episode in whole}
    same = [np.array_equal(begins[f"round-1-{i}"], begins[f"round-2-{i}"]) for i in range(1, 8)]
    assert same == [False] * 4 + [True] * 3


@pytest.mark.nightly
def test_two_workers_and_a_resumed_run_have_the_same_rounds(run, tmp_path):
    folder, report = run
    other = compare(out=tmp_path, jobs=2, **SMALL)
    for one, two in zip(report.rounds.rounds, other.rounds.rounds, strict=True):
        np.testing.assert_array_equal(one.parameters, two.parameters)
        np.testing.assert_array_equal(one.achieved, two.achieved)
        assert one.errors == two.errors
    written = [json.loads(file.read_text()) for file in (tmp_path / "cells").glob("*.json")]
    (last,) = [cell for cell in written if cell["name"] == "round-2"]
    (tmp_path / "cells" / f"{last['digest']}.json").unlink()
    again = compare(out=tmp_path, jobs=1, **SMALL)
    np.testing.assert_array_equal(again.rounds.rounds[1].parameters, report.rounds.rounds[1].parameters)
    stored = read_artefact((folder / report.controllers["rounds"]).with_suffix(""), "controller")
    assert stored[0].name == "linear"
