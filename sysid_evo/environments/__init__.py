"""Models, ensembles and emulated robots as environments of Gymnasium; importing this registers them there."""

from sysid_evo.environments.environments import Actions, ModelEnvironment, ModelVectorEnvironment, Trials, champion_of
from sysid_evo.environments.registration import ENVIRONMENTS, make_env, make_vector_env, members_of

__all__ = [
    "ENVIRONMENTS",
    "Actions",
    "ModelEnvironment",
    "ModelVectorEnvironment",
    "Trials",
    "champion_of",
    "make_env",
    "make_vector_env",
    "members_of",
]
