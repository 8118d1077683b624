from .adapters import Adapter, as_model, bases_of, family_name
from .base import DynamicsModel, require_planar
from .disturbances import Disturbed, DomainRandomisation, state_std
from .dynamics import Dynamics, PlainDynamics, training_bounds
from .outside import OutsideCounter
from .storage import load_model, save_model

__all__ = [
    "Adapter",
    "Disturbed",
    "DomainRandomisation",
    "Dynamics",
    "DynamicsModel",
    "OutsideCounter",
    "PlainDynamics",
    "as_model",
    "bases_of",
    "family_name",
    "load_model",
    "require_planar",
    "save_model",
    "state_std",
    "training_bounds",
]
