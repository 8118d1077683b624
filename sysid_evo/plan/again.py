"""How another process comes to the same plan: by making it again of the settings that it was made of."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sysid_evo.plan.plan import Plan


@dataclass(frozen=True)
class Again:
    """The ``function``, ``module:name``, that makes a plan of ``settings``, strict JSON, and the folder of the run.

    ``after`` are the digests of cells whose results must stand in the run before that.
    """

    function: str
    settings: Mapping[str, Any]
    after: tuple[str, ...] = ()

    def prepare(self) -> None:
        """Import what the plan is made with."""
        importlib.import_module(self.function.partition(":")[0])

    def plan(self, folder: Path) -> Plan:
        """Return the plan, made again. Raises what the function does."""
        module, _, name = self.function.partition(":")
        made: Plan = getattr(importlib.import_module(module), name)(self.settings, folder)
        return made
