"""Racing many candidates against several opponents, and two champions against each other."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sysid_evo.arrays import Array, Seeds
from sysid_evo.controllers.controller import Controller
from sysid_evo.dynamics import Dynamics
from sysid_evo.engine import DynamicsRunner, Runner, rollout
from sysid_evo.errors import IncompatibleSystem, InvalidArgument
from sysid_evo.evolution.champion import Champion
from sysid_evo.randomness import trial_seeds
from sysid_evo.registry import Spec, make_controller, make_task
from sysid_evo.rivals.bodies import TwoBodies
from sysid_evo.rivals.drivers import TwoDrivers
from sysid_evo.rivals.race import Race
from sysid_evo.system import System
from sysid_evo.tasks.duel import Duel

FRESH = 2**31 + 1
"""The generation number of the trials of a match: never reached by an evolution."""


def duel_of(task: Spec) -> Duel:
    """Return the task ``task``. Raises `InvalidArgument` unless it is a duel."""
    made = make_task(task)
    if not isinstance(made, Duel):
        raise InvalidArgument(f"rivals race at duel(...), got the task {task}")
    return made


def bodies_of(runners: Mapping[str, Runner], system: System) -> dict[str, TwoBodies]:
    """Return two bodies for each of ``runners``.

    Raises `InvalidArgument` for what is no model or emulated robot, `IncompatibleSystem` for one of another system.
    """
    found = {label: runner.dynamics for label, runner in runners.items() if isinstance(runner, DynamicsRunner)}
    others = [label for label in runners if label not in found]
    if others:
        raise InvalidArgument(f"rivals: {', '.join(others)} cannot be stepped twice at once: give models")
    for label, dynamics in found.items():
        differences = system.differences(dynamics.system)
        if differences:
            raise IncompatibleSystem(f"rivals: {label} is of another system: {'; '.join(differences)}")
    return {label: TwoBodies(dynamics) for label, dynamics in found.items()}


def leads(bodies: TwoBodies, law: Controller, race: Race, candidates: Array, opponents: Array, seeds: Seeds) -> Array:
    """Return the lead (m) of every candidate (P, n) over every opponent (K, n) in every trial (E,), (P, K, E)."""
    pairs = np.concatenate(
        [np.repeat(candidates, len(opponents), axis=0), np.tile(opponents, (len(candidates), 1))], axis=1
    )
    fitness = rollout(bodies, TwoDrivers(law, law), pairs, race, seeds).fitness
    return fitness.reshape(len(candidates), len(opponents), len(seeds))


@dataclass(frozen=True)
class Match:
    """What the first of two champions was ahead of the second at the end of each trial, ``lead`` (E,) m."""

    lead: Array

    @property
    def won(self) -> float:
        """The share of the trials that the first won; a draw counts half."""
        return float(np.mean(np.where(self.lead == 0.0, 0.5, self.lead > 0.0)))


def match(
    first: Champion,
    second: Champion,
    dynamics: Dynamics,
    *,
    task: Spec | str = "duel",
    trials: int = 100,
    seed: int = 0,
) -> Match:
    """Let two champions race on ``dynamics`` in fresh trials of ``task``, a duel.

    A champion of a duel sees its rival, one of `WalledTrack` does not. Raises `IncompatibleSystem` and
    `IncompatibleTask` for champions that cannot drive there.
    """
    duel = duel_of(Spec.parse(task) if isinstance(task, str) else task)
    for champion in (first, second):
        champion.check_system(dynamics.system)
    laws = (make_controller(first.controller), make_controller(second.controller))
    both = TwoDrivers(*laws, tasks=(make_task(first.task), make_task(second.task)))
    parameters = np.concatenate([first.parameters, second.parameters])[None]
    seeds = trial_seeds(seed, trials, generation=FRESH)
    return Match(rollout(TwoBodies(dynamics), both, parameters, Race(duel), seeds).fitness[0])
