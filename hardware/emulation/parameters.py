"""Parameters of an emulated robot: each with its unit, its reason, and its spread between robots of a kind."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from typing import Any, Self, TypeVar

import numpy as np

from hardware.arguments import check_integer
from sysid_evo.errors import InvalidArgument


def parameter(value: float, unit: str, spread: float, reason: str, *, or_zero: bool = False) -> Any:
    """Return a field whose perturbed value is within ``spread`` (a share) of ``value``."""
    return field(default=value, metadata={"unit": unit, "spread": spread, "reason": reason, "or_zero": or_zero})


@dataclass(frozen=True, kw_only=True)
class RobotParameters:
    """Positive numbers (some may be 0), each a `parameter`: unit, spread, reason are its metadata.

    Raises `InvalidArgument`.
    """

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            least = ">=" if item.metadata["or_zero"] else ">"
            if not (np.isfinite(value) and (value > 0.0 or (least == ">=" and value == 0.0))):
                raise InvalidArgument(
                    f"{type(self).__name__}: expected {item.name} {least} 0 {item.metadata['unit']}, got {value}"
                )

    def perturbed(self, seed: int) -> Self:
        """Return another robot of the kind: every field uniform within its spread around this one's."""
        rng = np.random.default_rng(seed)
        drawn = {
            item.name: getattr(self, item.name) * (1.0 + item.metadata["spread"] * rng.uniform(-1.0, 1.0))
            for item in fields(self)
        }
        return replace(self, **drawn)


LARGEST_SEED = 2**64 - 1
P = TypeVar("P", bound=RobotParameters)


def of_kind(name: str, nominal: P, seed: int | None) -> tuple[str, P]:
    """Return name and parameters of the registered robot ``name``; with a ``seed``, of a variant of it."""
    if seed is None:
        return name, nominal
    check_integer(f"robot {name}: seed", seed, minimum=0, maximum=LARGEST_SEED)
    return f"{name}:{seed}", nominal.perturbed(seed)
