"""The plugin path: a new package that works as it is written."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from tests.sysid_evo.cli.calling import run


def test_a_new_plugin_keeps_the_contract_passes_its_test_and_is_not_overwritten(tmp_path: Path) -> None:
    written = run("plugin", "new", "my_model", cwd=tmp_path)
    assert written.returncode == 0, written.stderr
    checked = run("plugin", "check", "my_model", "--plugin", "my_model/my_model.py", cwd=tmp_path)
    assert checked.returncode == 0, checked.stdout + checked.stderr
    assert "ok     A step changes neither its arguments" in checked.stdout
    assert max(map(len, checked.stdout.splitlines())) <= 80
    options = ["-q", "-p", "no:cacheprovider", "--import-mode=prepend", "-c", "/dev/null", "--rootdir", "."]
    test = subprocess.run(
        [sys.executable, "-m", "pytest", *options, "tests"],
        cwd=tmp_path / "my_model",
        env={"PYTHONPATH": ".", "PATH": ""},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert test.returncode == 0, test.stdout + test.stderr
    again = run("plugin", "new", "my_model", cwd=tmp_path)
    assert again.returncode == 2
    assert "would be overwritten" in again.stderr


def test_a_plugin_that_breaks_the_contract_is_told_which_sentence(tmp_path: Path) -> None:
    run("plugin", "new", "my_model", cwd=tmp_path)
    path = tmp_path / "my_model" / "my_model.py"
    path.write_text(
        path.read_text().replace("return self._regressors(carry", "carry[:] = 0\n        return self._regressors(carry")
    )
    checked = run("plugin", "check", "my_model", "--plugin", path, cwd=tmp_path)
    assert checked.returncode == 1
    assert "BROKEN A step changes neither its arguments nor its own later results" in checked.stdout


def test_a_name_that_is_no_python_name_is_refused(tmp_path: Path) -> None:
    done = run("plugin", "new", "my-model", cwd=tmp_path)
    assert done.returncode == 2
    assert "expected a lower-case Python name such as my_model, got 'my-model'" in " ".join(done.stderr.split())
