"""An awkward car: it starts late, has no reverse, and is stuck in a part of its recordings."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hardware.arguments import number
from hardware.arguments import seed as checked_seed
from hardware.connection import Connection
from hardware.emulation.car_parameters import CarParameters
from hardware.emulation.emulated_car import REPEATS, CarPhysics
from hardware.emulation.emulated_robot import EmulatedConnection, EmulatedRobot
from sysid_evo.dynamics import Dynamics
from sysid_evo.errors import InvalidArgument
from sysid_evo.progress import Progress
from sysid_evo.registry import register_robot

if TYPE_CHECKING:
    from hardware.loop.stops import Stops
    from hardware.recording.scripted import Recorded

AWKWARD = replace(CarParameters(), thrust_backward=0.0, start_speed=0.35, start_lag=0.5, start_level=0.5)
"""The toy car with a cheap motor controller for model planes: without a sensor, and without reverse.

A standing car pulls after 0.35 s of full drive without a break. Driven backward it only brakes.
"""


@register_robot("awkward_car")
class AwkwardCar(EmulatedRobot):
    """The toy car with the drive of a model plane; with a ``seed`` another of its kind.

    It answers to forward drive from standstill after 0.7 of ``start_lag`` (s), to backward drive not at all, and races
    as well as any once it rolls. In the share ``stuck`` of the manoeuvres of a recording, drawn from the seed of the
    recording, it is jammed against something and stands, whatever it is told; when it races it is free.
    Raises `InvalidArgument`.
    """

    def __init__(self, *, seed: int | None = None, start_lag: float = AWKWARD.start_lag, stuck: float = 0.1) -> None:
        seed = checked_seed("robot awkward_car", seed)
        self.stuck = number("robot awkward_car: stuck", stuck, least=0.0)
        if self.stuck > 1.0:
            raise InvalidArgument(f"robot awkward_car: expected stuck as a share up to 1, got {stuck}")
        usual = replace(AWKWARD, start_lag=number("robot awkward_car: start_lag", start_lag, above=0.0))
        name = "awkward_car" if seed is None else f"awkward_car:{seed}"
        physics = CarPhysics(usual if seed is None else usual.perturbed(seed))
        super().__init__(name, physics, repeats=REPEATS)

    def record(
        self,
        *,
        seed: int,
        duration: float,
        folder: Path | None = None,
        stops: Stops | None = None,
        progress: Progress | None = None,
    ) -> Recorded:
        from hardware.recording.scripted import record_dataset

        jammed = _Jammed(self, np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(0,))))
        return record_dataset(jammed, seed=seed, duration=duration, folder=folder, stops=stops, progress=progress)


class _Jammed:
    """The car while it is recorded: every few sessions, ``stuck`` of them in all, it stands still."""

    def __init__(self, car: AwkwardCar, rng: np.random.Generator) -> None:
        self.car, self.name, self.system = car, car.name, car.system
        self.dynamics: Dynamics | None = car.dynamics
        self._due = float(rng.random())

    def connect(self, *, seed: int | None = None) -> Connection:
        """Open the next session."""
        self._due += self.car.stuck
        if self._due < 1.0:
            return self.car.connect(seed=seed)
        self._due -= 1.0
        return _JammedConnection(self.car.name, self.car.physics, seed=seed, gate=self.car.gate)


class _JammedConnection(EmulatedConnection):
    """A session in which the car does not move; the tracker sees it as noisily as ever."""

    def _advance(self) -> None:
        return
