"""Two runs side by side: what changed is named, what differs by chance is not called better."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from evaluation.report import Report
from evaluation.report.contents import ModelSummary
from evaluation.report.formats import write_format
from evaluation.report.two_runs import (
    Change,
    Differences,
    differences,
    save_comparison,
    stem,
    terminal,
    to_json,
    two_stories,
)
from evaluation.report.two_runs.differences import _between
from sysid_evo.system import Channel, System
from tests.evaluation.made_up import SECOND, matrix, prediction, report
from tests.evaluation.test_brief import printed

BEFORE = {"persistence": 0.9, "linear": 0.40, "sindy": 0.300, "narx": 0.20}
AFTER = {"persistence": 0.9, "linear": 0.30, "sindy": 0.301, "mlp": 0.20}
SETTINGS = {"seed": 1, "task": "point_to_point", "transfer_trials": 10, "generations": 20, "robot": "car"}


def fitness(a: float, b: float) -> dict[str, dict[str, float]]:
    return {"a": {"a": 12.0, "b": 11.0, "car": a}, "b": {"a": 9.0, "b": 10.0, "car": b}}


def run(n: dict[str, float], on_car: tuple[float, float], **settings: object) -> Report:
    made = report(prediction(n, n), matrix(fitness(*on_car), robot="car"))
    return replace(
        made,
        settings={**SETTINGS, **settings},
        models=tuple(ModelSummary(name, name, "black", {"lags": 1}) for name in n if name != "persistence"),
    )


def with_other_errors(made: Report, name: str) -> Report:
    """Return a report in which one model errs in other windows than before: its draws come in another order."""
    assert made.prediction is not None
    models = []
    for model in made.prediction.models:
        scores = [replace(score, resampled_n=score.resampled_n[::-1]) for score in model.at]
        models.append(replace(model, at=tuple(scores)) if model.name == name else model)
    return replace(made, prediction=replace(made.prediction, models=tuple(models)))


@pytest.fixture(scope="module")
def found() -> Differences:
    after = with_other_errors(run(AFTER, (9.0, 8.0), generations=40), "sindy")
    return differences(run(BEFORE, (4.0, 8.0)), after, ("before", "after"))


def test_settings_and_models_that_differ_are_named_and_no_others(found: Differences) -> None:
    assert found.settings == {"generations": (20, 40)}
    assert found.models_only_in(0) == ("narx",)
    assert found.models_only_in(1) == ("mlp",)
    assert found.parameters == {}
    other = replace(found.reports[1], models=(ModelSummary("linear", "linear", "black", {"lags": 2}),))
    assert differences(found.reports[0], other).parameters == {"linear.lags": (1, 2)}


def test_a_real_change_is_told_from_chance(found: Differences) -> None:
    changes = found.errors[SECOND]
    assert list(changes) == ["persistence", "linear", "sindy"]
    assert changes["linear"].significant
    assert changes["linear"].difference == pytest.approx(-0.1)
    assert not changes["sindy"].significant
    assert changes["persistence"].same
    by_name = {c.name: c for c in found.controllers}
    achieved = by_name["a"].achieved
    assert achieved is not None
    assert achieved.significant
    assert achieved.difference == pytest.approx(5.0)
    unchanged = by_name["b"].achieved
    assert unchanged is not None
    assert unchanged.same


def test_draws_are_paired_only_where_both_runs_met_the_same() -> None:
    first = run(BEFORE, (4.0, 8.0))
    same, other_seed = (differences(first, run(BEFORE, (4.0, 8.0), **change)) for change in ({}, {"seed": 2}))
    assert same.same_test
    assert same.same_trials
    assert not other_seed.same_trials
    paired, apart = (each.controllers[0].achieved for each in (same, other_seed))
    assert paired is not None
    assert apart is not None
    assert paired.paired
    assert not apart.paired
    assert paired.interval == (0.0, 0.0)
    assert apart.interval is not None
    assert apart.interval.low < 0.0 < apart.interval.high
    assert not apart.same
    shorter = replace(first, prediction=prediction(BEFORE, BEFORE, steps=40))
    assert not differences(first, shorter).same_test


def test_another_robot_or_other_models_are_not_compared_with_each_other() -> None:
    first = run(BEFORE, (4.0, 8.0))
    renamed = {"a": {"a": 12.0, "c": 11.0, "van": 4.0}}
    found = differences(first, replace(first, matrix=matrix(renamed, robot="van")))
    (only,) = found.controllers
    assert only.claimed is not None
    assert only.others is None
    assert only.achieved is None
    sentences = " ".join(sentence for section in two_stories(found).sections for sentence in section.absent)
    assert "the runs were driven on different robots, first on car and second on van" in sentences
    assert "different models" in sentences


def test_runs_of_other_systems_compare_settings_alone_and_say_so() -> None:
    first = run(BEFORE, (4.0, 8.0))
    system = System((Channel("angle", "rad"),), (Channel("torque"),), dt=0.05)
    found = differences(first, replace(first, data=replace(first.data, system=system)), ("car", "pendulum"))
    assert found.errors == {}
    assert found.controllers == ()
    story = two_stories(found)
    for said in (story.headlines[0].sentence, *(section.absent[0] for section in story.sections[1:])):
        assert said.startswith(
            "The runs are of different systems, so neither errors nor fitness are compared: car has "
        )
        assert said.endswith("pendulum has angle, torque.")


def test_fitness_of_other_tasks_is_not_compared_but_that_of_other_parameters_is() -> None:
    first = run(BEFORE, (4.0, 8.0))
    other = differences(first, run(BEFORE, (4.0, 8.0), task="walled_track"))
    assert other.errors
    assert other.controllers == ()
    assert two_stories(other).sections[2].absent == [
        "The tasks differ, point_to_point and walled_track, so fitness is not compared."
    ]
    assert differences(first, run(BEFORE, (4.0, 8.0), task="point_to_point(arena_radius=1.0)")).controllers


def test_runs_without_a_controller_in_common_say_which_ones_they_have() -> None:
    first = run(BEFORE, (4.0, 8.0))
    renamed = replace(first, matrix=matrix({"c": {"a": 12.0, "car": 4.0}}, robot="car", against={"c": ("a",)}))
    (why,) = two_stories(differences(first, renamed)).sections[2].absent
    assert why == "The runs have no controller of the same name in common: first has a, b; second has c."
    (none,) = two_stories(differences(first, replace(first, matrix=None))).sections[2].absent
    assert none == "second holds no controller, so there is nothing to compare."


def test_two_runs_have_the_forms_of_one(found: Differences, tmp_path: Path) -> None:
    story = two_stories(found)
    text, *figures = write_format(story, "markdown", tmp_path, stem=stem(found))
    assert text.name == "against-before.md"
    assert {figure.parent.name for figure in figures} == {"against-before-figures"}
    assert "no significant<br>difference" in text.read_text()
    (tables,) = write_format(story, "latex", tmp_path, stem=stem(found))
    assert tables.read_text().count(r"\begin{table}") == len(story.sheets)


def test_the_answers_count_what_is_better_and_what_is_chance(found: Differences) -> None:
    changed, predict, achieve = two_stories(found).headlines
    assert changed.answer == "generations"
    assert changed.sentence.startswith("The same training data, the same test, the same trials")
    assert (predict.answer, predict.tone) == ("1 better, 0 worse", "good")
    assert "Better in after: linear; no significant difference: 1 of 2." in predict.sentence
    assert achieve.answer == "1 better, 0 worse"
    back = two_stories(differences(*found.reports[::-1])).headlines
    assert (back[1].answer, back[1].tone) == ("0 better, 1 worse", "bad")


def test_equal_runs_are_the_same() -> None:
    first = run(BEFORE, (4.0, 8.0))
    story = two_stories(differences(first, first))
    assert [one.answer for one in story.headlines] == ["No setting", "The same", "The same"]


def test_the_terminal_table_fits_80_columns_and_says_what_is_chance(found: Differences) -> None:
    lines = printed(terminal(found), width=80)
    text = "\n".join(lines)
    assert max(map(len, lines)) <= 80
    assert "no significant" in text
    assert "the same" in text
    assert "generations" in text
    assert "…" not in text
    long = replace(found, names=("a" * 40, "b" * 40))
    assert max(map(len, printed(terminal(long), width=80))) <= 80


def test_the_page_and_the_document_hold_the_same(found: Differences, tmp_path: Path) -> None:
    page = save_comparison(found, tmp_path)
    assert page.name == "against-before.html"
    text = page.read_text()
    for words in ("before and after", "Change of N", "Change of fitness", "no significant", "generations"):
        assert words in text
    document = json.loads(json.dumps(to_json(found), allow_nan=False))
    assert document["settings"] == {"generations": [20, 40]}
    assert document["controllers"][0]["achieved"]["significant"]
    assert document["same"] == {"training": True, "test": True, "trials": True}


def test_a_single_trial_leaves_a_difference_unknown() -> None:
    first = report(None, matrix(fitness(4.0, 8.0), robot="car", robot_trials=1))
    change = differences(first, first).controllers[0].achieved
    assert change is not None
    assert change.interval is None
    assert not change.significant


def test_intervals_of_paired_draws_are_narrower_than_of_others() -> None:
    draws = np.random.default_rng(0).normal(size=1000)
    paired, apart = (_between(draws, draws + 0.1, paired) for paired in (True, False))
    assert paired == pytest.approx((0.1, 0.1))
    assert apart is not None
    assert apart.high - apart.low > 3.0
    assert Change(0.0, 0.1, paired, True).significant
    assert not Change(0.0, 0.1, apart, False).significant
