"""Evolution: strategies, aggregates, the generation loop, ensembles of models, champions."""

from sysid_evo.evolution.champion import Champion, Finalist
from sysid_evo.evolution.controller_evolution import ControllerEvolution, evolve_controller, observed_late
from sysid_evo.evolution.ensemble import EnsembleObjective
from sysid_evo.evolution.loop import Generation, Objective, Schedule, Scores, Stage, evolve
from sysid_evo.evolution.model_evolution import ModelEvolution
from sysid_evo.evolution.selection import Judgement, choose, judge, polish, worth
from sysid_evo.evolution.strategies.mu_plus_lambda import MuPlusLambda
from sysid_evo.evolution.strategies.niches import Niches
from sysid_evo.evolution.strategies.strategy import EvolutionStrategy, StrategyState

__all__ = [
    "Champion",
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
