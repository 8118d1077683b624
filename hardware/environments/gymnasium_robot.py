"""Any environment of Gymnasium whose observations are a vector of numbers, as a robot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from hardware.arguments import text
from hardware.connection import Connection
from hardware.environments.environment import Environment
from hardware.environments.environment_runner import EnvironmentRunner
from hardware.robot import Robot
from sysid_evo.errors import IncompatibleSystem
from sysid_evo.extras import check_installed
from sysid_evo.progress import Progress
from sysid_evo.registry import register_robot

if TYPE_CHECKING:
    import numpy as np

    from hardware.finding import Finding
    from hardware.loop.stops import Stops
    from hardware.recording.excitation import Manoeuvre
    from hardware.recording.scripted import Recorded


@register_robot("gymnasium")
class GymnasiumRobot(Robot):
    """An environment of Gymnasium, by its ``id``.

    It steps when it is told to, so that nothing runs in real time.
    The states are its observations: a Box of numbers in a row. ``angle`` says which of them are angles, so that they
    become one periodic state: ``"0,1"`` for a cosine and its sine, ``"2"`` for an angle in rad, several separated by
    semicolons. ``channels`` names the states, with units in brackets: ``"angle [rad], speed [rad/s]"``. ``dt`` (s)
    is the time from one step to the next, by default what the environment says of itself. The classic environments
    have names, units and angles already. ``settings`` is a table of what `gymnasium.make` is given besides.

    An environment of a package of its own is named ``"package:Name-v0"``. Raises `InvalidArgument` if there is no
    such environment, `IncompatibleSystem` if its spaces cannot be states and controls, `MissingExtra`.
    """

    requires: ClassVar[tuple[str, ...]] = ("gymnasium",)
    stepped: ClassVar[bool] = True
    dynamics = None

    def __init__(
        self,
        *,
        id: str = "Pendulum-v1",  # noqa: A002  # as Gymnasium calls it
        angle: str | int | None = None,
        channels: str = "",
        dt: float | None = None,
        settings: Mapping[str, Any] | None = None,
    ) -> None:
        self.name = text("robot gymnasium: id", id)
        check_installed("robot 'gymnasium'", self.requires)
        self.environment = Environment.describe(
            id, angle=None if angle is None else str(angle), channels=channels, dt=dt, settings=dict(settings or {})
        )
        self.system = self.environment.system

    def connect(self, *, seed: int | None = None) -> Connection:
        """Raise `IncompatibleSystem`: an environment has no clock and no tracker."""
        raise IncompatibleSystem(
            f"{self.name} is an environment: it has no clock and no tracker, so that the control loop cannot drive it. "
            "sysid-evo record and compare run it step by step"
        )

    def runner(self) -> EnvironmentRunner:
        return EnvironmentRunner(self.environment)

    def look_at(self, *, seconds: float, seed: int | None = None, stops: Stops | None = None) -> tuple[Finding, ...]:
        """Say what its spaces became, and how its episodes go under random controls for ``seconds`` of its own time."""
        from hardware.environments.examination import examine

        return examine(self.environment, seconds=seconds, seed=seed or 0, stops=stops)

    def manoeuvres(self, *, duration: float, rng: np.random.Generator) -> list[Manoeuvre]:
        """Return none, for what excites an environment answers to its state; a ``duration`` too short is refused."""
        from hardware.environments.recording import samples_each

        samples_each(self.environment, duration)
        return []

    def record_manoeuvres(
        self,
        manoeuvres: Sequence[Manoeuvre],
        *,
        seed: int,
        folder: Path | None = None,
        stops: Stops | None = None,
        progress: Progress | None = None,
    ) -> Recorded:
        """Raise `IncompatibleSystem`: what excites an environment answers to its state."""
        raise IncompatibleSystem(f"{self.name} is an environment, which is recorded without manoeuvres: leave them out")

    def record(
        self,
        *,
        seed: int,
        duration: float,
        folder: Path | None = None,
        stops: Stops | None = None,
        progress: Progress | None = None,
    ) -> Recorded:
        """Excite the environment for ``duration`` s of its own time; there are no journals for ``folder``."""
        from hardware.environments.recording import record_environment

        return record_environment(self.environment, seed=seed, duration=duration, stops=stops, progress=progress)
