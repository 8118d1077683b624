"""What ``report.json`` is made of: classes that take results in, write strict JSON, and check what is read."""

from __future__ import annotations

import math
from typing import Annotated, Any, Self, TypeAlias

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict

from evaluation.storage import plain


class Part(BaseModel):
    """A part of a document; it is made from results by the names of their attributes.

    Unknown keys are ignored, as a later version may add some.
    """

    model_config = ConfigDict(
        frozen=True, from_attributes=True, allow_inf_nan=False, json_schema_serialization_defaults_required=True
    )

    @classmethod
    def made_of(cls, result: Any, **others: Any) -> Self:
        """Return the part with the attributes of ``result``; ``others`` are added, or taken instead."""
        found = {name: getattr(result, name) for name in cls.model_fields if name not in others}
        return cls.model_validate({**found, **others})


def _known(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _listed(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray) else value


Number: TypeAlias = Annotated[float | None, BeforeValidator(_known)]
"""A number; null if it is not known (NaN or infinity in the results)."""
Numbers: TypeAlias = Annotated[tuple[Number, ...], BeforeValidator(_listed)]
Interval: TypeAlias = tuple[Number, Number]
"""The lower and the upper end."""
Options: TypeAlias = Annotated[dict[str, Any], BeforeValidator(plain)]
"""Settings of any kind by their names."""


class EstimatePart(Part):
    """A fitness, a share, or a difference of two; null where the uncertainty is not known, as for a single trial."""

    value: Number
    standard_error: Number
    low: Number
    high: Number
