"""Delay and noise of the estimator: ``python -m tests.benchmarks.robot.estimator``.

The control loop drives the emulated car through the manoeuvres of a recording; the estimate at every sample is compared
with the true state of the car.
"""

from __future__ import annotations

import argparse

import numpy as np
from rich.console import Console
from rich.table import Table

from hardware.connection import Listener, Measurement
from hardware.control_loop import ControlLoop, Pilot
from hardware.emulation.tracked_robots import TrackedConnection
from hardware.estimator import (
    LAG,
    WINDOW,
    PoseEstimator,
    StateEstimate,
    estimator_delays,
    measure_delays,
)
from hardware.recording.manoeuvres import Manoeuvre, excitation_manoeuvres
from sysid_evo.registry import make_robot
from sysid_evo.types import Array


class Witness(Listener):
    """Writes down the true state at every frame."""

    def __init__(self, connection: TrackedConnection) -> None:
        self.connection = connection
        self.times: list[float] = []
        self.states: list[Array] = []

    def on_measurement(self, measurement: Measurement) -> None:
        self.times.append(self.connection.time)
        self.states.append(self.connection.state)


class Script(Pilot):
    """Drives a manoeuvre and records the estimates."""

    def __init__(self, manoeuvre: Manoeuvre) -> None:
        self.controls = manoeuvre.controls
        self.times: list[float] = []
        self.states: list[Array] = []

    def decide(self, tick: int, estimate: StateEstimate) -> Array | None:
        self.times.append(estimate.time)
        self.states.append(estimate.state)
        return self.controls[tick]


def measure(*, window: float, lag: float, seconds: float, seed: int) -> list[tuple[float, float, float]]:
    """Return the delay (s) of each estimate on the emulated car, its error with the delay taken out, and as it is."""
    robot = make_robot("emulated_car")
    system = robot.system
    truth: tuple[list[float], list[Array]] = ([], [])
    known: tuple[list[float], list[Array]] = ([], [])
    offset = 0.0
    for number, manoeuvre in enumerate(
        excitation_manoeuvres(system, duration=seconds, rng=np.random.default_rng(seed))
    ):
        with robot.connect(seed=seed + number) as connection:
            witness, script = Witness(connection), Script(manoeuvre)
            estimator = PoseEstimator(system, window=window, lag=lag)
            loop = ControlLoop(connection, system, listeners=[witness], estimator=estimator)
            loop.run(script, samples=len(manoeuvre.controls))
            for kept, heard in ((truth, witness), (known, script)):
                kept[0].extend(offset + time for time in heard.times)
                kept[1].extend(heard.states)
            offset += connection.time + robot.system.dt
    times, states, asked, estimates = (np.array(part) for part in (*truth, *known))
    found = []
    for delay, true, estimated in zip(
        measure_delays(system, times, states, asked, estimates), states.T, estimates.T, strict=True
    ):
        off = [estimated - np.interp(asked - shift, times, true) for shift in (delay, 0.0)]
        found.append((delay, *(float(np.sqrt(np.mean(one**2))) for one in off)))
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=120.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--window", type=float, nargs="*", default=[WINDOW], help="s")
    parser.add_argument("--lag", type=float, nargs="*", default=[LAG], help="s")
    options = parser.parse_args()
    out = Console()
    system = make_robot("emulated_car").system
    known = ", ".join(f"{1000 * delay:.1f} ms" for delay in estimator_delays(system, frame_interval=0.005))
    out.print(f"Known drive, 200 frames/s, no noise: {known}")
    for window in options.window:
        for lag in options.lag:
            shown = Table(title=f"Emulated car, window {1000 * window:.0f} ms, lag {1000 * lag:.0f} ms")
            for head in ("state", "delay", "error, delay taken out", "error, as it is used"):
                shown.add_column(head, justify="left" if head == "state" else "right")
            found = measure(window=window, lag=lag, seconds=options.seconds, seed=options.seed)
            for channel, (delay, apart, now) in zip(system.states, found, strict=True):
                errors = (f"{error:.3f} {channel.unit}" for error in (apart, now))
                shown.add_row(channel.name, f"{1000 * delay:.1f} ms", *errors)
            out.print(shown)


if __name__ == "__main__":
    main()
