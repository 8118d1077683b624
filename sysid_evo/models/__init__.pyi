from .base import DynamicsModel, require_planar
from .disturbances import Disturbed, RadicalEnvelope, state_spread
from .dynamics import Dynamics, PlainDynamics, training_envelope
from .penalty import Cautious, Doubt, Supported
from .storage import family_name, load_model, save_model

__all__ = [
    "Dynamics",
    "DynamicsModel",
    "PlainDynamics",
    "require_planar",
    "training_envelope",
    "Cautious",
    "Disturbed",
    "Doubt",
    "RadicalEnvelope",
    "Supported",
    "family_name",
    "load_model",
    "save_model",
    "state_spread",
]
