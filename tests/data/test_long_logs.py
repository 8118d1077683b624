"""Long logs: read, looked at and learned from in memory that is a small multiple of their numbers."""

import json
import subprocess
import sys

import pytest

from sysid_evo.data import Dataset
from tests.benchmarks.growth.recordings import write_log

ROWS = 200_000
NUMBERS = ROWS * 9 * 8 / 2**20
"""Megabytes of the log's nine columns as numbers."""

WATCHED = """
import json, resource, sys
from sysid_evo.__main__ import main
import sysid_evo.cli.models, sysid_evo.data, evaluation.cells
import pyarrow.csv, pyarrow.parquet, scipy.signal, sklearn.base
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
sys.argv = ["sysid-evo", *sys.argv[1:]]
try:
    main()
except SystemExit as ended:
    assert not ended.code, ended.code
after = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
print(json.dumps({"megabytes": (after - before) / 1024}))
"""


def megabytes(*arguments):
    """Return by how much a command raises the peak of resident memory over what its imports take."""
    done = subprocess.run(
        [sys.executable, "-c", WATCHED, *map(str, arguments)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return float(json.loads(done.stdout.splitlines()[-1])["megabytes"])


@pytest.mark.nightly
def test_a_log_of_200_000_rows_is_imported_inspected_and_learned_from_in_little_memory(tmp_path):
    log, columns = write_log(tmp_path, ROWS)
    used = megabytes("import", log, "--columns", columns, "--out", tmp_path / "data")
    assert used < 8 * NUMBERS
    stored = Dataset.load(tmp_path / "data")
    assert stored.n_steps == ROWS - 1
    assert stored.fingerprint == Dataset.read(log, columns=columns).fingerprint
    assert megabytes("inspect", tmp_path / "data") < 20 * NUMBERS
    families = "linear,nearest_neighbour,backprop27(epochs=20)"
    fitting = ("fit", tmp_path / "data", "--models", families, "--preset", "quick", "--out", tmp_path / "run")
    assert megabytes(*fitting) < 30 * NUMBERS
    notes = [json.loads(file.read_text()) for file in (tmp_path / "run").glob("models/*.json")]
    assert len(notes) == 3
