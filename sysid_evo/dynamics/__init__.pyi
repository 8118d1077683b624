from .model import DynamicsModel
from .planar import require_planar
from .rest import REST_BAND
from .stepping import Dynamics, PlainDynamics, clip_state, doubted, training_envelope

__all__ = [
    "Dynamics",
    "DynamicsModel",
    "PlainDynamics",
    "REST_BAND",
    "clip_state",
    "doubted",
    "require_planar",
    "training_envelope",
]
