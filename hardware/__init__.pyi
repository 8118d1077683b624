from .connection import GateLimits
from .driving.controller_driving import play_back, shown_live
from .driving.hand_driving import HandTrial, check_driving_by_hand, driven_by_hand
from .driving.server import PageAddress, check_page
from .driving.trials import RobotRunner
from .emulation.simulated_robot import in_real_time
from .emulation.tracked_robots import ModelRobot
from .preflight import check_driving, check_recording
from .recording.journal import JOURNALS, Recorder, recorder_of
from .recording.record import save_raw_log, store_journals
from .robot import Robot, find_robot
from .run_report import LoopReport, StopReason, StopRequest
from .testing import CONTRACTS

__all__ = [
    "CONTRACTS",
    "JOURNALS",
    "GateLimits",
    "HandTrial",
    "LoopReport",
    "ModelRobot",
    "PageAddress",
    "Recorder",
    "Robot",
    "RobotRunner",
    "StopReason",
    "StopRequest",
    "check_driving",
    "check_driving_by_hand",
    "check_page",
    "check_recording",
    "driven_by_hand",
    "find_robot",
    "in_real_time",
    "play_back",
    "recorder_of",
    "save_raw_log",
    "shown_live",
    "store_journals",
]
