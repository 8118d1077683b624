"""The law of a grey box over lanes: a function of plain numbers, repeated, with delay and lags around it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar


@dataclass(frozen=True)
class LawOverLanes:
    """A predictor of d/dt of the extended state of a `model_zoo.grey.structure.Structure`.

    Its parameters are those of the law, 1 / lag of every actuator, and the share of each sample of the delay.
    """

    function: Callable[..., Any]
    law_rows: tuple[int, ...]
    rate_rows: tuple[int, ...]
    known: tuple[tuple[int, int], ...]
    controls: tuple[int, ...]
    actuator_rows: tuple[int, ...]
    n_own: int
    nx: int
    nu: int
    delay: int

    bindings: ClassVar[Mapping[str, Any]] = {}

    def write(self, inner: str, name: str) -> str:
        """Return the text of the block function around the law called ``inner``."""
        lines = [f"def {name}(x, u, p, y, scratch):", "    for lane in range(LANES):"]
        shares = self.n_own + len(self.actuator_rows)
        for i, control in enumerate(self.controls):
            terms = [f"u[{control} * LANES + lane]" + (f" * p[{shares}]" if self.delay else "")]
            for lag in range(self.delay):
                row = self.nx + lag * self.nu + control
                terms.append(f"x[{row} * LANES + lane] * p[{shares + 1 + lag}]")
            lines.append(f"        commanded_{i} = {' + '.join(terms)}")
        acting = [f"x[{row} * LANES + lane]" for row in self.actuator_rows]
        acting = acting or [f"commanded_{i}" for i in range(len(self.controls))]
        state = _tuple(f"x[{row} * LANES + lane]" for row in self.law_rows)
        own = _tuple(f"p[{i}]" for i in range(self.n_own))
        lines.append(f"        rate = {inner}({state}, {_tuple(acting)}, {own})")
        lines += [f"        y[{row} * LANES + lane] = rate[{i}]" for i, row in enumerate(self.rate_rows)]
        lines += [f"        y[{row} * LANES + lane] = x[{speed} * LANES + lane]" for row, speed in self.known]
        for i, row in enumerate(self.actuator_rows):
            here = f"[{row} * LANES + lane]"
            lines.append(f"        y{here} = (commanded_{i} - x{here}) * p[{self.n_own + i}]")
        return "\n".join(lines)


def _tuple(items: Any) -> str:
    return "(" + "".join(f"{item}, " for item in items) + ")"
