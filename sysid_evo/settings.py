"""Settings classes: what a field is for, the option of the command line that sets it, and times with a unit."""

from __future__ import annotations

import re
from typing import Annotated, Any, NamedTuple, TypeAlias

from pydantic import BaseModel, BeforeValidator, Field

from sysid_evo.errors import InvalidArgument

UNITS = {"ms": 1e-3, "s": 1.0, "min": 60.0, "m": 60.0, "h": 3600.0}
"""Seconds in each unit of time."""


class OptionInfo(NamedTuple):
    """How the command line shows a setting: panel of the help page and metavar of the value.

    ``option`` differs if it is not called as the setting, ``kind`` is the registered kind that a value names, ``shown``
    the default to show instead of the setting's own. Without a panel a setting is no option.
    """

    panel: str
    metavar: str
    option: str
    kind: str
    shown: str


def setting(
    default: Any, description: str, panel: str = "", metavar: str = "", *, option: str = "", kind: str = "",
    shown: str = "", **limits: Any,
) -> Any:  # fmt: skip
    """Return a pydantic field with a ``description`` and its `OptionInfo`; ``limits`` are those of `pydantic.Field`.

    The description has no full stop and no default: the help page adds both.
    """
    info: Any = {"option": list(OptionInfo(panel, metavar, option, kind, shown))}
    return Field(default, description=description, json_schema_extra=info, **limits)


def option_of(model: type[BaseModel], name: str) -> OptionInfo:
    """Return how the command line shows the setting ``name`` of a settings class."""
    extra: Any = model.model_fields[name].json_schema_extra
    return OptionInfo(*extra["option"])


def seconds(text: str) -> float:
    """Return a time such as ``50ms``, ``0.05s``, ``5m`` or ``1h`` in seconds. Raises `InvalidArgument`."""
    found = re.fullmatch(r"(\d+(?:\.\d*)?|\.\d+)\s*([a-z]*)", text.strip())
    if found is not None and found[2] in UNITS:
        return float(found[1]) * UNITS[found[2]]
    if found is not None and not found[2]:
        raise InvalidArgument(f"expected a time with a unit, such as {found[1]}ms or {found[1]}s, got {text!r}")
    raise InvalidArgument(f"expected a time, such as 50ms, 0.05s, 5m or 1h, got {text!r}")


Seconds: TypeAlias = Annotated[
    float, BeforeValidator(lambda value: seconds(value) if isinstance(value, str) else value)
]
"""A time in seconds: a number, or a text with a unit."""
