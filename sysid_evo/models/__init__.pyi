from .base import DynamicsModel, require_planar
from .disturbances import Disturbed, DomainRandomisation, state_std
from .dynamics import Dynamics, PlainDynamics, training_bounds
from .penalty import Penalised, UncertaintyPenalty
from .storage import family_name, load_model, save_model

__all__ = [
    "Disturbed",
    "DomainRandomisation",
    "Dynamics",
    "DynamicsModel",
    "Penalised",
    "PlainDynamics",
    "UncertaintyPenalty",
    "family_name",
    "load_model",
    "require_planar",
    "save_model",
    "state_std",
    "training_bounds",
]
