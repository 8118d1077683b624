"""Ctrl-C in the middle of a fit: a clear sentence, nothing half-written, and the run goes on afterwards."""

from __future__ import annotations

from pathlib import Path

from sysid_evo.testing import example_dataset
from tests.sysid_evo.cli.calling import run_here

PLUGIN = """
import signal
from pathlib import Path

import numpy as np

from sysid_evo import DynamicsModel, register_model


@register_model("interrupted")
class Interrupted(DynamicsModel):
    def fit(self, dataset, *, rng, progress=None):
        self.half_ = np.zeros(3)
        progress(1, 2)
        if not Path("second").exists():
            signal.signal(signal.SIGINT, signal.default_int_handler)  # a job in the background ignores it
            signal.raise_signal(signal.SIGINT)
        return self

    def next_state(self, carry, control):
        return carry
"""


def test_an_interrupted_fit_is_said_leaves_nothing_and_is_made_good_by_the_same_command(tmp_path: Path) -> None:
    logs = example_dataset().save(tmp_path / "car")
    (tmp_path / "mine.py").write_text(PLUGIN)
    command = ("fit", logs, "--plugin", "mine.py", "--models", "linear,interrupted", "--out", "out")
    stopped = run_here(*command, cwd=tmp_path)
    assert stopped.returncode == 130
    assert "interrupted: fit interrupted. Nothing unfinished is kept; go on with --out out" in stopped.stderr
    assert "Traceback" not in stopped.stderr
    kept = sorted(file.name for file in (tmp_path / "out" / "models").iterdir())
    assert [name.partition("-")[0] for name in kept] == ["linear", "linear"]
    (tmp_path / "second").touch()
    again = run_here(*command, cwd=tmp_path)
    assert again.returncode == 0, again.stderr
    assert "kept" in again.stderr
    assert len(list((tmp_path / "out" / "models").glob("interrupted-*.json"))) == 1
