"""What manoeuvres that measure say at once: top speeds, time constants, losses, turning radii, with units.

They are episodes whose names begin with ``step``, ``coast_down`` or ``circle``, as `sysid-evo record --manoeuvre` makes
them: first guesses for a fit (Abbeel et al. 2006, "Using inaccurate models in reinforcement learning").
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.cross_validation import recording
from sysid_evo.data.dataset import Dataset
from sysid_evo.data.trajectory import Trajectory
from sysid_evo.motion import PlanarBody
from sysid_evo.system import System

STEADY = 0.3
"""Share of the command's time, at its end, that counts as steady."""
RISEN = 1.0 - np.exp(-1.0)
SLOW = 0.15
"""Share of the speed at its beginning below which a coast-down is over."""
LEAST = 1e-9


@dataclass(frozen=True)
class Measured:
    """A ``value`` with its standard ``error`` and ``unit``; ``name`` says of what, ``episode`` where it was seen."""

    name: str
    value: float
    error: float
    unit: str
    episode: str

    def __str__(self) -> str:
        return f"{self.name}: {self.value:.3g} +- {self.error:.1g} {self.unit} ({self.episode})"


def measured(dataset: Dataset) -> list[Measured]:
    """Return what the manoeuvres of a data set say, in their order; nothing if there are none."""
    ways: dict[str, Callable[[System, Trajectory], Iterator[Measured]]] = {
        "step": _step,
        "coast_down": _coast_down,
        "circle": _circle,
    }
    found: list[Measured] = []
    for episode in dataset.episodes:
        way = ways.get(recording(episode.name).split("-")[0])
        if way is not None:
            found += way(dataset.system, episode)
    return found


def _commanded(system: System, episode: Trajectory) -> tuple[int, int]:
    """Return the first and one past the last sample with a command; (0, 0) if there is none."""
    on = np.flatnonzero((episode.controls != system.neutral_control).any(axis=1))
    return (int(on[0]), int(on[-1]) + 1) if len(on) else (0, 0)


def _steady(values: Array) -> tuple[float, float]:
    """Return mean and standard error of the last part; neighbours hang together, so that five count as one."""
    last = values[-max(3, round(STEADY * len(values))) :]
    return float(last.mean()), float(last.std() / np.sqrt(max(1.0, len(last) / 5.0)))


def _forward(system: System) -> int | None:
    if not isinstance(system.motion, PlanarBody):
        return None
    return system.motion.indices(system.state_names)[0]


def _direction(value: float) -> str:
    return "forward" if value > 0.0 else "backward"


def _step(system: System, episode: Trajectory) -> Iterator[Measured]:
    """Steady value and time constant of every state, or of the forward speed of what drives."""
    first, last = _commanded(system, episode)
    if last - first < 5:
        return
    forward, name = _forward(system), recording(episode.name)
    for i in range(system.nx) if forward is None else [forward]:
        run = episode.states[first : last + 1, i]
        value, error = _steady(run)
        change, unit = value - run[0], system.states[i].unit
        noise = float(np.std(np.diff(run[-max(3, round(STEADY * len(run))) :])))
        if abs(change) <= 5.0 * noise + LEAST:
            continue
        said = f"steady {system.states[i].name}" if forward is None else f"top speed {_direction(value)}"
        yield Measured(said, abs(value) if forward is not None else value, error, unit, name)
        share = (run - run[0]) / change
        after = int(np.argmax(share >= RISEN))
        if after == 0:
            continue
        whole = after - (share[after] - RISEN) / max(share[after] - share[after - 1], LEAST)
        said = f"time constant of {system.states[i].name}" if forward is None else f"time constant {_direction(value)}"
        yield Measured(said, float(whole * system.dt), 0.5 * system.dt, "s", name)
        if forward is not None:
            start = float(np.max(np.abs(np.diff(run)[: after + 1])) / system.dt)
            yield Measured(f"acceleration from rest {_direction(value)}", start, 0.1 * start, "m/s^2", name)


def _coast_down(system: System, episode: Trajectory) -> Iterator[Measured]:
    """Rolling resistance c and drag d of du/dt = -(c + d |u|) without a command, from the shape of the free run."""
    forward, (_, last) = _forward(system), _commanded(system, episode)
    if forward is None or not last:
        return
    run = episode.states[last + 2 :, forward]  # the command still acts for a sample or two
    moving = np.abs(run) > SLOW * np.abs(run[0]) if len(run) else np.zeros(0, dtype=bool)
    count = len(run) if moving.all() else int(np.argmin(moving))
    if count < 5:
        return
    speed = np.abs(run[:count])
    travelled = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * system.dt)])
    inputs = np.stack([np.ones(count), -system.dt * np.arange(count), -travelled], axis=1)
    solution, _, rank, _ = np.linalg.lstsq(inputs, speed, rcond=None)
    if rank < 3:
        return
    left = speed - inputs @ solution
    covariance = np.linalg.inv(inputs.T @ inputs) * float(left @ left) / max(1, count - 3) * 5.0
    way, name = _direction(float(run[0])), recording(episode.name)
    for said, i, unit in (("rolling resistance", 1, "m/s^2"), ("drag", 2, "1/s")):
        yield Measured(f"{said} {way}", float(solution[i]), float(np.sqrt(covariance[i, i])), unit, name)


def _circle(system: System, episode: Trajectory) -> Iterator[Measured]:
    """Turning radius and speed on it; positive to the left."""
    if not isinstance(system.motion, PlanarBody):
        return
    first, last = _commanded(system, episode)
    if last - first < 5:
        return
    forward, _, yaw_rate = system.motion.indices(system.state_names)
    speed, error_of_speed = _steady(episode.states[first : last + 1, forward])
    turn, error_of_turn = _steady(episode.states[first : last + 1, yaw_rate])
    if abs(turn) < LEAST or abs(speed) < LEAST:
        return
    radius = abs(speed / turn)
    error = radius * float(np.hypot(error_of_speed / speed, error_of_turn / turn))
    side = "left" if turn * speed > 0.0 else "right"
    name = recording(episode.name)
    yield Measured(f"turning radius {side}, {_direction(speed)} at {abs(speed):.2f} m/s", radius, error, "m", name)
