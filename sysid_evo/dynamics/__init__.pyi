from .model import DynamicsModel, require_planar, training_envelope
from .stepping import Dynamics, clip_state, doubted

__all__ = ["Dynamics", "DynamicsModel", "clip_state", "doubted", "require_planar", "training_envelope"]
