"""Evolution strategies, which propose candidates and learn from their fitness."""

from sysid_evo.evolution.strategies.cma_es import CmaEs
from sysid_evo.evolution.strategies.mu_plus_lambda import MuPlusLambda
from sysid_evo.evolution.strategies.niches import Niches
from sysid_evo.evolution.strategies.strategy import EvolutionStrategy, StrategyState, make_strategy

__all__ = ["CmaEs", "EvolutionStrategy", "MuPlusLambda", "Niches", "StrategyState", "make_strategy"]
