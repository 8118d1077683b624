"""Dynamics around dynamics: what a controller meets on a robot and not in a model."""

from sysid_evo.wrappers.cautious import Cautious
from sysid_evo.wrappers.delayed_estimate import DelayedEstimate
from sysid_evo.wrappers.doubt import Discounted, Doubt, cautions
from sysid_evo.wrappers.noisy_sensors import NoisySensors
from sysid_evo.wrappers.perturbed import Perturbed
from sysid_evo.wrappers.radical_envelope import RadicalEnvelope, disturbed, noises
from sysid_evo.wrappers.spread import state_spread
from sysid_evo.wrappers.supported import Supported

__all__ = [
    "Cautious",
    "DelayedEstimate",
    "Discounted",
    "Doubt",
    "NoisySensors",
    "Perturbed",
    "RadicalEnvelope",
    "Supported",
    "cautions",
    "disturbed",
    "noises",
    "state_spread",
]
