from .columns import ColumnMap, load_columns
from .dataset import Dataset, Transitions
from .frames import HEADER, SAMPLES, is_stored_dataset
from .preparation import PreparedLog, RawLog, prepare, rows_as_episodes
from .quality import RecordingQuality, recording_quality
from .readers import Reader, Table
from .reading import Recording, read_recording
from .response import Delay, find_delays
from .timing import ControlTiming, control_timing
from .trajectory import Trajectory, Windows
from .usable import check_usable

__all__ = [
    "HEADER",
    "SAMPLES",
    "ColumnMap",
    "ControlTiming",
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
    "control_timing",
    "find_delays",
    "is_stored_dataset",
    "load_columns",
    "prepare",
    "read_recording",
    "recording_quality",
    "rows_as_episodes",
]
