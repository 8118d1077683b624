"""Applies changes to a copy of the tree, one after the other, and runs the tests that must notice them."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from tests.mutation.change import Change

IGNORED = (".git", ".venv", "runs", "build", "dist", "__pycache__", ".*_cache", ".hypothesis")
LIMIT = 300.0  # s for the tests of one change
COMPILED = {"kernels", "compiled", "motion"}
"""Folders of what is compiled: a cache of machine code may be stale when a file of theirs changes."""
NO_TESTS = 5
"""What pytest returns when it collected nothing."""
BROKEN = re.compile(r"^(?:FAILED|ERROR) (\S+)", re.MULTILINE)


@dataclass(frozen=True)
class Outcome:
    """What became of a change: the test that ``caught`` it, or why it could not be tried (``fault``)."""

    change: Change
    caught: str = ""
    fault: str = ""
    seconds: float = 0.0

    @property
    def word(self) -> str:
        """The test, SURVIVED, or what is wrong with the entry."""
        return self.caught or (f"NOT TRIED: {self.fault}" if self.fault else "SURVIVED")


class Copy:
    """A copy of the tree ``root`` in ``folder``, in which tests run on the copied product."""

    def __init__(self, root: Path, folder: Path) -> None:
        self.tree = folder / "tree"
        self.cache = folder / "cache"
        shutil.copytree(root, self.tree, ignore=shutil.ignore_patterns(*IGNORED))
        beside = root.parent / "shared" / "data"
        self.environment = {
            **os.environ,
            "PYTHONPATH": str(self.tree),
            "SYSID_EVO_DATA": os.environ.get("SYSID_EVO_DATA", str(beside)),
        }

    def test(self, tests: Iterable[str], *, first: bool = True, **environment: str) -> tuple[int, list[str]]:
        """Run ``tests``, up to the ``first`` that fails; return pytest's exit code and the tests that failed."""
        command = [sys.executable, "-m", "pytest", "-q", "--tb=no", "-rfE", "-p", "no:cacheprovider", *tests]
        command.append("-x" if first else "--continue-on-collection-errors")
        try:
            done = subprocess.run(
                command,
                cwd=self.tree,
                env={**self.environment, **environment},
                stdin=subprocess.DEVNULL,
                capture_output=True,
                text=True,
                timeout=LIMIT,
            )
        except subprocess.TimeoutExpired:
            return 1, [f"none within {LIMIT:.0f} s"]
        return done.returncode, BROKEN.findall(done.stdout)

    @contextmanager
    def with_change(self, change: Change) -> Iterator[None]:
        """Hold the change in the tree; afterwards the file is as old as before, so that what is cached of it holds."""
        path = self.tree / change.file
        text, stat = path.read_bytes(), path.stat()
        path.write_text(change.changed(self.tree), encoding="utf-8")
        try:
            yield
        finally:
            path.write_bytes(text)
            os.utime(path, ns=(stat.st_atime_ns, stat.st_mtime_ns))

    def failing(self, changes: Sequence[Change]) -> list[str]:
        """Run the tests of all ``changes`` on the product as it is; return those that fail.

        Raises `RuntimeError` if they cannot be run, as then nothing is known of any change.
        """
        tests = dict.fromkeys(test for change in changes for test in change.tests)
        code, failed = self.test(tests, first=False, SYSID_EVO_CACHE=str(self.cache)) if tests else (0, [])
        if code != 0 and not failed:
            raise RuntimeError(f"the tests cannot be run on the product as it is: pytest ends with {code}")
        return failed

    def try_change(self, change: Change) -> Outcome:
        """Run the tests of one change with it."""
        began = time.perf_counter()
        environment = {"PYTHONDONTWRITEBYTECODE": "1"}
        if not COMPILED & set(Path(change.file).parts):
            environment["SYSID_EVO_CACHE"] = str(self.cache)
        with self.with_change(change):
            code, failed = self.test(change.tests, **environment)
        seconds = time.perf_counter() - began
        if code == 0:
            return Outcome(change, seconds=seconds)
        if code == NO_TESTS or (code > 1 and not failed):
            return Outcome(change, fault=f"pytest ends with {code}", seconds=seconds)
        return Outcome(change, caught=failed[0] if failed else f"pytest ends with {code}", seconds=seconds)


def try_changes(root: Path, folder: Path, changes: Sequence[Change]) -> Iterator[Outcome]:
    """Yield what becomes of every change of the tree ``root``, tried in a copy in ``folder``.

    What no longer fits, and what has tests that fail without any change, is not tried.
    """
    copy = Copy(root, folder)
    stale = {change: change.stale(copy.tree) for change in changes}
    failing = copy.failing([change for change in changes if not stale[change]])
    for change in changes:
        already = [name for name in failing if any(name.startswith(test) for test in change.tests)]
        if stale[change]:
            yield Outcome(change, fault=stale[change])
        elif already:
            yield Outcome(change, fault=f"{already[0]} fails without it")
        else:
            yield copy.try_change(change)
