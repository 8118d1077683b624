from .model import DynamicsModel, require_planar, training_envelope
from .stepping import Dynamics, clip_state

__all__ = ["Dynamics", "DynamicsModel", "clip_state", "require_planar", "training_envelope"]
