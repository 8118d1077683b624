"""Looks at an environment: what its spaces became, and how its episodes go."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import numpy as np

from hardware.run_report import Stops
from hardware.self_test import Finding, described

if TYPE_CHECKING:
    from hardware.simulators.gymnasium_robot import Environment


FEWEST = 200
"""Steps that are tried at least."""


def examine(environment: Environment, *, seconds: float, seed: int, stops: Stops | None = None) -> tuple[Finding, ...]:
    """Step the environment under random controls for ``seconds`` of its time; a stop from outside ends it."""
    from hardware.simulators.gymnasium_robot import LONGEST_SEED

    system = environment.system
    states, controls = (", ".join(map(described, channels)) for channels in (system.states, system.controls))
    sentence = f"States: {states}. Controls: {controls}. One step is {system.dt:g} s; it waits to be told to step."
    rng, steps = np.random.default_rng(seed), max(FEWEST, round(seconds / system.dt))
    lengths, seen, rewards = [0], [], []
    began = time.perf_counter()
    with environment.open() as session:
        seen.append(session.reset(int(rng.integers(LONGEST_SEED))))
        for _ in range(steps):
            if stops is not None and stops.reason is not None:
                break
            state, reward, ended, late = session.step(system.actuate(rng.uniform(-1.0, 1.0, system.nu)))
            lengths[-1] += 1
            seen.append(state)
            rewards.append(reward)
            if ended or late:
                lengths.append(0)
                seen.append(session.reset(int(rng.integers(LONGEST_SEED))))
    took = time.perf_counter() - began
    low, high = np.min(seen, axis=0), np.max(seen, axis=0)
    ranges = [f"{c.name} {a:.3g} to {b:.3g}" for c, a, b in zip(system.states, low, high, strict=True)]
    over = lengths[:-1]
    episodes = f"{len(over)} episodes ended, after {min(over)} to {max(over)} steps" if over else "No episode ended"
    worth = f"rewards from {min(rewards):.3g} to {max(rewards):.3g} a step" if rewards else "no step was taken"
    return (
        Finding("system", True, sentence, {"dt": system.dt}),
        Finding("states", bool(np.isfinite(seen).all()), f"Under random controls: {', '.join(ranges)}."),
        Finding("episodes", True, f"{episodes}, in {len(rewards)} steps; {worth}."),
        Finding("speed", True, f"{len(rewards) / took:.0f} steps a second.", {"seconds": took}),
    )
