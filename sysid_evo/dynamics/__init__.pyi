from .model import REST_BAND, DynamicsModel, require_planar
from .stepping import Dynamics, clip_state, doubted, training_envelope

__all__ = ["Dynamics", "DynamicsModel", "REST_BAND", "clip_state", "doubted", "require_planar", "training_envelope"]
