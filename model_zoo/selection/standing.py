"""How the candidates stood: what a model that was chosen tells of the choice."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from model_zoo.selection.candidates import Candidate, structure_of
from model_zoo.selection.choosing import Choice
from sysid_evo.arrays import Array
from sysid_evo.data import Dataset
from sysid_evo.judging import interval


@dataclass(frozen=True)
class Standing:
    """The candidates that were judged, the best first, in what a stored model can hold.

    ``errors`` (n, H) at each of the ``horizons``, ``shares`` (n,) of the mean, 0 for those not kept, and a remark each.
    ``failed`` are those that could not be judged, with the reason. ``gate`` was taken of those in ``means`` (g, 2),
    each with the error of the mean of all inside. ``ahead`` is the 95 % interval by which the second best is worse than
    the best (nothing with one candidate).
    """

    candidates: list[str]
    errors: Array
    shares: Array
    remarks: list[str]
    failed: list[str]
    horizons: list[int]
    gate: float
    means: Array
    ahead: list[float]
    judged_on: str

    @classmethod
    def of(
        cls,
        choice: Choice,
        candidates: Sequence[Candidate],
        weights: Array,
        *,
        left_out: Sequence[str],
        horizons: Sequence[int],
        pairs: Sequence[tuple[Dataset, Dataset]],
    ) -> Self:
        """Sum up a ``choice`` among ``candidates``, the kept of which have these ``weights``."""
        known = {number: error for number, error in enumerate(choice.errors) if error is not None}
        order = sorted(known, key=lambda number: known[number].mean)
        share = dict(zip(choice.kept, weights.tolist(), strict=True))
        kind = {n: structure_of(own[0]) for n, own in zip(choice.kept, choice.models, strict=True)}
        above = f"above {choice.passed.gate:.2f} x the best"
        usable = [number for number in order if not choice.reasons[number]]
        ahead = interval(known[usable[0]], known[usable[1]]) if len(usable) > 1 else ()
        failed = [
            f"{one.name}: {choice.reasons[number]}" for number, one in enumerate(candidates) if number not in known
        ]
        return cls(
            candidates=[candidates[number].name for number in order],
            errors=np.stack([known[number].at for number in order]),
            shares=np.array([share.get(number, 0.0) for number in order]),
            remarks=[choice.reasons[number] or kind.get(number, above) for number in order],
            failed=[*failed, *left_out],
            horizons=list(horizons),
            gate=choice.passed.gate,
            means=np.array(choice.passed.compared),
            ahead=[float(value) for value in ahead],
            judged_on=held_out_in_words(pairs),
        )

    def learned(self) -> dict[str, Any]:
        """Return it as what a model learns, by name."""
        return {f"{name}_": value for name, value in vars(self).items()}

    @classmethod
    def known_to(cls, model: Any) -> Self | None:
        """Undo `learned`: return how the candidates stood when ``model`` was fitted; None before that."""
        if not hasattr(model, "judged_on_"):
            return None
        return cls(**{name: getattr(model, f"{name}_") for name in cls.__dataclass_fields__})

    def rows(self) -> list[dict[str, str]]:
        """Return what to tell of each candidate, the best first."""
        after = f"after {', '.join(map(str, self.horizons))} steps"
        rows = []
        for name, at, weight, remark in zip(self.candidates, self.errors, self.shares, self.remarks, strict=True):
            numbers = {"error": f"{at.mean():.3f}", after: ", ".join(f"{one:.3f}" for one in at)}
            rows.append({"candidate": name, **numbers, "weight": f"{weight:.2f}" if weight else "", "remark": remark})
        for text in self.failed:
            name, _, reason = text.partition(": ")
            rows.append({"candidate": name, "error": "", after: "", "weight": "", "remark": reason})
        return rows

    def sentence(self) -> str:
        """Return what was chosen, by how much, and whether the best is surely better than the second."""
        kept = [
            f"{name} ({at.mean():.3f}, weight {weight:.2f})"
            for name, at, weight in zip(self.candidates, self.errors, self.shares, strict=True)
            if weight > 0.0
        ]
        text = (
            f"kept {len(kept)} of {len(self.candidates)} candidates and is their mean: {', '.join(kept)}; judged by "
            f"free runs of {', '.join(map(str, self.horizons))} steps on {self.judged_on}, kept up to "
            f"{self.gate:.2f} x the lowest error; the mean of those within "
            + ", ".join(f"{gate:.2f} x has {error:.3f}" for gate, error in self.means)
        )
        if self.ahead:
            low, high = self.ahead
            surely = "" if low > 0.0 or high < 0.0 else " not"
            text += (
                f"; the best and the second best candidate do{surely} differ significantly (by {low:+.3f} to "
                f"{high:+.3f}, 95 % interval)"
            )
        elif len(self.candidates) > 1:
            text += "; every other candidate fell out in the first turn"
        return text


def held_out_in_words(pairs: Sequence[tuple[Dataset, Dataset]]) -> str:
    """Return what was held out."""
    seen, held = pairs[0]
    if seen is held:
        return "what they had learned from, which is too short to hold anything back"
    pieces = {name.split("[")[0] for name in seen.names} & {name.split("[")[0] for name in held.names}
    what = "blocks of time" if pieces else "whole recordings"
    return f"{what}, held out in {len(pairs)} turns" if len(pairs) > 1 else f"{what} that were held out"
