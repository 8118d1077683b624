"""Simultaneous sampling: ``python -m tests.benchmarks.simultaneous [--seeds 0,1] [--families narx]``.

Systems in continuous time are recorded in three ways:

- ``held``: the control of row k is held from row k to row k + 1, the usual timing;
- ``at once``: the control is linear between rows, and all signals are sampled at the same instant;
- ``late``: the control of row k + 1 was held from row k to row k + 1.

For each record: the ratio of the errors of both timings (`control_timing`), whether the right timing is found (advance
for the last two), and the error of families over a whole test record: as logged, advanced, and with the timing that is
found in units of the right one. ``CLEAR`` was set on the first five kinds, the others are a check. A second table has
recordings of the usual timing: single outputs (`tests.benchmarks.hidden.systems`) and emulated robots; "-" is not
compared, see `control_timing`.
"""

from __future__ import annotations

import argparse
import sys
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from rich.console import Console
from rich.table import Table

from sysid_evo import make_model
from sysid_evo.data import Dataset, control_timing
from sysid_evo.data.timing import CLEAR
from sysid_evo.errors import DataWarning
from sysid_evo.registry import make_robot
from sysid_evo.system import Channel, System
from sysid_evo.types import Array
from tests.benchmarks.hidden.systems import SYSTEMS
from tests.benchmarks.markdown import add_markdown, print_tables

FINE = 16
"""Steps of integration for each row."""
BEGIN = 20
"""Row at which records begin."""
HELD, AT_ONCE, LATE = "held", "at once", "late"
WIDTH = 120
RIGHT = {HELD: False, AT_ONCE: True, LATE: True}
ROBOTS, RECORDED = ("thermal", "cart_pole", "pendulum", "emulated_car"), 120.0
"""Emulated robots, and for how long they are recorded, in s."""


@dataclass(frozen=True)
class Kind:
    """A system x' = ``law(x, u)`` from ``start``, of which the states ``measured`` are recorded every ``dt`` s.

    The control is noise up to ``band`` times the rate, or with 0 levels for 2 to 25 rows. ``noise`` is that of the
    sensors in standard deviations.
    """

    law: Callable[[Array, float], Array]
    start: tuple[float, ...]
    measured: tuple[int, ...]
    dt: float
    rows: int
    noise: float
    band: float = 0.0

    def record(self, name: str, way: str, seed: int) -> Dataset:
        """Return a record as it was logged, with the usual timing."""
        rng = np.random.default_rng([seed, self.rows, len(name)])
        fine = self._control(rng)
        logged = fine[::FINE]
        driven = {HELD: np.repeat(logged[:-1], FINE), AT_ONCE: fine[:-1], LATE: np.repeat(logged[1:], FINE)}[way]
        clean = _simulated(self.law, np.array(self.start), driven, self.dt / FINE)[::FINE, list(self.measured)]
        states = clean + self.noise * clean.std(axis=0) * rng.standard_normal(clean.shape)
        channels = [Channel(f"y{i}") for i in self.measured]
        system = System(channels, Channel("u", low=-1.0, high=1.0), self.dt, name=name)
        return Dataset.from_arrays(system, states[BEGIN:], logged[BEGIN:, None])

    def _control(self, rng: np.random.Generator) -> Array:
        """Return the control on the fine clock, within -1 and 1; it is linear between rows if it has levels."""
        rows = self.rows + BEGIN + 1
        if not self.band:
            levels = np.repeat(rng.uniform(-1.0, 1.0, rows), rng.integers(2, 26, rows))[:rows]
            return np.interp(np.arange((rows - 1) * FINE + 1) / FINE, np.arange(rows), levels)
        count = rows * FINE
        spectrum = np.fft.rfft(rng.standard_normal(count))
        spectrum[np.arange(len(spectrum)) > self.band * rows] = 0.0
        smooth = np.fft.irfft(spectrum, count)[: (rows - 1) * FINE + 1]
        return np.clip(0.45 * smooth / smooth.std(), -1.0, 1.0)


@njit
def _simulated(law: Any, x: Array, u: Array, h: float) -> Array:
    """Return the states (T + 1, nx) under the controls (T,), each held for ``h`` (Runge and Kutta, fourth order)."""
    states = np.empty((len(u) + 1, len(x)))
    states[0] = x
    for k in range(len(u)):
        a = law(x, u[k])
        b = law(x + 0.5 * h * a, u[k])
        c = law(x + 0.5 * h * b, u[k])
        d = law(x + h * c, u[k])
        x = x + h / 6.0 * (a + 2.0 * b + 2.0 * c + d)
        states[k + 1] = x
    return states


KINDS: dict[str, Kind] = {}


def kind(*start: float, **how: Any) -> Callable[[Callable[[Array, float], Array]], None]:
    """Compile a law and enter it in `KINDS` under its name."""

    def enter(law: Callable[[Array, float], Array]) -> None:
        KINDS[law.__name__] = Kind(njit(law), start, **how)

    return enter


@kind(0.0, 0.0, measured=(1,), dt=2e-5, rows=3000, noise=0.002, band=0.3)
def wiener_hammerstein(x, u):
    """A low pass, a curve that saturates on one side, a low pass."""
    bent = x[0] / np.sqrt(1.0 + (x[0] / 0.3) ** 2) if x[0] > 0.0 else x[0]
    return np.array([3e4 * (u - x[0]), 2e4 * (bent - x[1])])


@kind(0.0, 0.0, measured=(0,), dt=1.0 / 610.0, rows=3000, noise=0.003, band=0.33)
def duffing(x, u):
    """A hardening spring at 68 Hz, as the Silverbox; the displacement is measured."""
    return np.array([x[1], (2.0 * np.pi * 68.0) ** 2 * (u - x[0] - 0.15 * x[0] ** 3) - 43.0 * x[1]])


@kind(0.7, 1.0, measured=(1,), dt=1.0, rows=1500, noise=0.005)
def two_tanks(x, u):
    """Two tanks one above the other; the lower level is measured."""
    between = 0.6 * np.sqrt(max(x[0], 0.0))
    return np.array([0.5 * (u + 1.0) - between, between - 0.5 * np.sqrt(max(x[1], 0.0))])


@kind(0.0, 0.0, measured=(0, 1), dt=0.01, rows=2000, noise=0.01)
def dc_motor(x, u):
    """Current and speed of a motor with dry friction."""
    return np.array([200.0 * u - 100.0 * x[0] - 10.0 * x[1], 80.0 * x[0] - 2.0 * x[1] - 3.0 * np.tanh(x[1] / 0.05)])


@kind(0.0, 0.0, measured=(0,), dt=0.2, rows=1500, noise=0.01)
def heater(x, u):
    """An element that is heated with the square of the control and radiates, in a wall."""
    lost = 0.075 * ((1.0 + x[0]) ** 4 - 1.0)
    return np.array([3.0 * max(u, 0.0) ** 2 - 1.2 * (x[0] - x[1]) - lost, 0.12 * (x[0] - x[1]) - 0.08 * x[1]])


@kind(0.0, 0.0, measured=(0, 1), dt=0.02, rows=2500, noise=0.01, band=0.2)
def pendulum(x, u):
    """Angle and speed of a pendulum under a torque."""
    return np.array([x[1], 25.0 * u - 40.0 * np.sin(x[0]) - 0.8 * x[1]])


@kind(0.0, 0.0, measured=(0,), dt=1.0 / 300.0, rows=2000, noise=0.02)
def circuit(x, u):
    """The voltage of a capacitor behind a coil and a resistor, 30 Hz."""
    return np.array([x[1], 35500.0 * (u - x[0]) - 60.0 * x[1]])


@kind(0.0, 0.0, 0.0, measured=(0,), dt=0.05, rows=2500, noise=0.005)
def hysteresis(x, u):
    """A mass on a spring with a hysteretic force (Bouc and Wen)."""
    force = 12.0 * x[1] - 8.0 * abs(x[1]) * x[2] - 12.0 * x[1] * abs(x[2])
    return np.array([x[1], 40.0 * u - 2.0 * x[1] - 10.0 * x[0] - 8.0 * x[2], force])


@kind(0.15, 0.6, measured=(1,), dt=0.2, rows=2000, noise=0.02)
def stirred_tank(x, u):
    """The temperature of a cooled reaction."""
    rate = 0.1 * (1.0 - x[0]) * np.exp(x[1] / (1.0 + x[1] / 20.0))
    return np.array([rate - x[0], 7.0 * rate - x[1] - 1.5 * (x[1] - 1.5 * u)])


@kind(2.0, measured=(0,), dt=0.1, rows=1500, noise=0.01)
def vehicle_speed(x, u):
    """A vehicle with rolling resistance and drag, driven and braked."""
    return np.array([4.0 * u - 0.3 * np.tanh(x[0] / 0.1) - 0.4 * x[0] * abs(x[0]) + 1.5])


@kind(0.0, 0.0, measured=(0,), dt=300.0, rows=1500, noise=0.01)
def room(x, u):
    """The temperature of the air in a room with heavy walls."""
    return np.array([8e-3 * (u + 1.0) - 1e-3 * (x[0] - x[1]) - 3e-4 * x[0], 5e-5 * (x[0] - x[1]) - 1e-5 * x[1]])


def error(family: str, training: Dataset, test: Dataset, *, advance: bool) -> float:
    """Return the simulation error over the test record, in standard deviations, the mean over states."""
    if advance:
        training, test = training.advanced(), test.advanced()
    model = make_model(family)
    model.set_params(**model.presets.get("quick", {})).fit(training, rng=0)
    run = test.episodes[0]
    states, earlier = run.states[: BEGIN + 1], run.controls[:BEGIN]
    simulated = model.simulate(states[-1 - model.n_lags :], earlier[BEGIN - model.n_lags :], run.controls[BEGIN:])
    off = np.nan_to_num(simulated, nan=np.inf) - run.states[BEGIN + 1 :]
    return float(np.mean(np.sqrt(np.mean(off**2, axis=0)) / run.states.std(axis=0)))


def usual_recordings(seeds: list[int]) -> Table:
    """Return the ratios of recordings of the usual timing; more than `CLEAR` is a false alarm."""
    table = Table("recording", "ratio by seed", box=None)
    ratios = []
    for name in (*SYSTEMS, *ROBOTS):
        cells = []
        for seed in seeds:
            timing = control_timing(
                SYSTEMS[name].recordings(seed)[0]
                if name in SYSTEMS
                else make_robot(name).record(seed=seed, duration=RECORDED).dataset
            )
            cells.append("-" if timing is None else f"{timing.ratio:.2f}")
            ratios += [] if timing is None else [timing.ratio]
        table.add_row(name, " ".join(cells))
    alarms = sum(ratio >= CLEAR for ratio in ratios)
    table.title = f"Usual timing: {alarms} false alarms in {len(ratios)} recordings"
    return table


def main(arguments: list[str] | None = None) -> int:
    """Run the benchmark from the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kinds", nargs="*", default=list(KINDS), choices=KINDS)
    parser.add_argument("--families", nargs="*", default=["narx"], help="families whose errors are compared")
    parser.add_argument("--seeds", default="0,1")
    add_markdown(parser)
    options = parser.parse_args(arguments)
    warnings.simplefilter("ignore", DataWarning)
    table = Table(title="Timing of controls", box=None)
    for head in ("kind", "record", "seed", "ratio", "right", *options.families):
        table.add_column(head, justify="left" if head in ("kind", "record") else "right")
    seeds = [int(seed) for seed in options.seeds.split(",")]
    right = total = close = 0
    for name in options.kinds:
        for seed in seeds:
            for way in (HELD, LATE if seed % 2 else AT_ONCE):
                training, test = (KINDS[name].record(name, way, drawn) for drawn in (seed, 1000 + seed))
                timing = control_timing(training)
                assert timing is not None
                found, cells = timing.simultaneous, []
                right, total = right + (found == RIGHT[way]), total + 1
                for family in options.families:
                    both = {advance: error(family, training, test, advance=advance) for advance in (False, True)}
                    share = both[found] / both[RIGHT[way]]
                    close += share <= 1.05
                    cells.append(f"{both[False]:.3f} {both[True]:.3f} {share:.3f}")
                table.add_row(
                    name, way, str(seed), f"{timing.ratio:.2f}", "yes" if found == RIGHT[way] else "no", *cells
                )
    table.title = f"Timing of controls: right in {right} of {total}"
    if options.families:
        table.title += f"; error at most 1.05 times that of the right one in {close} of {total * len(options.families)}"
    print_tables([table, usual_recordings(seeds)], options.markdown, Console(width=WIDTH))
    return 0


if __name__ == "__main__":
    sys.exit(main())
