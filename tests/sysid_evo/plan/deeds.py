"""A plan of cells that do what their settings say, so that another process can make it again."""

from __future__ import annotations

import os
import signal
import sys
import time
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sysid_evo.errors import InvalidData
from sysid_evo.plan import Again, Cell, Plan, Store, Work
from sysid_evo.processors import available_processors
from tests.sysid_evo.plan.made_up_cells import Number

AGAIN = "tests.sysid_evo.plan.deeds:made_again"


@dataclass(frozen=True, eq=False)
class Doing(Number):
    """A number that does its ``deed`` first; ``expected`` is how long that is said to take.

    Deeds: "fail", "full" (disk), "warn", "print", "exit", "kill N" (its process, the first N times), "wait S",
    "processors" (gives how many it may use, after a moment), "meet FILE OTHER" (goes on when the other has come).
    """

    deed: str = ""
    tolerant_of: bool = False
    expected: float = 1.0

    @property
    def tolerant(self) -> bool:  # type: ignore[override]  # as its settings say
        return self.tolerant_of

    def seconds(self) -> float:
        return self.expected

    def compute(self, work: Work) -> int:
        found = super().compute(work)
        assert self.diary is not None
        word, *rest = self.deed.split()
        match word:
            case "fail":
                raise InvalidData("there is too little of it")
            case "warn":
                warnings.warn("this looks odd", stacklevel=1)
            case "print":
                print("a library says something", flush=True)  # noqa: T201  # that is what is tested
            case "exit":
                sys.exit(5)
            case "kill":
                if self.diary.read_text().count(f" {self.label}\n") <= int(rest[0]):
                    os.kill(os.getpid(), signal.SIGKILL)
            case "wait":
                work.progress(1, 2, "half")
                time.sleep(float(rest[0]))
            case "processors":
                time.sleep(0.3)
                return available_processors()
            case "meet":
                mine, other = (self.diary.with_name(name) for name in rest)
                _meet(mine, other)
                time.sleep(0.5)
                share = available_processors()
                _meet(mine.with_suffix(".seen"), other.with_suffix(".seen"))  # alone, the other would get more
                return share
        return found

    def save(self, value: int, path: Path) -> list[Path]:
        if self.deed == "full":
            raise OSError(28, "No space left on device", str(path))
        return super().save(value, path)


def _meet(mine: Path, other: Path) -> None:
    """Return when the other has come too."""
    mine.touch()
    deadline = time.monotonic() + 60.0
    while not other.exists():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def made(settings: Mapping[str, Any]) -> list[Cell]:
    """Return the cells of ``settings``: label, deed, labels of needs; others where NUMBERS_DIFFER is set."""
    first = 101 if "NUMBERS_DIFFER" in os.environ else 1
    diary = Path(settings["diary"])
    cells: dict[str, Doing] = {}
    for number, (label, deed, needs) in enumerate(settings["cells"], start=first):
        tolerant = label.startswith("tolerant")
        needed = tuple(cells[name] for name in needs)
        cells[label] = Doing(number, needed, label, diary, 0.0, None, deed or "nothing", tolerant)
    return list(cells.values())


def planned(diary: Path, *cells: tuple[str, str, list[str]], after: tuple[str, ...] = ()) -> Plan:
    """Return the plan of ``cells``; those called ``after`` must be there before it can be made again."""
    settings = {"diary": str(diary), "cells": [list(cell) for cell in cells]}
    wanted = made(settings)
    digests = tuple(cell.digest for cell in wanted if cell.name in after)
    return Plan.of(wanted, again=Again(AGAIN, {**settings, "after": list(digests)}, digests))


def made_again(settings: Mapping[str, Any], run: Path) -> Plan:
    """Return the plan, in another process. Raises `InvalidData` while what comes first is not there."""
    if any(Store(run).find(digest) is None for digest in settings["after"]):
        raise InvalidData("it is too early for this plan")
    return Plan.of(made(settings))
