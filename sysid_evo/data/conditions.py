"""Which recordings belong to one condition: a day, a floor, a battery."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase

from sysid_evo.data.dataset import Dataset
from sysid_evo.errors import InvalidArgument


def labelled(dataset: Dataset, patterns: Mapping[str, str]) -> Dataset:
    """Do what `Dataset.labelled` says."""
    found: dict[str, str] = {}
    for name, pattern in patterns.items():
        fitting = [e.name for e in dataset if fnmatchcase(e.name.split("[")[0], pattern)]
        if not fitting:
            raise InvalidArgument(
                f"condition {name!r}: no episode fits {pattern!r}; there are {', '.join(dataset.names)}"
            )
        twice = [episode for episode in fitting if found.get(episode, name) != name]
        if twice:
            raise InvalidArgument(f"condition {name!r}: {twice[0]!r} fits the pattern of {found[twice[0]]!r} as well")
        found.update(dict.fromkeys(fitting, name))
    return dataset.with_episodes([replace(e, condition=found.get(e.name, e.condition)) for e in dataset])


def parsed(option: str, given: Sequence[str]) -> dict[str, str]:
    """Return patterns by condition from texts ``NAME=PATTERN``. Raises `InvalidArgument` that names the option."""
    patterns = {}
    for text in given:
        name, equals, pattern = text.partition("=")
        if not (name and equals and pattern):
            raise InvalidArgument(f"{option}: expected NAME=PATTERN, such as wet='rain_*', got {text!r}")
        if name in patterns:
            raise InvalidArgument(f"{option}: {name!r} is given twice")
        patterns[name] = pattern
    return patterns
