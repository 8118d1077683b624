"""Evolution: strategies, aggregates, the generation loop, ensembles of models, champions."""

from sysid_evo.evolution.aggregates import make_aggregate
from sysid_evo.evolution.champion import Champion, Finalist, load_champion, save_champion
from sysid_evo.evolution.controller_evolution import ControllerEvolution, evolve_controller, observed_late
from sysid_evo.evolution.ensemble import EnsembleObjective
from sysid_evo.evolution.loop import Generation, Objective, Schedule, Scores, Stage, evolve
from sysid_evo.evolution.model_evolution import ModelEvolution
from sysid_evo.evolution.selection import Judgement, choose, judge, polish, worth
from sysid_evo.evolution.strategies.cma_es import CmaEs
from sysid_evo.evolution.strategies.mu_plus_lambda import MuPlusLambda
from sysid_evo.evolution.strategies.niches import Niches
from sysid_evo.evolution.strategies.strategy import EvolutionStrategy, StrategyState, make_strategy

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
    "load_champion",
    "make_aggregate",
    "make_strategy",
    "observed_late",
    "polish",
    "save_champion",
    "worth",
]
