"""Ctrl-C in the middle of a fit: a clear sentence, nothing half-written, and the run goes on afterwards."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from sysid_evo.evolution import MuPlusLambda
from sysid_evo.registry import strategies
from sysid_evo.testing import example_dataset
from sysid_evo.types import Array
from tests.fixtures.commands import Caller, run_here

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


WAITING = PLUGIN.replace("interrupted", "waiting").replace("Interrupted", "Waiting").replace(
    """        if not Path("second").exists():
            signal.signal(signal.SIGINT, signal.default_int_handler)  # a job in the background ignores it
            signal.raise_signal(signal.SIGINT)
""",
    """        if not Path("second").exists():
            Path("waits").write_text(str(os.getpid()))
            time.sleep(60.0)
""",
).replace("import signal\n", "import os\nimport time\n")  # fmt: skip


def test_ctrl_c_ends_fits_side_by_side_in_good_order_and_the_same_command_goes_on(tmp_path: Path) -> None:
    logs = example_dataset().save(tmp_path / "car")
    (tmp_path / "mine.py").write_text(WAITING)
    arguments = ["fit", str(logs), "--plugin", "mine.py", "--models", "waiting,linear", "--jobs", "2", "--out", "out"]
    command = [sys.executable, "-c", "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); "
               "from sysid_evo.__main__ import main; main()", *arguments]  # fmt: skip
    process = subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.PIPE, text=True, start_new_session=True)
    assert process.stderr is not None
    said = ""
    while "fit linear" not in said or not (tmp_path / "waits").exists():
        line = process.stderr.readline()
        assert line, said
        said += line
    os.killpg(process.pid, signal.SIGINT)
    said += process.communicate(timeout=60.0)[1]
    assert process.returncode == 130
    assert "interrupted: fit waiting" in said
    assert "Nothing unfinished is kept; go on with --out out" in said
    assert "Traceback" not in said
    with pytest.raises(ProcessLookupError):
        os.kill(int((tmp_path / "waits").read_text()), 0)
    (tmp_path / "second").touch()
    again = run_here(*arguments, cwd=tmp_path)
    assert again.returncode == 0, again.stderr
    assert re.search("[23] of 6 cells are done already", again.stderr), "those of linear, judged or not yet"
    assert len(list((tmp_path / "out" / "models").glob("waiting-*.json"))) == 1


PRESSED_EARLY = """
import sys
from sysid_evo.__main__ import main

class Pressed:
    def find_spec(self, name, path=None, target=None):
        if name == "typer":
            raise KeyboardInterrupt

sys.meta_path.insert(0, Pressed())
main()
"""


def test_ctrl_c_while_the_program_is_being_imported_is_no_traceback() -> None:
    ended = subprocess.run([sys.executable, "-c", PRESSED_EARLY], capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stdout, ended.stderr) == (130, "", "")


@dataclass
class Diary:
    """Which generations were asked, and the one in which Ctrl-C is pressed."""

    asked: list[int] = field(default_factory=list)
    pressed_in: int | None = None


def test_an_interrupted_evolution_is_kept_and_the_same_command_goes_on_to_the_same_champion(
    logs: Path, call: Caller, register: Callable[..., Any]
) -> None:
    diary = Diary()

    class Stopped(MuPlusLambda):
        def __init__(self, *, n_parameters: int, seed: int) -> None:
            super().__init__(n_parameters=n_parameters, seed=seed, parents=4, children=4)

        def ask(self) -> Array:
            diary.asked.append(self.generation)
            if self.generation == diary.pressed_in:
                signal.raise_signal(signal.SIGINT)
            return super().ask()

    register(strategies, "stopped", Stopped)
    budget = ("--generations", "6", "--trials", "2", "--runs", "1", "--strategy", "stopped")
    assert call("fit", logs, "--models", "linear", "--out", "out").code == 0
    diary.pressed_in = 3
    stopped = call("evolve", "--run", "out", "--against", "linear", *budget)
    assert stopped.code == 130
    assert stopped.says(
        "interrupted: evolve linear. The 3 of 6 generations that are done are kept; go on with --run out"
    )
    champions = call.folder / "out" / "controllers"
    assert [file.suffix for file in champions.iterdir()] == [".checkpoint"]
    assert call("runs", "clean", "out").stdout.startswith("0 files")
    diary.pressed_in = None
    assert call("evolve", "--run", "out", "--against", "linear", *budget).code == 0
    assert diary.asked == [0, 1, 2, 3, 3, 4, 5]
    assert sorted(file.suffix for file in champions.iterdir()) == [".json", ".safetensors"]
    (model,) = (call.folder / "out" / "models").glob("linear-*.json")
    (call.folder / "another").mkdir()
    assert call("evolve", "--run", "another", "--against", model, *budget).code == 0
    (one,), (other,) = ((call.folder / run / "controllers").glob("*.safetensors") for run in ("out", "another"))
    assert one.read_bytes() == other.read_bytes()
