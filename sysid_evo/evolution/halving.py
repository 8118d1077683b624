"""Successive halving: several searches begin, and the better half of them continues, until one is left."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate

import numpy as np

from sysid_evo.errors import InvalidArgument, did_you_mean
from sysid_evo.registry.grammar import Spec, split_specs
from sysid_evo.registry.registry import controllers, strategies
from sysid_evo.types import Converted


@dataclass(frozen=True)
class Start:
    """One way to begin a search: a controller and an evolution strategy, each a spec or its text."""

    controller: Converted[Spec | str, Spec] = Converted(controllers.check, "recurrent")
    strategy: Converted[Spec | str, Spec] = Converted(strategies.check, "cma_es")

    @classmethod
    def listed(cls, given: Sequence[Start] | str) -> tuple[Start, ...]:
        """Return the starts; text is parsed: ``start(controller=..., strategy=...), start(...)``, empty for none.

        Raises `InvalidArgument`.
        """
        if not isinstance(given, str):
            return tuple(given)
        names, found = ("controller", "strategy"), []
        for spec in map(Spec.parse, split_specs(given) if given else ()):
            unknown = [one for one in spec.parameters if one not in names]
            if spec.name != "start" or unknown:
                hint = did_you_mean(unknown[0], names) if unknown else ""
                expected = ", ".join(f"{one}=SPEC" for one in names)
                raise InvalidArgument(f"starts: expected start({expected}), got {spec}.{hint}")
            try:
                found.append(cls(**spec.parameters))
            except (TypeError, AttributeError) as error:
                raise InvalidArgument(f"starts: {spec} cannot be read: {error}") from error
        return tuple(found)


@dataclass(frozen=True)
class Halving:
    """The runs of a search with ``starts`` starts in ``generations`` generations in total.

    Every rung takes the same number of generations, shared equally by its runs. The better half of the runs of a rung
    continue in the next one, and the last rung has one run. A start that rises fast is therefore found at a small cost,
    and most generations are spent where fitness still rises. Source: Jamieson and Talwalkar 2016 (arXiv:1502.07943).
    """

    starts: int
    generations: int

    def __post_init__(self) -> None:
        least = sum(self.sizes)
        if self.generations < least:
            raise InvalidArgument(
                f"starts: expected at least {least} generations to compare {self.starts} starts, got {self.generations}"
            )

    @property
    def sizes(self) -> tuple[int, ...]:
        """Number of runs of each rung."""
        found = [self.starts]
        while found[-1] > 1:
            found.append((found[-1] + 1) // 2)
        return tuple(found)

    @property
    def lengths(self) -> tuple[int, ...]:
        """Number of generations of each run, rung by rung."""
        sizes = self.sizes
        rung = self.generations / len(sizes)
        return tuple(max(1, int(rung / size)) for size in sizes for _ in range(size))

    @property
    def longest(self) -> int:
        """Number of generations of a start that reaches the last rung."""
        first = [0, *accumulate(self.sizes)][:-1]
        return sum(self.lengths[run] for run in first)

    def lineage(self, run: int, fitness: Sequence[float]) -> tuple[int, ...]:
        """Return the runs that ``run`` continues, first rung first, itself last; the first is the number of its start.

        ``fitness`` is the best fitness of every earlier run.
        """
        ends = tuple(accumulate(self.sizes))
        rung = int(np.searchsorted(ends, run, side="right"))
        if rung == 0:
            return (run,)
        first = ends[rung - 1] - self.sizes[rung - 1]
        best_first = np.argsort(-np.asarray(fitness[first : ends[rung - 1]]), kind="stable")
        continued = first + int(best_first[run - ends[rung - 1]])
        return (*self.lineage(continued, fitness), run)
