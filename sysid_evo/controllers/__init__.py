"""Controllers: control laws whose parameters are evolved."""

from sysid_evo.controllers.controller import Controller, View
from sysid_evo.controllers.linear import LinearFeedback
from sysid_evo.controllers.networks import RecurrentNetwork

__all__ = ["Controller", "LinearFeedback", "RecurrentNetwork", "View"]
