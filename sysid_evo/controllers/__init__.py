"""Controllers: control laws whose parameters are evolved."""

from sysid_evo.controllers.controller import Controller, View
from sysid_evo.controllers.recurrent import RecurrentNetwork

__all__ = ["Controller", "RecurrentNetwork", "View"]
