from .model import DynamicsModel
from .planar import require_planar
from .rest import REST_BAND
from .stepping import Dynamics, PlainDynamics, clip_state, training_envelope

__all__ = [
    "Dynamics",
    "DynamicsModel",
    "PlainDynamics",
    "REST_BAND",
    "clip_state",
    "require_planar",
    "training_envelope",
]
