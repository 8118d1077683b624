"""How another process comes to the same plan: by making it again of the settings that it was made of."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sysid_evo.plan.plan import Plan


@dataclass(frozen=True)
class Again:
    """The ``function``, ``module:name``, that makes a plan of ``settings``, strict JSON, and the folder of the run.

    Whatever else it reads is named here, so that it can be sent to a machine that does not see the folder: ``after``
    are the digests of cells whose results must stand in the run before that, ``inside`` the folders of the run whose
    files it reads. ``files`` are texts in the settings that name files elsewhere, and the files that belong to each.
    """

    function: str
    settings: Mapping[str, Any]
    after: tuple[str, ...] = ()
    inside: tuple[str, ...] = ()
    files: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    def prepare(self) -> None:
        """Import what the plan is made with."""
        importlib.import_module(self.function.partition(":")[0])

    def plan(self, folder: Path) -> Plan:
        """Return the plan, made again. Raises what the function does."""
        module, _, name = self.function.partition(":")
        made: Plan = getattr(importlib.import_module(module), name)(self.settings, folder)
        return made

    def with_files_at(self, places: Mapping[str, str]) -> Again:
        """Return the same with other names of files in the settings: ``places`` has one for each that it had."""
        return replace(self, settings=_renamed(self.settings, places), files={})


def _renamed(value: Any, places: Mapping[str, str]) -> Any:
    if isinstance(value, str):
        return places.get(value, value)
    if isinstance(value, Mapping):
        return {key: _renamed(item, places) for key, item in value.items()}
    return [_renamed(item, places) for item in value] if isinstance(value, (list, tuple)) else value
