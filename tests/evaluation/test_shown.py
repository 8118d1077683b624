"""What a report, a study and all else look like where somebody looks at them: in a terminal, in a real notebook."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import nbformat
import pytest

from evaluation import compare, run_study
from evaluation.experiment import Experiment, Settings
from evaluation.report.report import PrintedReport
from sysid_evo.errors import InvalidArgument
from sysid_evo.testing import example_dataset
from tests.fixtures.reports import matrix, prediction, report

CELLS = (
    "from evaluation import Study, compare",
    "from sysid_evo import make_model\nfrom sysid_evo.testing import example_dataset",
    "data = example_dataset()\ndata",
    "data.episodes[0]",
    "make_model('linear').fit(data)",
    "report = compare(data, models=['linear'], generations=2, trials=2, transfer_trials=2, progress=True)\nreport",
    "print(report)",
    "report.matrix.champions[0]",
    "report.prediction",
    "report.matrix",
    "Study.of({'experiment': {'models': ['linear']}, 'grid': {'seed': '0..1'}})",
)
SHOWN = (
    "Dataset",
    "Trajectory",
    "Linear()",
    "made-up car: linear",
    "",
    "Champion",
    "Prediction",
    "TransferMatrix",
    "Study",
)
MOST = 5_000
"""Characters of what a cell shows."""


def made() -> PrintedReport:
    fitness = {"linear": {"linear": 12.0, "<b>": 11.0, "car": 4.0}, "<b>": {"linear": 9.0, "<b>": 10.0, "car": 9.8}}
    plain = report(prediction({"persistence": 0.9, "linear": 0.3, "<b>": 0.06}), matrix(fitness, robot="car"))
    return PrintedReport(**vars(plain))


def test_a_printed_report_reads_as_the_terminal_does() -> None:
    lines = str(made()).splitlines()
    assert lines[0] == "Made up"
    assert "In short" in lines
    assert max(map(len, lines)) <= 80
    assert len(repr(made())) < 500


def test_a_report_shows_its_answers_as_cards_in_which_names_are_text() -> None:
    html = made()._repr_html_()
    assert html.count("border-top") == 3
    assert "&lt;b&gt;" in html
    assert "<b>" not in html


def test_all_that_a_notebook_shows_is_small(tmp_path: Path) -> None:
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(text) for text in CELLS])
    file = tmp_path / "shown.ipynb"
    nbformat.write(notebook, file)
    execute = "from nbclient.cli import main; main()"
    subprocess.run([sys.executable, "-c", execute, "--inplace", "--kernel_name", "python3", file], check=True)
    notebook = nbformat.read(file, nbformat.NO_CONVERT)
    shown = [
        [one for one in cell.outputs if one.output_type in ("execute_result", "stream")] for cell in notebook.cells
    ]
    assert "".join(one.text for one in shown[5] if one.get("name") == "stderr").startswith("compare: ")
    for outputs, title in zip(shown[2:], SHOWN, strict=True):
        (result,) = [one for one in outputs if one.output_type == "execute_result" or one.name == "stdout"]
        if result.output_type == "stream":
            assert "In short" in result.text
            continue
        assert len(result.data["text/plain"]) < 500
        assert len(result.data["text/html"]) < MOST
        assert title in result.data["text/html"]


def test_progress_counts_the_cells_of_a_comparison_and_of_a_study(tmp_path: Path) -> None:
    told: list[tuple[int, int, str]] = []
    settings = {"models": ["linear"], "only": "fit"}
    compare(
        example_dataset(), models=["linear"], only="fit", out=tmp_path / "run", progress=lambda *now: told.append(now)
    )
    done, cells, _ = told[-1]
    assert done == cells > 1
    assert {"fit linear"} <= {title for *_, title in told}
    told.clear()
    found = run_study(
        {"experiment": settings | {"minutes": 0.5}, "grid": {"seed": [0]}},
        out=tmp_path / "study",
        progress=lambda *now: told.append(now),
    )
    assert told[-1][0] == told[-1][1]
    assert len(repr(found)) < 500


def test_a_setting_that_is_misspelt_is_refused_with_the_right_one() -> None:
    with pytest.raises(InvalidArgument, match=r"generatons is no setting of an experiment; did you mean generations\?"):
        compare(generatons=3)  # type: ignore[call-arg]


def test_type_checkers_know_every_setting_of_an_experiment() -> None:
    """But for the data, which are an argument of their own, and what the program writes itself."""
    assert {*Settings.__annotations__, "data", "data_digest"} == set(Experiment.model_fields)
