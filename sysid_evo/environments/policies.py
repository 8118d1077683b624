"""Policies of Stable-Baselines3 as champions, so that they stand in the same transfer matrix as evolved controllers."""

from __future__ import annotations

from typing import Any

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.environments.trials import Trials
from sysid_evo.errors import InvalidArgument
from sysid_evo.evolution import Champion
from sysid_evo.registry import Spec

ACTIVATIONS = {"Tanh": "tanh", "ReLU": "relu"}


def champion_of(algorithm: Any, trials: Trials, *, name: str, task: str | Spec, seed: int = 0) -> Champion:
    """Return what a PPO or SAC ``algorithm`` of Stable-Baselines3 has learned in the environment of ``trials``.

    Its policy must be a plain network (``MlpPolicy``) over the observations as they are, with continuous actions:
    only its weights are read. ``task`` is the spec of the task. Raises `InvalidArgument` for another policy.
    """
    policy = algorithm.policy
    if hasattr(policy, "mlp_extractor") and hasattr(policy, "action_net"):
        inner, last, output = policy.mlp_extractor.policy_net, policy.action_net, "clip"
    elif hasattr(policy, "actor") and hasattr(policy.actor, "latent_pi"):
        inner, last, output = policy.actor.latent_pi, policy.actor.mu, "tanh"
    else:
        raise InvalidArgument(f"policy: expected the MlpPolicy of PPO or SAC, got a {type(policy).__name__}")
    linear = [layer for layer in inner if hasattr(layer, "weight")]
    between = {type(layer).__name__ for layer in inner if not hasattr(layer, "weight")}
    last = last[0] if hasattr(last, "__getitem__") else last
    if len(between) != 1 or not between <= ACTIVATIONS.keys() or last.weight.shape[0] != trials.system.nu:
        raise InvalidArgument(
            f"policy: expected one of {', '.join(ACTIVATIONS)} between the layers and one output for each of "
            f"{trials.system.nu} controls, got {', '.join(sorted(between)) or 'none'} and {last.weight.shape[0]}; "
            "make the environment with actions='continuous'"
        )
    hidden = [int(layer.weight.shape[0]) for layer in linear]
    parameters: Array = np.concatenate([_flat(layer) for layer in (*linear, last)])
    return Champion(
        name=name,
        parameters=parameters,
        against=trials.names,
        aggregate="mean",
        seed=seed,
        history=np.empty((0, 3)),
        controller=Spec("policy", {"hidden": hidden, "inner": ACTIVATIONS[between.pop()], "output": output}),
        task=Spec.parse(task) if isinstance(task, str) else task,
        system=trials.system,
    )


def _flat(layer: Any) -> Array:
    """Return the weights (n_in, n_out) of a linear layer row by row, and then its biases."""
    weight, bias = (part.detach().cpu().numpy().astype(np.float64) for part in (layer.weight, layer.bias))
    return np.concatenate([weight.T.ravel(), bias])
