"""A car of two wheels in line, whose tyres saturate: parameters with names, bounds, units and standard errors."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Literal

from model_zoo.car.family import CarFamily
from model_zoo.car.single_track import MAGIC, PARAMETERS, pacejka_rate, tanh_rate
from model_zoo.grey import GreyBox, Parameter
from sysid_evo import PlanarBody, System, register_model
from sysid_evo.data.measured import Measured
from sysid_evo.errors import IncompatibleSystem

ANOTHER_DAY = 0.2
"""Share by which what a manoeuvre says is off elsewhere."""


@register_model("single_track")
class SingleTrack(GreyBox, CarFamily):
    """A single-track car with tyres that saturate, load transfer, and lag and delay of the actuators.

    With forward speed u, lateral speed v, yaw rate r, steering angle d and forces per mass::

        du/dt = T - (drag + quadratic |u|) u - rolling tanh(u / 0.05) - F_f sin d + v r
        dv/dt = F_f cos d + F_r - u r
        dr/dt = (a F_f cos d - b F_r) / k^2
        T     = limit tanh((thrust drive - back_emf |drive| u) / limit)
        s_f   = (u sin d - (v + a r) cos d) / pace,  s_r = (b r - v) / pace,  pace = sqrt(u^2 + floor^2)

    ``tyre="pacejka"``: F = D sin(C atan(B s - E (B s - atan B s))), C and E the same for both axles (Pacejka 2012,
    chapter 4); ``tyre="tanh"``: F = D tanh(B s). The grip D of the rear falls with the square of T / limit, and load
    shifts to the rear by ``load_transfer`` of T. ``drive`` and ``steer`` name the controls with these roles. Fitted as
    `model_zoo.grey.GreyBox` says.
    """

    tyre: Literal["pacejka", "tanh"] = "pacejka"
    substeps: int = 3
    actuator_lag: bool = True
    command_delay: bool = True

    @property
    def law(self) -> Callable[..., Any]:
        return pacejka_rate if self.tyre == "pacejka" else tanh_rate

    def declared(self) -> tuple[Parameter, ...]:
        return (*PARAMETERS, *MAGIC) if self.tyre == "pacejka" else PARAMETERS

    def guesses_from(self, found: Mapping[str, Measured]) -> Mapping[str, tuple[float, float]]:
        """Return losses from coasting, thrust from the acceleration at rest, loss of thrust from the top speed.

        On another day they are some fifth off, so that no prior is narrower.
        """
        guesses: dict[str, tuple[float, float]] = {}
        for name, said in (("rolling_resistance", "rolling resistance forward"), ("drag_linear", "drag forward")):
            if said in found:
                guesses[name] = _believed(found[said].value, found[said].error)
        rolling, drag = (guesses.get(name, (0.0, 0.0))[0] for name in ("rolling_resistance", "drag_linear"))
        for way in ("forward", "backward"):
            start, top = found.get(f"acceleration from rest {way}"), found.get(f"top speed {way}")
            if start is not None:
                thrust = start.value + rolling
                guesses[f"thrust_{way}"] = _believed(thrust, start.error)
                if top is not None and way == "forward" and rolling:
                    guesses["back_emf"] = _believed((thrust - rolling) / top.value - drag, start.error / top.value)
        return guesses

    def check_system(self, system: System) -> None:
        CarFamily.check_system(self, system)
        assert isinstance(system.motion, PlanarBody)
        if system.motion.lateral is None:
            raise IncompatibleSystem(
                "SingleTrack needs the lateral speed, which tells how far the tyres slip: the motion names no channel "
                "for it; parametrised is a car without"
            )
        GreyBox.check_system(self, system)

    def places(self, system: System) -> tuple[tuple[int, ...], tuple[int, ...]]:
        assert isinstance(system.motion, PlanarBody)
        forward, lateral, yaw_rate = system.motion.indices(system.state_names)
        assert lateral is not None
        names = system.control_names
        return (forward, lateral, yaw_rate), (names.index(self.drive), names.index(self.steer))


def _believed(value: float, error: float) -> tuple[float, float]:
    """Return a guess that is not negative, and its standard deviation."""
    return max(value, 0.0), max(error, ANOTHER_DAY * abs(value), 0.01)
