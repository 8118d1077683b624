"""Killed commands resume to the same result: ``python -m tests.benchmarks.kill_and_resume [--times 10] [--repeats 0]``.

A small comparison is run to its end once. Then the same command is killed (SIGKILL) in a new folder at ``--times``
seeded random moments, resumed in that folder each time, and run to its end; then the same with two processes in one
folder, both killed. ``report.json`` must be the same, except ``timings``. Then a local Dask cluster of two workers
computes the comparison; at each moment one worker is killed and replaced, later the scheduler, and the command
continues with another one. No finished cell may be computed twice. A long evolution by the recommended procedure is
killed in the same way; it resumes within its generations and must end with byte-identical controllers. So must a fit by
gradients, which resumes within its updates. Prints a table; exit code 1 if anything differs.

``--repeats 20`` does only this: an evolution by ``niches`` and a polish, repeated this often from the beginning and
killed three times (``--times``), while ``--busy`` other processes use the processors.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sysid_evo.cli.console import ROBOT as LOST
from sysid_evo.testing import example_dataset
from tests.fixtures.commands import COMMAND
from tests.fixtures.dask_cluster import Processes

MODELS = "linear,nearest_neighbour,near2=nearest_neighbour(state_lags=2)"
EXPERIMENT = (
    *("--models", MODELS, "--ensembles", "linear+near2", "--robot", "emulated_car"),
    *("--generations", "30", "--trials", "4", "--repeats", "1", "--task", "point_to_point(horizon=200)"),
)
EVOLUTION = (
    *("--against", "linear,nearest_neighbour", "--task", "point_to_point(horizon=200)"),
    *("--generations", "200", "--trials", "4", "--repeats", "1"),
)
NICHES = (
    *("--against", "linear", "--task", "point_to_point(horizon=200)"),
    *("--generations", "400", "--trials", "4", "--repeats", "1", "--procedure", "plain", "--strategy", "niches"),
)
POLISH = (
    *("--against", "linear,nearest_neighbour", "--task", "point_to_point(horizon=200)"),
    *("--generations", "200", "--trials", "4", "--repeats", "1", "--procedure", "recommended"),
)
FIT = ("--models", "mlp_ensemble(members=2, hidden=[16], state_lags=1, one_step_updates=400, updates=150, horizon=8)")
LIMIT = 600.0  # s, for one command


@dataclass(frozen=True)
class Row:
    """Parallel processes, kills, files left after the kills, and the result of one test."""

    what: str
    kills: int
    kept: int
    seconds: float
    same: bool


class Job(ABC):
    """A command that is killed in its own folder; its data are in ``folder``."""

    what: str
    kept: str

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    @abstractmethod
    def arguments(self, out: Path) -> tuple[str, ...]:
        """Return the command; ``out`` is a run folder."""

    @abstractmethod
    def result(self, out: Path) -> object:
        """Return the results that must be the same."""

    def fresh(self, name: str) -> Path:
        """Return a run folder in which nothing is done yet."""
        return self.folder / f"{type(self).__name__}-{name}"

    def start(self, out: Path, *options: str) -> subprocess.Popen[bytes]:
        """Start the command in the run folder ``out``."""
        command = [*COMMAND, *self.arguments(out), "--quiet", *options]
        environment = {**os.environ, "TERM": "dumb", "DASK_DISTRIBUTED__COMM__TIMEOUTS__CONNECT": "3s"}
        return subprocess.Popen(command, cwd=self.folder, env=environment, stdout=subprocess.DEVNULL)


class Comparison(Job):
    """A whole comparison, whose finished cells are kept."""

    what = "comparison"
    kept = "cells/*.json"

    def arguments(self, out: Path) -> tuple[str, ...]:
        return ("compare", "--data", str(self.folder / "car"), *EXPERIMENT, "--out", str(out))

    def result(self, out: Path) -> object:
        found: dict[str, Any] = json.loads((out / "report.json").read_text())
        del found["timings"]
        return found


class Evolution(Job):
    """One evolution, whose generations are kept."""

    what = "evolution"
    kept = "controllers/*.checkpoint"
    options = EVOLUTION

    def fresh(self, name: str) -> Path:
        fitted = self.folder / "fitted"
        if not fitted.exists():
            fit = ("fit", str(self.folder / "car"), "--models", "linear,nearest_neighbour", "--out", str(fitted))
            subprocess.run([*COMMAND, *fit, "--quiet"], cwd=self.folder, stdout=subprocess.DEVNULL, check=True)
        return Path(shutil.copytree(fitted, super().fresh(name)))

    def arguments(self, out: Path) -> tuple[str, ...]:
        return ("evolve", "--run", str(out), *self.options)

    def result(self, out: Path) -> object:
        return {file.name: file.read_bytes() for file in (out / "controllers").glob("*.safetensors")}


class ByNiches(Evolution):
    """One evolution by ``niches`` in one model."""

    what = "niches"
    options = NICHES


class Polish(Evolution):
    """The polish alone; its inputs are stored."""

    what = "polish"
    options = POLISH

    def fresh(self, name: str) -> Path:
        chosen = self.folder / "chosen"
        if not chosen.exists():
            finish([self.start(Evolution.fresh(self, "chosen").rename(chosen))])
            for record in (chosen / "cells").glob("*.json"):
                if json.loads(record.read_text())["kind"] in ("polish", "run"):
                    record.unlink()
        return Path(shutil.copytree(chosen, self.folder / f"polish-{name}"))


class Fit(Job):
    """A model that is trained by gradients, whose updates are kept."""

    what = "fit by gradients"
    kept = "models/*.checkpoint"

    def arguments(self, out: Path) -> tuple[str, ...]:
        return ("fit", str(self.folder / "car"), *FIT, "--out", str(out))

    def result(self, out: Path) -> object:
        return {file.name: file.read_bytes() for file in (out / "models").glob("*.safetensors")}


def finish(processes: list[subprocess.Popen[bytes]]) -> float:
    """Wait for all; return the seconds. Raises `RuntimeError` if one does not end with 0."""
    began = time.perf_counter()
    for process in processes:
        if process.wait(LIMIT) != 0:
            raise RuntimeError(f"the command ended with {process.returncode}")
    return time.perf_counter() - began


def kill_after(processes: list[subprocess.Popen[bytes]], seconds: float) -> int:
    """Kill all after ``seconds``; return the number of processes that were still running."""
    time.sleep(seconds)
    running = sum(process.poll() is None for process in processes)
    for process in processes:
        process.kill()
        process.wait(LIMIT)
    return running


def rows(folder: Path, times: int, seed: int) -> list[Row]:
    """Run everything in ``folder`` and return the table."""
    example_dataset().save(folder / "car")
    rng = np.random.default_rng(seed)
    found = []
    for job, several in ((Comparison(folder), (1, 2)), (Evolution(folder), (1,)), (Fit(folder), (1,))):
        warm, whole = job.fresh("warm"), job.fresh("whole")
        finish([job.start(warm)])  # compiled kernels are on disk from here on
        seconds = finish([job.start(whole)])
        expected = job.result(whole)
        found.append(Row(f"{job.what} at once", 0, 0, seconds, expected == job.result(warm)))
        found.extend(killed(job, together, times, rng, seconds, expected) for together in several)
        if isinstance(job, Comparison):
            victims = ("worker", "scheduler")
            found.extend(on_cluster(job, victim, times, rng, seconds, expected) for victim in victims)
    return found


def repeated(folder: Path, repeats: int, times: int, seed: int) -> list[Row]:
    """Evolve by niches and polish, each ``repeats`` times from the beginning, killed ``times``; return the table."""
    example_dataset().save(folder / "car")
    rng = np.random.default_rng(seed)
    found, once = [], []
    for job in (ByNiches(folder), Polish(folder)):
        finish([job.start(job.fresh("warm"))])
        whole = job.fresh("whole")
        once.append((job, finish([job.start(whole)]), job.result(whole)))
    for i in range(repeats):
        for job, seconds, expected in once:
            found.append(killed(job, 1, times, rng, seconds, expected, name=f"repeat {i + 1} of "))
            sys.stderr.write(f"{found[-1]}\n")
    return found


@contextmanager
def busy(count: int) -> Iterator[None]:
    """Keep ``count`` processors busy inside the block."""
    others = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
    try:
        yield
    finally:
        for other in others:
            other.kill()
            other.wait()


def killed(
    job: Job, together: int, times: int, rng: np.random.Generator, whole: float, expected: object, *, name: str = ""
) -> Row:
    """Kill and resume ``times`` times; if the command ends before the kill, the next kill is in a new folder."""
    what = f"{name}{job.what}" if together == 1 else f"{job.what}, {together} processes"
    kills, kept, ends = 0, 0, 0
    same, began = True, time.perf_counter()
    out = job.fresh(f"{name}{together}-{ends}")
    while kills < times:
        if kill_after([job.start(out) for _ in range(together)], float(rng.uniform(0.2, 1.0)) * whole):
            kills += 1
            kept += len(list(out.glob(job.kept)))
        else:
            same, ends = same and job.result(out) == expected, ends + 1
            out = job.fresh(f"{name}{together}-{ends}")
    finish([job.start(out) for _ in range(together)])
    return Row(what, kills, kept, time.perf_counter() - began, same and job.result(out) == expected)


def on_cluster(job: Job, victim: str, times: int, rng: np.random.Generator, whole: float, expected: object) -> Row:
    """Kill a worker or the scheduler of a cluster ``times`` times while it computes, and replace it."""
    with tempfile.TemporaryDirectory() as folder:
        cluster = Processes(Path(folder))
        try:
            return _on_cluster(job, cluster, victim, times, rng, whole, expected)
        finally:
            cluster.stop()


def _on_cluster(
    job: Job, cluster: Processes, victim: str, times: int, rng: np.random.Generator, whole: float, expected: object
) -> Row:
    kills, kept, ends, same, began = 0, 0, 0, True, time.perf_counter()
    out, process = job.fresh(f"{victim}-{ends}"), None
    while kills < times or process is not None:
        if cluster.scheduler is None:
            cluster.start(2)
            cluster.wait()
        process = process or job.start(out, "--scheduler", str(cluster.file))
        try:
            code = process.wait(float(rng.uniform(0.2, 1.0)) * whole if kills < times else LIMIT)
        except subprocess.TimeoutExpired:
            kills, kept = kills + 1, kept + len(list(out.glob(job.kept)))
            if victim == "worker":
                cluster.workers.pop(0).kill()
                cluster.hire()
            else:
                cluster.stop()
                assert process.wait(LIMIT) in (0, LOST), "the command is to end with the scheduler"
                process = None if process.returncode == LOST else process
            continue
        if code != 0:
            raise RuntimeError(f"the command ended with {code}")
        same, process = same and job.result(out) == expected and computed_once(out), None
        if kills < times:
            ends += 1
            out = job.fresh(f"{victim}-{ends}")
    return Row(f"{job.what}, {victim} killed", kills, kept, time.perf_counter() - began, same)


def computed_once(out: Path) -> bool:
    """Whether the log of a run has no cell that was done twice."""
    lines = [json.loads(line) for line in (out / "log.jsonl").read_text().splitlines()]
    done = [line["digest"] for line in lines if line.get("status") == "done"]
    return len(done) == len(set(done))


def main() -> int:
    """Print the table; return 1 if a result differs."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--times", type=int, default=10, help="kills of one, and of two processes at once (10)")
    parser.add_argument(
        "--repeats", type=int, default=0, help="kill nothing but this many searches by niches, polishes"
    )
    parser.add_argument("--busy", type=int, default=0, help="processes that keep the machine busy meanwhile (0)")
    parser.add_argument("--seed", type=int, default=0, help="of the moments (0)")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, busy(arguments.busy):
        if arguments.repeats:
            table = repeated(Path(folder), arguments.repeats, arguments.times, arguments.seed)
        else:
            table = rows(Path(folder), arguments.times, arguments.seed)
    write = sys.stdout.write
    write(f"{'run':24} {'kills':>5} {'kept':>10} {'s':>6}   result\n")
    for row in table:
        same = "the same" if row.same else "DIFFERS"
        write(f"{row.what:24} {row.kills:5d} {row.kept:10d} {row.seconds:6.1f}   {same}\n")
    return int(not all(row.same for row in table))


if __name__ == "__main__":
    sys.exit(main())
