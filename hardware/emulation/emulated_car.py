"""The emulated toy car as a robot: the stand-in for the paper's car (section 3)."""

from __future__ import annotations

from hardware.arguments import seed as checked_seed
from hardware.emulation.car_parameters import CarParameters
from hardware.emulation.car_physics import CarPhysics
from hardware.emulation.emulated_robot import EmulatedRobot
from sysid_evo.registry import register_robot

REPEATS = 10  # fine steps of 5 ms in one sample of 50 ms


@register_robot("emulated_car")
def emulated_car(*, seed: int | None = None) -> EmulatedRobot:
    """The toy car of the paper in simulation; with a ``seed`` another of its kind, see `CarParameters.perturbed`."""
    nominal, seed = CarParameters(), checked_seed("robot emulated_car", seed)
    if seed is None:
        return EmulatedRobot("emulated_car", CarPhysics(nominal), repeats=REPEATS)
    return EmulatedRobot(f"emulated_car:{seed}", CarPhysics(nominal.perturbed(seed)), repeats=REPEATS)
