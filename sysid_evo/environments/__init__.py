"""Models, ensembles and emulated robots as Gymnasium environments; importing this package registers them."""

from sysid_evo.environments.environments import (
    ENVIRONMENTS,
    Actions,
    EnvironmentTrials,
    ModelEnvironment,
    ModelVectorEnvironment,
    champion_from_policy,
    load_members,
    make_env,
    make_vector_env,
)

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
