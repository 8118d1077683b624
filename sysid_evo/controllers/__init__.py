"""Controllers: control laws whose parameters are evolved."""

from sysid_evo.controllers.controller import Controller, View
from sysid_evo.controllers.linear import LinearFeedback
from sysid_evo.controllers.networks import FeedForward, RecurrentNetwork
from sysid_evo.controllers.pid import Pid
from sysid_evo.controllers.pursuit import Pursuit

__all__ = [
    "Controller",
    "FeedForward",
    "LinearFeedback",
    "Pid",
    "Pursuit",
    "RecurrentNetwork",
    "View",
]
