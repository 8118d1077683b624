"""Evolution: strategies, aggregates, the generation loop, ensembles of models, champions."""

from sysid_evo.evolution.aggregates import make_aggregate
from sysid_evo.evolution.champion import Champion, Finalist, load_champion, save_champion
from sysid_evo.evolution.controller_evolution import ControllerEvolution, delayed_runner, evolve_controller
from sysid_evo.evolution.ensemble import EnsembleObjective
from sysid_evo.evolution.loop import Generation, Objective, Schedule, Scores, Stage, evolve
from sysid_evo.evolution.model_evolution import ModelEvolution
from sysid_evo.evolution.selection import FinalistScore, choose, polish, ranking_value, score_finalists
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
    "FinalistScore",
    "Generation",
    "ModelEvolution",
    "MuPlusLambda",
    "Niches",
    "Objective",
    "Schedule",
    "Scores",
    "Stage",
    "StrategyState",
    "choose",
    "delayed_runner",
    "evolve",
    "evolve_controller",
    "load_champion",
    "make_aggregate",
    "make_strategy",
    "polish",
    "ranking_value",
    "save_champion",
    "score_finalists",
]
