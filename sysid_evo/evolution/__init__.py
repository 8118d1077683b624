"""Evolution: strategies, the generation loop, ensembles of models, champions."""

from sysid_evo.evolution.champion import Champion
from sysid_evo.evolution.controllers import ControllerEvolution, evolve_controller, observed_late
from sysid_evo.evolution.ensemble import AGGREGATES, EnsembleObjective, aggregate
from sysid_evo.evolution.identification import ModelEvolution
from sysid_evo.evolution.loop import Generation, Objective, evolve
from sysid_evo.evolution.mu_plus_lambda import MuPlusLambda
from sysid_evo.evolution.strategy import EvolutionStrategy

__all__ = [
    "AGGREGATES",
    "Champion",
    "ControllerEvolution",
    "EnsembleObjective",
    "EvolutionStrategy",
    "Generation",
    "ModelEvolution",
    "MuPlusLambda",
    "Objective",
    "aggregate",
    "evolve",
    "evolve_controller",
    "observed_late",
]
