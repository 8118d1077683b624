"""A comparison in a real notebook: its progress on stderr, its answers as cards, all of it small."""

import subprocess
import sys

import nbformat
import pytest

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


@pytest.mark.nightly
def test_all_that_a_notebook_shows_is_small(tmp_path):
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
            assert "Controllers: forecast, claimed and achieved" in result.text
            continue
        assert len(result.data["text/plain"]) < 500
        assert len(result.data["text/html"]) < MOST
        assert title in result.data["text/html"]
