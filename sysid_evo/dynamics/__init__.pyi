from .model import REST_BAND, DynamicsModel
from .planar import require_planar
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
