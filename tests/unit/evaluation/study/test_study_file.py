"""What stands in STUDY.toml, and what is refused before any work."""

import pytest

from evaluation.study.study import Study
from sysid_evo.errors import InvalidArgument

GRID = {"robot": ["emulated_car"], "seed": [0, 1]}


def test_every_combination_of_values_is_a_point_named_by_its_labels():
    study = Study.of({"experiment": {"minutes": 1.0}, "grid": {**GRID, "procedure": ["recommended", "plain"]}})
    assert [point.name for point in study.points] == [
        "emulated_car, seed 0, procedure recommended",
        "emulated_car, seed 0, procedure plain",
        "emulated_car, seed 1, procedure recommended",
        "emulated_car, seed 1, procedure plain",
    ]
    assert study.points[3].experiment.procedure == "plain"
    assert study.points[3].experiment.minutes == 1.0
    assert study.points[3].group == ("plain",)


def test_ranges_contain_all_their_numbers():
    study = Study.of({"grid": {"robot": ["emulated_car", "emulated_car(seed=1..2)"], "seed": "3..4"}})
    robots = dict.fromkeys(point.labels["robot"] for point in study.points)
    assert list(robots) == ["emulated_car", "emulated_car(seed=1)", "emulated_car(seed=2)"]
    assert [point.experiment.seed for point in study.points] == [3, 4] * 3
    assert [point.experiment.seed for point in Study.of({"grid": {"seed": ["7..7"]}}).points] == [7]
    assert (
        Study.of({"grid": {"task": ["point_to_point(horizon=1..2)"]}}).points[0].name
        == "task point_to_point(horizon=1..2)"
    )


def test_values_may_have_names_of_their_own():
    study = Study.of({"grid": {**GRID, "models": {"few": ["linear"], "two": ["linear", "nearest_neighbour"]}}})
    assert study.points[1].labels["models"] == "two"
    assert study.points[1].experiment.models == ("linear", "nearest_neighbour")


def test_several_grids_are_united_and_what_both_hold_is_one_point():
    first = {"seed": [0, 1], "procedure": ["plain"]}
    study = Study.of({"grid": [first, {"seed": [1, 2], "procedure": ["plain"]}, {"seed": [0]}]})
    assert [point.name for point in study.points] == [
        "seed 0, procedure plain",
        "seed 1, procedure plain",
        "seed 2, procedure plain",
        "seed 0, procedure usual",
    ]


@pytest.mark.parametrize(
    "settings, said",
    [
        ({"grids": GRID}, "grids is no part of a study. Did you mean 'grid'?"),
        ({"grid": {}}, "at least one axis"),
        ({"grid": {"sede": [0]}}, "grid.sede: is no setting of an experiment. Did you mean 'seed'?"),
        ({"grid": {"seed": []}}, "grid.seed: expected at least one value"),
        ({"grid": {"seed": [0, 0]}}, "'0' occurs twice"),
        ({"grid": {"seed": "4..0"}}, "from the lower to the higher"),
        ({"grid": {"seed": 3}}, "expected a list of values"),
        ({"grid": {"seed": [-1]}}, "grid.seed: expected a number >= 0, got -1"),
        ({"grid": {"seed": ["a"]}}, "grid.seed"),
        ({"grid": {"title": ["a"]}}, "cannot be an axis"),
        ({"grid": {"plugins": [["a.py"]]}}, "name it under [experiment]"),
        ({"experiment": {"seed": 1}, "grid": GRID}, "seed is both under [experiment] and in the grid"),
        (
            {"experiment": {"modles": ["linear"]}, "grid": GRID},
            "modles is no setting of an experiment. Did you mean 'models'?",
        ),
        ({"experiment": {"title": "a"}, "grid": GRID}, "above [experiment]"),
        ({"experiment": [1], "grid": GRID}, "expected a table [experiment]"),
        ({"title": 3, "grid": GRID}, "title: expected a text, got 3"),
        ({"grid": {"models": [["linear"], "linear"]}}, "two values are called 'linear'; name them"),
        (
            {"grid": [{"seed": [0], "models": {"a": [name]}} for name in ("linear", "narx")]},
            "two points are called 'seed 0, models a'",
        ),
        ({"grid": GRID, "compare_with": {"seed": "0"}}, "compare_with.seed: expected controller, or an axis"),
        (
            {"grid": GRID, "compare_with": {"procedure": "plain"}},
            "compare_with.procedure: expected controller, or an axis",
        ),
        (
            {"grid": {**GRID, "procedure": ["plain"]}, "compare_with": {"procedure": "best"}},
            "expected one of plain, got 'best'",
        ),
    ],
)
def test_a_study_that_cannot_be_made_is_refused_with_a_sentence(settings, said):
    with pytest.raises(InvalidArgument) as refused:
        Study.of(settings)
    assert said in str(refused.value)


def test_a_file_is_named_in_what_is_wrong_with_it(tmp_path):
    file = tmp_path / "mine.toml"
    for text, said in (("[grid", "expected a study in TOML"), ("[grid]\nseed = []", "at least one value")):
        file.write_text(text)
        with pytest.raises(InvalidArgument, match=f"mine.toml: .*{said}"):
            Study.read(file)
    with pytest.raises(InvalidArgument, match="found no such file"):
        Study.read(tmp_path / "yours.toml")


def test_a_study_without_a_title_has_the_name_of_its_file(tmp_path):
    (tmp_path / "mine.toml").write_text("[grid]\nseed = [0]")
    assert Study.read(tmp_path / "mine.toml").title == "mine"


def test_a_place_is_the_robot_or_the_recordings_of_a_point():
    study = Study.of({"grid": {"seed": [0], "data": {"dry": ["dry.csv"], "wet": ["wet.csv"]}}})
    assert [point.where for point in study.points] == ["dry", "wet"]
    assert [point.name for point in study.points] == ["dry, seed 0", "wet, seed 0"]
    assert Study.of({"grid": {"seed": [0]}}).points[0].where == "emulated_car"


def test_a_study_that_is_written_is_read_as_it_was(tmp_path):
    study = Study.of(
        {"title": "T", "grid": {"seed": "0..2", "models": {"a": ("linear",)}}, "compare_with": {"models": "a"}}
    )
    assert Study.read(study.write(tmp_path / "study.toml")) == study
