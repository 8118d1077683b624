from .columns import ColumnMap, load_columns
from .dataset import Dataset, Transitions, check_usable
from .preparation import PreparedLog, RawLog, prepare, rows_as_episodes
from .quality import RecordingQuality, recording_quality
from .readers import Reader, Table
from .reading import Recording, read_recording
from .response import Delay, find_delays
from .trajectory import Trajectory, Windows

__all__ = [
    "ColumnMap",
    "Dataset",
    "Delay",
    "PreparedLog",
    "RawLog",
    "Reader",
    "Recording",
    "RecordingQuality",
    "Table",
    "Trajectory",
    "Transitions",
    "Windows",
    "check_usable",
    "find_delays",
    "load_columns",
    "prepare",
    "read_recording",
    "recording_quality",
    "rows_as_episodes",
]
