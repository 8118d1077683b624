"""One thing that limits a model, in a sentence with numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

MOST = 5
"""Remarks that are made at most: a list that is longer is not read."""


@dataclass(frozen=True)
class Remark:
    """What limits a model, or what is known of its limits, under one ``topic``.

    ``weight`` orders remarks: about the share of the error, or of the time, that is at stake, 0 to 1. ``figures`` are
    the numbers in the sentence.
    """

    topic: str
    sentence: str
    weight: float
    figures: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class ModelAdvice:
    """The remarks on ``model``, the most important first; ``judged_on`` says which data it was judged on."""

    model: str
    remarks: tuple[Remark, ...]
    judged_on: str = ""


def advice_to_json(advice: ModelAdvice) -> dict[str, Any]:
    """Return the advice as strict JSON."""
    remarks = [
        {"topic": one.topic, "sentence": one.sentence, "weight": one.weight, "figures": dict(one.figures)}
        for one in advice.remarks
    ]
    return {"model": advice.model, "judged_on": advice.judged_on, "remarks": remarks}


def advice_from_json(value: Mapping[str, Any]) -> ModelAdvice:
    """Undo `advice_to_json`."""
    return ModelAdvice(value["model"], tuple(Remark(**remark) for remark in value["remarks"]), value["judged_on"])
