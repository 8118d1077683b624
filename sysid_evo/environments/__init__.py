"""Models, ensembles and emulated robots as environments of Gymnasium; importing this registers them there."""

from sysid_evo.environments.environments import (
    Actions,
    EnvironmentTrials,
    ModelEnvironment,
    ModelVectorEnvironment,
    champion_from_policy,
)
from sysid_evo.environments.registration import ENVIRONMENTS, load_members, make_env, make_vector_env

__all__ = [
    "ENVIRONMENTS",
    "Actions",
    "EnvironmentTrials",
    "ModelEnvironment",
    "ModelVectorEnvironment",
    "champion_from_policy",
    "load_members",
    "make_env",
    "make_vector_env",
]
