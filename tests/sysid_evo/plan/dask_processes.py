"""A Dask cluster of real processes on this machine, for tests: any of them can be killed."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path

import psutil
from distributed import Client

ROOT = Path(__file__).parents[3]
HOST = "127.0.0.1"
LIMIT = 150.0  # s


class Processes:
    """A scheduler and its workers, with their files in ``folder``; each worker has one thread and no nanny."""

    def __init__(self, folder: Path, environment: Mapping[str, str] | None = None, protocol: str = "tcp") -> None:
        self.folder, self.protocol = folder, protocol
        self.file = folder / "scheduler.json"
        self.environment = {
            **os.environ,
            "PYTHONPATH": str(ROOT),
            "DASK_DISTRIBUTED__COMM__TIMEOUTS__CONNECT": "3s",
            "DASK_LOGGING__DISTRIBUTED": "error",
            **(environment or {}),
        }
        self.scheduler: subprocess.Popen[bytes] | None = None
        self.workers: list[subprocess.Popen[bytes]] = []

    @property
    def address(self) -> str:
        """The address of the scheduler."""
        return str(json.loads(self.file.read_text())["address"])

    def start(self, workers: int, port: int = 0) -> None:
        """Start a scheduler and ``workers``; return when it can be reached."""
        self.file.unlink(missing_ok=True)
        self.scheduler = self._run(
            "dask_scheduler", "--host", HOST, "--port", str(port), "--protocol", self.protocol, "--no-dashboard",
            "--dashboard-address", f"{HOST}:0", "--no-jupyter", "--scheduler-file", str(self.file),
        )  # fmt: skip
        deadline = time.monotonic() + LIMIT
        while not self._written():
            assert self.scheduler.poll() is None
            assert time.monotonic() < deadline
            time.sleep(0.02)
        for _ in range(workers):
            self.hire()

    def hire(self, *options: str, environment: Mapping[str, str] | None = None) -> subprocess.Popen[bytes]:
        """Start a worker."""
        worker = self._run(
            "dask_worker", self.address, "--host", HOST, "--nthreads", "1", "--no-nanny", "--no-dashboard",
            "--death-timeout", "5", "--local-directory", str(self.folder), *options, environment=environment,
        )  # fmt: skip
        self.workers.append(worker)
        return worker

    def wait(self) -> None:
        """Return when all workers are there."""
        with Client(self.address, set_as_default=False) as client:
            client.wait_for_workers(len(self.workers), timeout=LIMIT)

    def processor(self) -> float:
        """Return the processor time of all of them, in s, and of what they started that has not ended."""
        roots = [psutil.Process(process.pid) for process in (self.scheduler, *self.workers) if process is not None]
        times = [one.cpu_times() for root in roots for one in (root, *root.children(recursive=True))]
        return sum(used.user + used.system for used in times)

    def stop(self) -> None:
        """End all processes."""
        for process in [*self.workers, *([self.scheduler] if self.scheduler else [])]:
            process.kill()
            process.wait(LIMIT)
        self.workers.clear()
        self.scheduler = None

    def _written(self) -> bool:
        """Whether the scheduler has written all of its file, which is there from when it begins to."""
        try:
            return bool(self.address)
        except (FileNotFoundError, json.JSONDecodeError):
            return False

    def _run(
        self, program: str, *options: str, environment: Mapping[str, str] | None = None
    ) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", f"distributed.cli.{program}", *options]
        return subprocess.Popen(command, cwd=self.folder, env={**self.environment, **(environment or {})})
