"""Controllers: control laws whose parameters are evolved."""

from sysid_evo.controllers.controller import Controller, View, make_controller
from sysid_evo.controllers.linear import LinearFeedback
from sysid_evo.controllers.networks import FeedForward, RecurrentNetwork
from sysid_evo.controllers.pid import Pid
from sysid_evo.controllers.program import Program, Statement
from sysid_evo.controllers.pursuit import Pursuit

__all__ = [
    "Controller",
    "FeedForward",
    "LinearFeedback",
    "Pid",
    "Program",
    "Pursuit",
    "RecurrentNetwork",
    "Statement",
    "View",
    "make_controller",
]
