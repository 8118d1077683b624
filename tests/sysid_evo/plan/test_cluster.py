"""Cells on a Dask cluster of real processes: the results are those of this process, and what dies loses nothing."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

from sysid_evo.plan import Plan, Store, execute
from tests.sysid_evo.plan.dask_processes import Processes
from tests.sysid_evo.plan.deeds import planned
from tests.sysid_evo.plan.made_up_cells import Watching

ROW = [(f"row {i}", "wait 0.05", ["base"]) for i in range(4)]
LADDER = [("base", "", []), *ROW, ("top", "", [label for label, _, _ in ROW])]


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Processes]:
    made = Processes(tmp_path_factory.mktemp("dask"))
    made.start(2)
    yield made
    made.stop()


def run(folder: Path, plan: Plan, scheduler: str | Path | None) -> tuple[Watching, Store]:
    folder.mkdir(exist_ok=True)
    watching, store = Watching(), Store(folder)
    execute(plan, store, observer=watching, scheduler=scheduler)
    return watching, Store(folder)


def diary(folder: Path) -> Counter[str]:
    return Counter(line.split(" ", 1)[1] for line in (folder / "diary").read_text().splitlines())


def processes(folder: Path) -> set[int]:
    return {int(line.split(" ", 1)[0]) for line in (folder / "diary").read_text().splitlines()}


def test_the_results_are_those_of_one_process_and_nothing_is_computed_twice(tmp_path: Path, cluster: Processes) -> None:
    found = []
    for name, scheduler in (("here", None), ("there", cluster.file)):
        folder = tmp_path / name
        plan = planned(folder / "diary", *LADDER, ("broken", "fail", []), ("after", "", ["broken"]),
                       ("tolerant", "", ["broken", "base"]))  # fmt: skip
        watching, store = run(folder, plan, scheduler)
        assert set(diary(folder).values()) == {1}
        assert (os.getpid() in processes(folder)) == (scheduler is None)
        assert sorted(watching.computed) == sorted(cell.name for cell in plan)
        assert watching.remarks == []
        files = {file.relative_to(folder): file.read_bytes() for file in folder.rglob("*.txt")}
        found.append((files, [(cell.title, store.outcome(cell).value, store.outcome(cell).reason) for cell in plan]))
    assert found[0] == found[1]
