"""Whole rollouts as the kits of controllers and tasks compare them."""

from __future__ import annotations

import numpy as np

from sysid_evo.arrays import Array, Seeds
from sysid_evo.controllers.controller import Controller
from sysid_evo.dynamics import Dynamics
from sysid_evo.engine import rollout
from sysid_evo.randomness import trial_seeds
from sysid_evo.tasks.task import Task
from sysid_evo.testing.verdicts import expect

TOLERANCE = 1e-6


def expect_engines_agree(
    dynamics: Dynamics, controller: Controller, parameters: Array, task: Task, seeds: Seeds | None = None
) -> None:
    """Raise `ContractViolation` unless the compiled form runs the same trials as the reference form, in float64."""
    seeds = trial_seeds(9, 4) if seeds is None else seeds
    compiled, exact = (
        rollout(dynamics, controller, parameters, task, seeds, record=True, engine=engine)
        for engine in ("float64", "reference")
    )
    for name, found, expected in (
        ("survived", compiled.survived, exact.survived),
        ("fitness", compiled.fitness, exact.fitness),
    ):
        expect(
            np.allclose(found, expected, rtol=TOLERANCE, atol=TOLERANCE),
            f"{name} is {found.ravel()[:5]} compiled and {expected.ravel()[:5]} in NumPy",
        )
    for a, b in zip(compiled.trajectories, exact.trajectories, strict=True):
        for name, found, expected in (("controls", a.controls, b.controls), ("states", a.states, b.states)):
            size = np.abs(expected).max(initial=1.0)
            off = np.abs(found - expected).max(axis=1) > TOLERANCE * size
            expect(not off.any(), f"{name} differ from sample {int(off.argmax())} of {a.name} on")
