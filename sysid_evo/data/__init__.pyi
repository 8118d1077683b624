"""Recordings: episodes, data sets, readers, preparation."""

from .advice import Advice, advise
from .columns import ColumnMap, load_columns
from .dataset import Dataset, Transitions
from .delays import Delay, find_delays
from .preparation import Prepared, prepare
from .raw import RawLog
from .reading import Recording, read_recording
from .sampled import take_rows
from .tables import Reader, Table
from .trajectory import Trajectory
from .windows import Windows

__all__ = [
    "Advice",
    "ColumnMap",
    "Dataset",
    "Delay",
    "Prepared",
    "RawLog",
    "Reader",
    "Recording",
    "Table",
    "Trajectory",
    "Transitions",
    "Windows",
    "advise",
    "find_delays",
    "load_columns",
    "prepare",
    "read_recording",
    "take_rows",
]
