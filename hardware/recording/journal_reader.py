"""Journals among the logs that `sysid-evo import` and `inspect` read."""

from __future__ import annotations

import difflib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hardware.recording.journal import SUFFIX, read_journal
from hardware.recording.raw_log import rows_of
from sysid_evo.data.tables import Reader, Table
from sysid_evo.errors import InvalidData
from sysid_evo.registry import register_reader
from sysid_evo.system import System


@register_reader("journal")
class JournalReader(Reader):
    """A recorder's journal as a table: ``t``, the pose and the controls under the names of its system.

    Rows are numbered by frame, the first being 1; frames that the gate drops are left out.
    """

    suffixes = (SUFFIX,)

    def header(self, path: Path) -> tuple[str, ...]:
        return column_names(read_journal(path).system)

    def read(self, path: Path, columns: Sequence[str]) -> Table:
        journal = read_journal(path)
        names = column_names(journal.system)
        for name in columns:
            if name not in names:
                close = difflib.get_close_matches(name, names, n=1)
                hint = f" Did you mean {close[0]!r}?" if close else ""
                raise InvalidData(
                    f"{path.name}: column {name!r} is missing.{hint} The journal has: {', '.join(names)}."
                )
        log, rows = rows_of(journal)
        values = np.column_stack([log.time, log.pose, log.controls])
        data = {name: values[:, names.index(name)].copy() for name in columns}
        return Table(path, rows, data)


def column_names(system: System) -> tuple[str, ...]:
    """Return the columns of a raw log: ``t`` in s, the pose, the controls."""
    pose_names = () if system.motion is None else system.motion.pose_names
    return ("t", *pose_names, *system.control_names)
