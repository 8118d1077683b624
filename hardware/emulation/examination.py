"""Looks at a robot that goes nowhere: what its sensors say at rest, and what its equations do under full controls."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence

import numpy as np

from hardware.finding import Finding
from hardware.loop.stops import Stops
from sysid_evo.arrays import Array
from sysid_evo.dynamics import Dynamics, clip_state
from sysid_evo.system import Channel, System

STEPS = 300
"""Steps of a trial: how long the equations are tried under each control."""
BATCH = 64
"""Trials whose step is timed."""


def examine(dynamics: Dynamics, sensors: Finding, *, stops: Stops | None = None) -> tuple[Finding, ...]:
    """Try the equations beside what the ``sensors`` said; a stop from outside ends it."""
    findings = [system_finding(dynamics.system), sensors, _rest(dynamics)]
    for place in range(dynamics.system.nu):
        if stops is not None and stops.reason is not None:
            break
        findings.append(_answer(dynamics, place))
    return (*findings, _speed(dynamics))


def system_finding(system: System) -> Finding:
    """Return states, controls and sampling time in a sentence."""
    states, controls = (", ".join(map(described, channels)) or "none" for channels in (system.states, system.controls))
    sentence = f"States: {states}. Controls: {controls}. One sample every {system.dt:g} s; no pose, so no tracker."
    return Finding("system", True, sentence, {"dt": system.dt})


def described(channel: Channel) -> str:
    """Return name, and in brackets what it is known to be: period, levels or limits, with the unit."""
    unit = f" {channel.unit}" if channel.unit else ""
    if channel.period is not None:
        return f"{channel.name} (comes round every {channel.period:g}{unit})"
    if channel.levels is not None:
        return f"{channel.name} ({', '.join(f'{level:g}' for level in channel.levels)}{unit})"
    if channel.bounded:
        return f"{channel.name} ({channel.low:g} to {channel.high:g}{unit})"
    return f"{channel.name} ({channel.unit})" if channel.unit else channel.name


def sensors_finding(
    system: System, names: Sequence[str], readings: Array, rates: Mapping[str, str], period: float
) -> Finding:
    """Say what was read in neutral: ``readings`` (n, names) every ``period`` s; ``rates`` says what is estimated."""
    mean, spread = np.mean(readings, axis=0), np.std(readings, axis=0)
    units = {channel.name: channel.unit for channel in system.states}
    parts = [
        f"{name} {middle:.3g}{_spread(wide)} {units[name]}".rstrip()
        for name, middle, wide in zip(names, mean, spread, strict=True)
    ]
    estimated = ", ".join(f"{name} from {of}" for name, of in rates.items())
    more = f"; estimated: {estimated}" if estimated else ""
    seconds = len(readings) * period
    sentence = f"Read every {period:g} s in neutral for {seconds:g} s: {', '.join(parts)}{more}."
    return Finding("sensors", bool(np.isfinite(readings).all()), sentence)


def _spread(value: float) -> str:
    return f" ± {value:.2g}" if value > 0.0 else ""


def _rest(dynamics: Dynamics) -> Finding:
    """Say where the equations go when nothing is commanded."""
    path = tried(dynamics, dynamics.system.neutral_control)
    finite = bool(np.isfinite(path).all())
    moved = f"goes through {_ranges(dynamics.system, path)}" if np.ptp(path, axis=0).any() else "stays where it is"
    sentence = (
        f"Without a command for {_duration(dynamics):g} s it {moved if finite else _lost(dynamics.system, path)}."
    )
    return Finding("rest", finite, sentence)


def _answer(dynamics: Dynamics, place: int) -> Finding:
    """Say what one control does at its two ends: the others neutral, or full if it changes nothing then."""
    system, channel = dynamics.system, dynamics.system.controls[place]
    if not all(control.bounded for control in system.controls):
        return Finding(channel.name, channel.bounded, "Controls must have finite limits: give low and high, or levels.")
    for others, how in ((system.neutral_control, ""), (full(system), " with the other controls full")):
        paths = {end: tried(dynamics, _with(others, place, end)) for end in (channel.low, channel.high)}
        low, high = paths.values()
        if low.shape != high.shape or not np.array_equal(low, high):
            ok = all(np.isfinite(path).all() for path in paths.values())
            said = "; ".join(_told(dynamics, channel, end, path) for end, path in paths.items())
            return Finding(channel.name, ok, f"For {_duration(dynamics):g} s from rest{how}, {said}.")
    sentence = f"It changes nothing in {_duration(dynamics):g} s from rest: is it in the equations?"
    return Finding(channel.name, False, sentence)


def full(system: System) -> Array:
    """Return every control at the limit farther from neutral, (nu,)."""
    return np.array([c.high if c.high - c.neutral >= c.neutral - c.low else c.low for c in system.controls])


def _with(control: Array, place: int, value: float) -> Array:
    changed = control.copy()
    changed[place] = value
    return changed


def _told(dynamics: Dynamics, channel: Channel, end: float, path: Array) -> str:
    """Say what a control at one ``end`` did."""
    at = f"at {end:g} {channel.unit}".rstrip()
    if not np.isfinite(path).all():
        return f"{at}: it {_lost(dynamics.system, path)}"
    return f"{at}: {_ranges(dynamics.system, path)}{_clipped(dynamics, path)}"


def tried(dynamics: Dynamics, control: Array) -> Array:
    """Return the states (STEPS + 1, nx) from rest under a constant ``control`` (nu,), without noise."""
    system = dynamics.system
    carry = dynamics.start(
        np.tile(system.neutral_state, (1, dynamics.n_lags + 1, 1)),
        np.tile(system.neutral_control, (1, dynamics.n_lags, 1)),
        np.zeros((1, dynamics.n_draws)),
    )
    states = [carry[0, : system.nx].copy()]
    with np.errstate(all="ignore"):
        for _ in range(STEPS):
            carry = dynamics.step(carry, control[None], np.zeros((1, dynamics.n_noise)))
            if not np.isfinite(carry[0, : system.nx]).all():
                states.append(carry[0, : system.nx].copy())
                break
            carry, _ = clip_state(carry, dynamics.envelope)
            states.append(carry[0, : system.nx].copy())
    return np.array(states)


def _duration(dynamics: Dynamics) -> float:
    return STEPS * dynamics.system.dt


def _ranges(system: System, path: Array) -> str:
    """Return from where to where each state goes."""
    parts = []
    for channel, values in zip(system.states, path.T, strict=True):
        low, high = float(values.min()), float(values.max())
        span = f"{low:.3g}" if low == high else f"{low:.3g} to {high:.3g}"
        parts.append(f"{channel.name} {span} {channel.unit}".rstrip())
    return ", ".join(parts)


def _clipped(dynamics: Dynamics, path: Array) -> str:
    """Return which states are held at a limit."""
    if dynamics.envelope is None:
        return ""
    rest = dynamics.system.neutral_state
    held = [
        channel.name
        for channel, values, least, most, start in zip(
            dynamics.system.states, path.T, *dynamics.envelope, rest, strict=True
        )
        if (values.max() >= most > start) or (values.min() <= least < start)
    ]
    return f" ({', '.join(held)} held at the limit)" if held else ""


def _lost(system: System, path: Array) -> str:
    """Return which state is no number any more, and when."""
    names = [channel.name for channel, value in zip(system.states, path[-1], strict=True) if not np.isfinite(value)]
    return (
        f"leaves all bounds: {', '.join(names)} is no finite number after {(len(path) - 1) * system.dt:g} s. Look at "
        "the equations, or take a shorter dt"
    )


def _speed(dynamics: Dynamics) -> Finding:
    """Say how fast rollouts step it."""
    system = dynamics.system
    carry = dynamics.start(
        np.tile(system.neutral_state, (BATCH, dynamics.n_lags + 1, 1)),
        np.tile(system.neutral_control, (BATCH, dynamics.n_lags, 1)),
        np.zeros((BATCH, dynamics.n_draws)),
    )
    control, noise = np.tile(system.neutral_control, (BATCH, 1)), np.zeros((BATCH, dynamics.n_noise))
    began = time.perf_counter()
    for _ in range(STEPS):
        dynamics.step(carry, control, noise)
    seconds = time.perf_counter() - began
    form = "NumPy (a kernel() makes it ten times as fast)" if dynamics.kernel() is None else "compiled"
    sentence = f"Rollouts are {form}; in NumPy {BATCH} trials of {STEPS} steps take {seconds:.2f} s."
    return Finding("speed", True, sentence, {"seconds": seconds})
