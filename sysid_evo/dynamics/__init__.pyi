from .model import DynamicsModel, require_planar
from .stepping import Dynamics, clip_state, doubted, training_envelope

__all__ = ["Dynamics", "DynamicsModel", "clip_state", "doubted", "require_planar", "training_envelope"]
