"""How much the states of a dynamics vary: the unit of noise."""

from __future__ import annotations

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.dynamics import Dynamics, clip_state

TRIALS, STEPS, HELD, WARM_UP = 32, 120, 8, 40


def state_spread(dynamics: Dynamics) -> Array:
    """Return the standard deviation (nx,) of each state in the training data of ``dynamics``, see `System.spread`.

    What was not fitted to any, as an emulated robot, is driven by random commands for that, from a fixed
    seed: 32 times, each command held for 8 samples. A state that never varies has 1, its own unit.
    """
    nx = dynamics.system.nx
    pairs = getattr(dynamics, "pairs_", None)
    states = _driven(dynamics) if pairs is None else pairs[:, :nx]
    spread = dynamics.system.spread(states)
    return np.where(np.isfinite(spread) & (spread > 0.0), spread, 1.0)


def _driven(dynamics: Dynamics) -> Array:
    """Return the states (N, nx) that random commands lead to."""
    system, rng = dynamics.system, np.random.default_rng(0)
    states = np.tile(system.neutral_state, (TRIALS, dynamics.n_lags + 1, 1))
    controls = np.tile(system.neutral_control, (TRIALS, dynamics.n_lags, 1))
    carry = dynamics.start(states, controls, rng.standard_normal((TRIALS, dynamics.n_draws)))
    seen = []
    with np.errstate(all="ignore"):
        for k in range(STEPS):
            if k % HELD == 0:
                command = system.actuate(rng.uniform(-1.0, 1.0, (TRIALS, system.nu)))
            noise = rng.standard_normal((TRIALS, dynamics.n_noise)) if dynamics.n_noise else None
            carry, _ = clip_state(dynamics.step(carry, command, noise), dynamics.envelope)
            seen.append(carry[:, : system.nx])
    visited = np.concatenate(seen[WARM_UP:])
    return visited[np.isfinite(visited).all(axis=1)]
