"""How a controller goes about its task: backwards, orbiting, missing, stopping, switching; in numbers and words."""

from evaluation.behaviour.chase import Chase, chase
from evaluation.behaviour.manner import Manner, Measure, manner_of, manners
from evaluation.behaviour.measures import measured
from evaluation.behaviour.sentences import describe, described

__all__ = ["Chase", "Manner", "Measure", "chase", "describe", "described", "manner_of", "manners", "measured"]
