"""The axes of a study: a setting of experiments, its values, and what each of them is called in tables."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from evaluation.comparison import Experiment
from sysid_evo.errors import InvalidArgument

RANGE = re.compile(r"(?P<before>[^.]*?)(?P<first>\d+)\.\.(?P<last>\d+)(?P<after>[^.]*)")
RANGED = ("seed", "robot")
"""Settings whose values may be ranges."""
LEFT_OUT = ("title", "data_digest", "plugins")
"""Settings that are no axis: they change nothing, are written by the program, or concern all points."""


@dataclass(frozen=True)
class Axis:
    """One setting of experiments and its ``values``, each behind its label."""

    setting: str
    values: Mapping[str, Any]

    @classmethod
    def of(cls, setting: str, given: Any) -> Axis:
        """Return the axis that a study gives as a list, a range, or a table of named values.

        Raises `InvalidArgument` that says what is wrong with it.
        """
        where = f"grid.{setting}"
        if setting not in Experiment.model_fields or setting in LEFT_OUT:
            raise InvalidArgument(f"{where}: {_no_axis(setting)}")
        if isinstance(given, Mapping):
            pairs = [(str(label), value) for label, value in given.items()]
        else:
            listed = list(given) if isinstance(given, Sequence) and not isinstance(given, str) else [given]
            pairs = [(label_of(value), value) for one in listed for value in _ranged(setting, one, where)]
            if not isinstance(given, (list, tuple)) and len(pairs) < 2:
                raise InvalidArgument(
                    f'{where}: expected a list of values, a range such as "0..4" or a table of named values, '
                    f"got {given!r}; what all points share stands under [experiment]"
                )
        if not pairs:
            raise InvalidArgument(f"{where}: expected at least one value, got none")
        _check_distinct(where, pairs)
        for _, value in pairs:
            try:
                Experiment.of({setting: value})
            except InvalidArgument as error:
                raise InvalidArgument(f"grid.{error}") from error
        return cls(setting, dict(pairs))


def label_of(value: Any) -> str:
    """Return what a value is called that has no name of its own."""
    if isinstance(value, (list, tuple)):
        return ", ".join(map(label_of, value)) or "none"
    return str(value).lower() if isinstance(value, bool) else str(value)


def _ranged(setting: str, value: Any, where: str) -> list[Any]:
    """Return the values of a range ``A..B``, both included; anything else is one value."""
    found = RANGE.fullmatch(value) if isinstance(value, str) and setting in RANGED else None
    if found is None:
        return [value]
    first, last = int(found["first"]), int(found["last"])
    if last < first:
        raise InvalidArgument(f"{where}: expected a range from the lower to the higher number, got {value!r}")
    texts = [f"{found['before']}{number}{found['after']}" for number in range(first, last + 1)]
    return [int(text) for text in texts] if setting == "seed" and all(map(str.isdecimal, texts)) else texts


def _check_distinct(where: str, pairs: Sequence[tuple[str, Any]]) -> None:
    """Raise `InvalidArgument` where two values, or two labels, are the same."""
    values, labels = [value for _, value in pairs], [label for label, _ in pairs]
    for label, value in pairs:
        if values.count(value) > 1:
            raise InvalidArgument(f"{where}: {label_of(value)!r} stands there twice")
        if labels.count(label) > 1:
            raise InvalidArgument(f"{where}: two values are called {label!r}; name them, such as {{a = ..., b = ...}}")


def _no_axis(setting: str) -> str:
    import difflib

    if setting in LEFT_OUT:
        return "cannot be an axis" + ("; name it under [experiment]" if setting == "plugins" else "")
    close = difflib.get_close_matches(setting, Experiment.model_fields, n=1)
    return "is no setting of an experiment" + (f"; did you mean {close[0]}?" if close else "")
