"""Controllers: control laws whose parameters are evolved."""

from sysid_evo.controllers.controller import Controller, View
from sysid_evo.controllers.feed_forward import FeedForward
from sysid_evo.controllers.linear import LinearFeedback
from sysid_evo.controllers.pid import Pid
from sysid_evo.controllers.predictive import Predictive
from sysid_evo.controllers.pursuit import Pursuit
from sysid_evo.controllers.recurrent import RecurrentNetwork

__all__ = ["Controller", "FeedForward", "LinearFeedback", "Pid", "Predictive", "Pursuit", "RecurrentNetwork", "View"]
