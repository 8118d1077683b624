"""Models, ensembles and emulated robots as environments of Gymnasium; importing this registers them there."""

from sysid_evo.environments.making import members_of
from sysid_evo.environments.policies import champion_of
from sysid_evo.environments.registered import ENVIRONMENTS, make_env, make_vector_env
from sysid_evo.environments.single import ModelEnvironment
from sysid_evo.environments.spaces import Actions
from sysid_evo.environments.trials import Trials
from sysid_evo.environments.vector import ModelVectorEnvironment

__all__ = [
    "Actions",
    "ENVIRONMENTS",
    "ModelEnvironment",
    "ModelVectorEnvironment",
    "Trials",
    "champion_of",
    "make_env",
    "make_vector_env",
    "members_of",
]
