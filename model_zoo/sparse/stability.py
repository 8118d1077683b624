"""Whether a fitted equation stays where it should: how disturbances grow, and free runs as long as a trial."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.dynamics import DynamicsModel

TRIAL = 25.0
"""Seconds of a free run."""
MOST_STEPS = 1000
RUNS = 32
HELD = 10
"""Steps for which a free run holds each control."""
STATES = 64
"""Visited states at which the equation is linearised."""
GROWS = 0.1
"""Growth per second that is worth a sentence."""
MOST = 0.5
"""Share of recorded states with such growth that is worth one."""
STEP = 1e-4


@dataclass(frozen=True)
class Stability:
    """Growth rates of small disturbances in 1/s, and how free runs from recorded states end.

    ``at_rest`` is that of the neutral state under neutral controls, ``visited`` (N,) those at recorded states under
    recorded controls; below 0 disturbances die out. ``escaped`` is the share of free runs of ``seconds`` under
    recorded controls, in random order, that reach the envelope.
    """

    at_rest: float
    visited: Array
    escaped: float
    seconds: float

    @property
    def sentence(self) -> str:
        """What there is to say against the model; empty if nothing."""
        found = []
        if self.escaped > 0:
            found.append(
                f"is unstable: {100 * self.escaped:.0f} % of free runs of {self.seconds:g} s from recorded states "
                "reach the envelope"
            )
        if self.at_rest > GROWS:
            found.append(f"lets small disturbances at rest grow by {self.at_rest:.1f} 1/s")
        share = float((self.visited > GROWS).mean())
        if share > MOST:
            found.append(f"lets small disturbances grow at {100 * share:.0f} % of recorded states")
        return ", and ".join(found)


def stability(model: DynamicsModel) -> Stability:
    """Return the `Stability` of a fitted model; the same every time."""
    system, rng = model.system, np.random.default_rng(0)
    nx = system.nx
    states, controls = model.pairs_[:, :nx], model.pairs_[:, nx:]
    some = rng.integers(len(states), size=STATES)
    rest = growth(model, system.neutral_state[None], system.neutral_control[None])
    steps = min(MOST_STEPS, max(1, round(TRIAL / system.dt)))
    began = rng.integers(len(states), size=RUNS)
    pieces = rng.integers(len(controls), size=(RUNS, -(-steps // HELD)))
    history = np.repeat(states[began][:, None], model.n_lags + 1, axis=1)
    past = np.tile(system.neutral_control, (RUNS, model.n_lags, 1))
    runs = model.simulate(history, past, np.repeat(controls[pieces], HELD, axis=1)[:, :steps])
    low, high = model.envelope_
    with np.errstate(invalid="ignore"):
        escaped = ~np.isfinite(runs) | (runs <= low) | (runs >= high)
    return Stability(
        float(rest[0]),
        growth(model, states[some], controls[some]),
        float(escaped.any(axis=(1, 2)).mean()),
        steps * system.dt,
    )


def growth(model: DynamicsModel, states: Array, controls: Array) -> Array:
    """Return how fast (N,) in 1/s the fastest small disturbance of the carry grows, under held controls."""
    system, lags = model.system, model.n_lags
    carry = model.start(np.repeat(states[:, None], lags + 1, axis=1), np.repeat(controls[:, None], lags, axis=1))
    spread = np.where(np.isfinite(np.ptp(carry, axis=0)), np.ptp(carry, axis=0), 0.0)
    usual = np.ptp(model.pairs_[:, : system.nx], axis=0).max()
    size = STEP * np.where(spread > 0, spread, usual if usual > 0 else 1.0)
    columns = []
    for place in range(carry.shape[1]):
        off = np.zeros(carry.shape[1])
        off[place] = size[place]
        with np.errstate(all="ignore"):
            columns.append((model.step(carry + off, controls) - model.step(carry - off, controls)) / (2 * size[place]))
    jacobian = np.nan_to_num(np.stack(columns, axis=2))
    fastest = np.abs(np.linalg.eigvals(jacobian)).max(axis=1)
    return np.asarray(np.log(np.maximum(fastest, np.finfo(float).tiny)) / system.dt)
