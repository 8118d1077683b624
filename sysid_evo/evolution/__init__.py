"""Evolution: strategies, aggregates, the generation loop, ensembles of models, champions."""

from sysid_evo.evolution.champion import Champion, Finalist
from sysid_evo.evolution.controller_evolution import ControllerEvolution, delayed_runner, evolve_controller
from sysid_evo.evolution.loop import Scores, evolve
from sysid_evo.evolution.model_evolution import ModelEvolution
from sysid_evo.evolution.selection import FinalistScore, choose, polish, ranking_value

__all__ = [
    "Champion",
    "ControllerEvolution",
    "Finalist",
    "FinalistScore",
    "ModelEvolution",
    "Scores",
    "choose",
    "delayed_runner",
    "evolve",
    "evolve_controller",
    "polish",
    "ranking_value",
]
