"""Search for the parameters of a family by free runs on what was held out."""

from sysid_evo.tuning.search import Tried, Tuning, tune
from sysid_evo.tuning.space import search_space

__all__ = ["Tried", "Tuning", "search_space", "tune"]
