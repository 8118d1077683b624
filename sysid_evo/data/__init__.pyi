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
from .usable import check_usable
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
    "check_usable",
    "find_delays",
    "load_columns",
    "prepare",
    "read_recording",
    "take_rows",
]
