from .base import DynamicsModel, require_planar
from .disturbances import Disturbed, RadicalEnvelope, state_spread
from .dynamics import Dynamics, PlainDynamics, training_envelope
from .penalty import Doubt, Penalised
from .storage import family_name, load_model, save_model

__all__ = [
    "Dynamics",
    "DynamicsModel",
    "PlainDynamics",
    "require_planar",
    "training_envelope",
    "Disturbed",
    "Doubt",
    "Penalised",
    "RadicalEnvelope",
    "family_name",
    "load_model",
    "save_model",
    "state_spread",
]
