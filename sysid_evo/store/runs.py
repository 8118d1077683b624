"""A run folder: what was asked for, what is done, and where its files stand."""

from __future__ import annotations

import json
import time
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tomli_w

from sysid_evo.errors import ArtefactError, InvalidArgument
from sysid_evo.files import write_atomically
from sysid_evo.store.manifest import versions

SETTINGS, STATUS, LOG = "experiment.toml", "run.json", "log.jsonl"


@dataclass(frozen=True)
class RunFolder:
    """``experiment.toml``, ``run.json`` (versions, status of every cell) and ``log.jsonl`` in ``path``.

    Models stand in ``models/``, controllers in ``controllers/``, each with the seed in its name.
    """

    path: Path

    @classmethod
    def open(cls, path: str | Path, settings: Mapping[str, Any]) -> RunFolder:
        """Create the folder of a new run, or return to one with the same ``settings``.

        Raises `InvalidArgument` if the folder holds a run with other settings.
        """
        run = cls(Path(path))
        wanted = tomllib.loads(tomli_w.dumps(_without_none(settings)))
        if run._file(SETTINGS).is_file():
            found = run.settings() or {}
            differing = sorted(key for key in {*found, *wanted} if found.get(key) != wanted.get(key))
            if differing:
                raise InvalidArgument(
                    f"{run.path} holds another run: {', '.join(differing)} differ. "
                    "Choose another folder with --out, or repeat the same settings to go on with it."
                )
            return run
        run.path.mkdir(parents=True, exist_ok=True)
        write_atomically(run._file(SETTINGS), lambda file: file.write_text(tomli_w.dumps(wanted)))
        run._write({"versions": versions(), "cells": {}})
        return run

    def settings(self) -> dict[str, Any] | None:
        """Return what the run was opened with; None for a folder that was never opened. Raises `ArtefactError`."""
        try:
            return tomllib.loads(self._file(SETTINGS).read_text())
        except FileNotFoundError:
            return None
        except ValueError as error:
            raise ArtefactError(f"{self._file(SETTINGS)}: not a readable TOML file: {error}") from error

    def cells(self) -> dict[str, dict[str, Any]]:
        """Return the status of every cell that was tried: status, reason, and the seconds it took."""
        try:
            found: dict[str, dict[str, Any]] = json.loads(self._file(STATUS).read_text())["cells"]
        except FileNotFoundError:
            return {}
        except (ValueError, KeyError, TypeError) as error:
            raise ArtefactError(f"{self._file(STATUS)}: not a readable status file: {error}") from error
        return found

    def record(self, cell: str, *, seconds: float, reason: str | None = None) -> None:
        """Record that ``cell`` is done, or failed for ``reason``."""
        cells = self.cells()
        cells[cell] = {"status": "failed" if reason else "done", "reason": reason, "timings": {"seconds": seconds}}
        self._write({"versions": versions(), "cells": cells})
        with self._file(LOG).open("a") as log:
            log.write(json.dumps({"time": time.time(), "cell": cell, **cells[cell]}) + "\n")

    def model(self, family: str, seed: int) -> Path:
        """Where the model of ``family`` stands (without suffix)."""
        return self.path / "models" / f"{family}-{seed}"

    def controller(self, name: str, seed: int) -> Path:
        """Where the champion ``name`` stands (without suffix)."""
        return self.path / "controllers" / f"{name}-{seed}".replace(":", "-")

    def _file(self, name: str) -> Path:
        return self.path / name

    def _write(self, status: dict[str, Any]) -> None:
        text = json.dumps(status, indent=1, allow_nan=False)
        write_atomically(self._file(STATUS), lambda file: file.write_text(text))


def _without_none(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _without_none(item) for key, item in value.items() if item is not None}
    if isinstance(value, (list, tuple)):
        return [_without_none(item) for item in value]
    return value
