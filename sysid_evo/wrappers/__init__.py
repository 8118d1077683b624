"""Dynamics around dynamics: what a controller meets on a robot and not in a model."""

from sysid_evo.wrappers.cautious import Cautious
from sysid_evo.wrappers.delayed_estimate import DelayedEstimate
from sysid_evo.wrappers.doubt import Discounted, Doubt, cautions
from sysid_evo.wrappers.noisy_sensors import NoisySensors
from sysid_evo.wrappers.perturbed import Perturbed
from sysid_evo.wrappers.radical_envelope import RadicalEnvelope, disturbed, noises, one_of_its_members
from sysid_evo.wrappers.spread import state_spread
from sysid_evo.wrappers.supported import Supported
from sysid_evo.wrappers.switching import Switching

__all__ = [
    "Cautious",
    "DelayedEstimate",
    "Discounted",
    "Doubt",
    "NoisySensors",
    "Perturbed",
    "RadicalEnvelope",
    "Supported",
    "Switching",
    "cautions",
    "disturbed",
    "noises",
    "one_of_its_members",
    "state_spread",
]
