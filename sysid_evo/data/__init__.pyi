from .advice import Advice, advise
from .columns import ColumnMap, load_columns
from .dataset import Dataset, Transitions, check_usable
from .preparation import Prepared, RawLog, prepare, take_rows
from .readers import Reader, Table
from .reading import Recording, read_recording
from .response import Delay, find_delays
from .trajectory import Trajectory, Windows

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
