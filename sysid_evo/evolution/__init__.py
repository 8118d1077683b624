"""Evolution: strategies, aggregates, the generation loop, ensembles of models, champions."""

from sysid_evo.evolution.champion import Champion, Finalist
from sysid_evo.evolution.choice import Judgement, choose, judge, worth
from sysid_evo.evolution.cma_es import CmaEs
from sysid_evo.evolution.controllers import ControllerEvolution, evolve_controller, observed_late
from sysid_evo.evolution.ensemble import EnsembleObjective
from sysid_evo.evolution.identification import ModelEvolution
from sysid_evo.evolution.loop import Generation, Objective, Scores, evolve
from sysid_evo.evolution.mu_plus_lambda import MuPlusLambda
from sysid_evo.evolution.niches import Niches
from sysid_evo.evolution.polish import polish
from sysid_evo.evolution.schedule import Schedule, Stage
from sysid_evo.evolution.strategy import EvolutionStrategy, StrategyState

__all__ = [
    "Champion",
    "CmaEs",
    "ControllerEvolution",
    "EnsembleObjective",
    "EvolutionStrategy",
    "Finalist",
    "Generation",
    "Judgement",
    "ModelEvolution",
    "MuPlusLambda",
    "Niches",
    "Objective",
    "Schedule",
    "Scores",
    "Stage",
    "StrategyState",
    "choose",
    "evolve",
    "evolve_controller",
    "judge",
    "observed_late",
    "polish",
    "worth",
]
