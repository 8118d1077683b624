"""Two controllers against each other: two bodies in one race, and evolution of one against the other."""

from sysid_evo.rivals.bodies import TwoBodies, one_body, two_bodies
from sysid_evo.rivals.coevolution import evolve_rivals
from sysid_evo.rivals.drivers import TwoDrivers
from sysid_evo.rivals.meeting import Match, match
from sysid_evo.rivals.race import Race, RaceState

__all__ = ["Match", "Race", "RaceState", "TwoBodies", "TwoDrivers", "evolve_rivals", "match", "one_body", "two_bodies"]
