"""Processes that share one folder: each cell is computed once, none is lost, a dead process claims nothing."""

import json
import signal
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path

from sysid_evo.plan import Plan, Store, execute
from tests.fixtures.cells import Number

ROOT = Path(__file__).parents[2]
WIDTH = 5

PROGRAM = """
import sys
from pathlib import Path
from sysid_evo.plan import Plan, Store, execute
from tests.system.test_two_processes import cells
folder = Path(sys.argv[1])
print("ready", flush=True)
sys.stdin.readline()
outcomes = execute(Plan.of(cells(folder)), Store(folder / "run"))
assert not any(outcome.failed for outcome in outcomes.values()), outcomes
"""


def cells(folder):
    """Return slow cells: one base, a row that needs it, one on top of all."""
    diary = folder / "diary"
    base = Number(1, label="base", diary=diary, seconds_long=0.2)
    row = tuple(Number(10 + i, (base,), f"row {i}", diary, 0.1) for i in range(WIDTH))
    return [Number(100, row, "top", diary, 0.1), base, *row]


def started(folder):
    """Start a process that waits for a line before it executes the plan in ``folder``."""
    process = subprocess.Popen(
        [sys.executable, "-c", PROGRAM, str(folder)],
        cwd=ROOT,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "ready\n", process.communicate()
    return process


def go(process):
    assert process.stdin is not None
    process.stdin.write("\n")
    process.stdin.flush()


def test_two_processes_share_the_work_and_no_cell_is_computed_twice_or_lost(tmp_path):
    both = [started(tmp_path) for _ in range(2)]
    for process in both:
        go(process)
    for process in both:
        _, said = process.communicate(timeout=60.0)
        assert process.returncode == 0, said
    diary = [line.split(" ", 1) for line in (tmp_path / "diary").read_text().splitlines()]
    assert Counter(label for _, label in diary) == Counter(cell.label for cell in cells(tmp_path))
    assert len({process for process, _ in diary}) == 2  # both had a part in it
    store = Store(tmp_path / "run")
    assert len(store.records()) == WIDTH + 2
    assert not store.remarks
    assert store.load(cells(tmp_path)[0]) == 100 + sum(10 + i + 1 for i in range(WIDTH))
    log = [json.loads(line) for line in (tmp_path / "run" / "log.jsonl").read_text().splitlines()]
    assert len(log) == WIDTH + 2


def test_the_claim_of_a_killed_process_is_free_again_and_its_work_is_kept(tmp_path):
    process = started(tmp_path)
    go(process)
    deadline = time.monotonic() + 60.0
    while "row 0" not in (tmp_path / "diary").read_text() if (tmp_path / "diary").exists() else True:
        assert time.monotonic() < deadline
        time.sleep(0.01)
    with Store(tmp_path / "run").claim(cells(tmp_path)[2]) as ours:
        assert not ours  # it is at it
    process.send_signal(signal.SIGKILL)
    process.communicate(timeout=60.0)
    with Store(tmp_path / "run").claim(cells(tmp_path)[2]) as ours:
        assert ours
    outcomes = execute(Plan.of(cells(tmp_path)), Store(tmp_path / "run"))
    assert not any(outcome.failed for outcome in outcomes.values())
    diary = Counter(line.split(" ", 1)[1] for line in (tmp_path / "diary").read_text().splitlines())
    assert diary["base"] == 1
    assert diary["row 0"] == 2  # killed in the middle of it
    assert Store(tmp_path / "run").load(cells(tmp_path)[0]) == 100 + sum(10 + i + 1 for i in range(WIDTH))
