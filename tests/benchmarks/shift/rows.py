"""What was measured, a row for each case, family and seed: written, read from several files, put into tables."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from sysid_evo.files import write_atomically

MARKED = 20
"""Steps at which adaptation is judged."""
WAYS = ("before", "10 s", "30 s", "scratch", "in-domain")
CASES_ABREAST = 4
TAKEN, NEAR, WORSE, EARLY_WORSE = 0.40, 0.15, 0.01, 0.03
"""Aims: where the condition has changed, an error lower by this share after 30 s, or this close to a fit there; where
it has not, the largest increase after 30 s; and in all cases the largest increase after 10 s."""
STRONG = 1.5
"""A change is strong if the error is at least this multiple of that of a fit there."""


@dataclass(frozen=True)
class Row:
    """N of each way after each number of steps, ``n[way][steps]``, and the decision after 30 s."""

    case: str
    shifted: bool
    family: str
    preset: str
    seed: int
    n: Mapping[str, Mapping[int, float]]
    note: str = ""

    def at(self, way: str, steps: int = MARKED) -> float:
        """Return N of ``way``; nan if it was not measured."""
        return self.n.get(way, {}).get(steps, float("nan"))

    def change(self, way: str, against: str = "before", steps: int = MARKED) -> float:
        """Return by which share N of ``way`` is higher than that of ``against``."""
        return self.at(way, steps) / self.at(against, steps) - 1.0


def write_rows(file: Path, rows: Sequence[Row]) -> None:
    """Write ``rows`` as JSON."""
    text = json.dumps([asdict(row) for row in rows], indent=1, allow_nan=False) + "\n"
    write_atomically(file, lambda path: path.write_text(text))


def read_rows(files: Iterable[Path]) -> list[Row]:
    """Return the rows of ``files``; of the same case, family, preset and seed the last."""
    found: dict[tuple[str, str, str, int], Row] = {}
    for file in files:
        for stored in json.loads(file.read_text()):
            n = {way: {int(steps): float(x) for steps, x in at.items()} for way, at in stored["n"].items()}
            row = Row(**{**stored, "n": n})
            found[row.case, row.family, row.preset, row.seed] = row
    return list(found.values())


def errors_table(rows: Sequence[Row]) -> str:
    """Return Markdown tables of N at 20 steps, a line for each family, four cases side by side, means over the seeds.

    A cell holds N before, after 10 s, after 30 s, of a fit to the same 30 s alone and of a fit in-domain.
    """
    found = _grouped(rows)
    cases, families = list(dict.fromkeys(row.case for row in rows)), dict.fromkeys(row.family for row in rows)
    tables = []
    for some in (cases[first : first + CASES_ABREAST] for first in range(0, len(cases), CASES_ABREAST)):
        lines = [f"| family | {' | '.join(some)} |", f"|---|{'---|' * len(some)}"]
        for family in families:
            cells = [_figures(found.get((case, family), [])) for case in some]
            lines += [f"| `{family}` | {' | '.join(cells)} |"] if any(cells) else []
        tables.append("\n".join(lines))
    return "\n\n".join(tables)


def _figures(rows: Sequence[Row]) -> str:
    """Return N of each way without leading zeros, a dash for what was not measured; nothing if there are no rows."""
    means = [np.mean([row.at(way) for row in rows]) if rows else np.nan for way in WAYS]
    return " ".join("-" if np.isnan(mean) else f"{mean:.2f}".removeprefix("0") for mean in means) if rows else ""


def verdicts_table(rows: Sequence[Row]) -> str:
    """Return a Markdown table: how each family compares with the aims at 20 steps.

    Changed cases, means over the seeds: their number; in how many 30 s of adaptation, and in how many a fit to minutes
    there, lower the error by 40 %; the smallest reduction; in how many the error is within 15 % of that fit, and the
    largest distance above it; in how many one of the two holds. Then unchanged cases and seeds with the largest
    increase in one of them; strongly changed cases and seeds and how many were adapted after 10 s; all cases after
    10 s with the largest increase. An exclamation mark is a missed aim.
    """
    families: dict[str, list[Row]] = defaultdict(list)
    for row in rows:
        families[row.family].append(row)
    lines = [
        "| family | seeds | changed | 40 % lower | a new fit 40 % lower | least | within 15 % | largest excess "
        "| either | unchanged | worst | strong | adapted after 10 s | after 10 s | worst |",
        f"|{'---|' * 15}",
    ]
    for family, own in families.items():
        shifted = [_mean(seeds) for seeds in _grouped([row for row in own if row.shifted]).values()]
        taken = [-row.change("30 s") for row in shifted]
        far = [row.change("30 s", "in-domain") for row in shifted]
        same = [row.change("30 s") for row in own if not row.shifted]
        early = [row.change("10 s") for row in own]
        strong = [row for row in own if row.shifted and row.at("before") >= STRONG * row.at("in-domain")]
        either = sum(one >= TAKEN or other <= NEAR for one, other in zip(taken, far, strict=True))
        figures = [
            f"`{family}`",
            f"{len({row.seed for row in own})}",
            f"{len(shifted)}",
            f"{sum(one >= TAKEN for one in taken)}",
            f"{sum(-row.change('in-domain') >= TAKEN for row in shifted)}",
            _percent(min(taken, default=np.nan)),
            f"{sum(one <= NEAR for one in far)}",
            _percent(max(far, default=np.nan), sign=True),
            f"{either}",
            f"{len(same)}",
            _worst(same, WORSE),
            f"{len(strong)}",
            f"{sum(row.at('10 s') != row.at('before') for row in strong)}",
            f"{len(early)}",
            _worst(early, EARLY_WORSE),
        ]
        lines.append(f"| {' | '.join(figures)} |")
    return "\n".join(lines)


def _worst(changes: Sequence[float], allowed: float) -> str:
    """Return the largest of ``changes``, marked if it is more than ``allowed``."""
    worst = max(changes, default=np.nan)
    return _percent(worst, sign=True) + (" !" if worst > allowed else "")


def _grouped(rows: Sequence[Row]) -> dict[tuple[str, str], list[Row]]:
    """Return the rows of all seeds of each case and family."""
    found: dict[tuple[str, str], list[Row]] = defaultdict(list)
    for row in rows:
        found[row.case, row.family].append(row)
    return found


def _mean(rows: Sequence[Row]) -> Row:
    """Return one row with the means over ``rows``, which differ in their seeds."""
    first = rows[0]
    n = {way: {k: float(np.mean([row.at(way, k) for row in rows])) for k in at} for way, at in first.n.items()}
    return Row(first.case, first.shifted, first.family, first.preset, first.seed, n)


def _percent(share: float, *, sign: bool = False) -> str:
    if np.isnan(share):
        return ""
    return f"{100.0 * share:+.0f} %" if sign else f"{100.0 * share:.0f} %"
