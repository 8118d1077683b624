"""Channels (name, unit, limits, levels) and systems (channels, sampling time, motion)."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from sysid_evo.angles import TURN, wrap
from sysid_evo.display import Displayed, listed
from sysid_evo.errors import IncompatibleSystem, InvalidArgument, InvalidSystem
from sysid_evo.kernels import MotionKernel
from sysid_evo.motion import Motion, MotionGradient, StraightGradient, motion_from_dict
from sysid_evo.motion_kernels import STRAIGHT
from sysid_evo.rigid_body import RigidBody
from sysid_evo.types import Array, check_last, check_shape

LOG = logging.getLogger(__name__)
NEAR_LIMIT = 0.01


@dataclass(frozen=True)
class Channel:
    """One state or control: its name, unit, limits, discrete levels, neutral value and period.

    ``levels`` are the only legal values of a discrete control, in rising order; None for a continuous one.
    ``neutral`` is the value at rest (a state) or without a command (a control), by default 0 or the limit nearest to
    it. ``period`` is that of a periodic state without limits, such as 2 pi for an angle in rad; values that differ by
    whole periods are equal. ``description`` is for readers, for example "0 hanging, counter-clockwise positive"; it is
    ignored when channels are compared.
    """

    name: str
    unit: str = ""
    low: float = -np.inf
    high: float = np.inf
    levels: tuple[float, ...] | None = None
    neutral: float = np.nan
    period: float | None = None
    description: str = field(default="", compare=False)

    def __post_init__(self) -> None:
        if not self.name:
            raise InvalidSystem("channel: expected a name, got an empty string")
        if self.period is not None:
            if not 0.0 < self.period < np.inf:
                raise InvalidSystem(f"channel {self.name!r}: expected a finite period > 0, got {self.period}")
            if self.levels is not None or (self.low, self.high) != (-np.inf, np.inf):
                raise InvalidSystem(f"channel {self.name!r}: expected a period or limits, got both")
        if self.levels is not None:
            levels = tuple(float(level) for level in self.levels)
            if len(levels) < 2 or not all(a < b for a, b in pairwise(levels)):
                raise InvalidSystem(f"channel {self.name!r}: expected two or more rising levels, got {self.levels}")
            object.__setattr__(self, "levels", levels)
            object.__setattr__(self, "low", max(self.low, levels[0]))
            object.__setattr__(self, "high", min(self.high, levels[-1]))
            if (self.low, self.high) != (levels[0], levels[-1]):
                raise InvalidSystem(f"channel {self.name!r}: levels {levels} lie outside [{self.low}, {self.high}]")
        if not self.low < self.high:
            raise InvalidSystem(f"channel {self.name!r}: expected low < high, got [{self.low}, {self.high}]")
        if np.isnan(self.neutral):
            object.__setattr__(self, "neutral", float(min(max(0.0, self.low), self.high)))
        if not (np.isfinite(self.neutral) and self.low <= self.neutral <= self.high):
            raise InvalidSystem(
                f"channel {self.name!r}: expected a neutral value within [{self.low}, {self.high}], got {self.neutral}"
            )

    @property
    def bounded(self) -> bool:
        """Whether both limits are finite."""
        return bool(np.isfinite(self.low) and np.isfinite(self.high))

    def to_dict(self) -> dict[str, Any]:
        """Return the channel as strict JSON: an absent limit is null, an absent period or description has no key."""
        return {
            "name": self.name,
            "unit": self.unit,
            "low": self.low if np.isfinite(self.low) else None,
            "high": self.high if np.isfinite(self.high) else None,
            "levels": None if self.levels is None else list(self.levels),
            "neutral": self.neutral,
            **({} if self.period is None else {"period": self.period}),
            **({"description": self.description} if self.description else {}),
        }

    @classmethod
    def from_dict(cls, value: Mapping[str, Any]) -> Channel:
        """Undo `to_dict`."""
        return cls(
            name=value["name"],
            unit=value["unit"],
            low=-np.inf if value["low"] is None else value["low"],
            high=np.inf if value["high"] is None else value["high"],
            levels=None if value["levels"] is None else tuple(value["levels"]),
            neutral=value["neutral"],
            period=value.get("period"),
            description=value.get("description", ""),
        )


@dataclass(frozen=True, repr=False)
class System(Displayed):
    """States, controls, the sampling time ``dt`` in seconds, and the ``motion`` that turns states into a pose.

    A name instead of a `Channel` is a channel without unit and limits. With ``advance``, the control of the step from k
    to k + 1 is the one logged at k + 1, as in records whose signals are all sampled at the same instant. Models of such
    a system are for simulation only, see `check_causal`.
    """

    states: tuple[Channel, ...]
    controls: tuple[Channel, ...]
    dt: float
    motion: Motion | None = None
    name: str = field(default="", compare=False)
    advance: bool = False

    def __init__(
        self,
        states: Iterable[Channel | str] | Channel,
        controls: Iterable[Channel | str] | Channel,
        dt: float,
        motion: Motion | None = None,
        name: str = "",
        advance: bool = False,
    ) -> None:
        given = {"states": _channels("states", states), "controls": _channels("controls", controls)}
        for what, value in (given | {"dt": dt, "motion": motion, "name": name, "advance": advance}).items():
            object.__setattr__(self, what, value)
        if not self.states:
            raise InvalidSystem("system: expected at least one state channel, got none")
        names = [channel.name for channel in (*self.states, *self.controls)]
        repeated = sorted({name for name in names if names.count(name) > 1})
        if repeated:
            raise InvalidSystem(f"system: channel names must differ, repeated: {', '.join(repeated)}")
        if not (isinstance(self.dt, (int, float, np.number)) and np.isfinite(self.dt) and self.dt > 0):
            raise InvalidSystem(f"system: expected dt > 0 s, got {self.dt!r}")
        for control in self.controls:
            if control.period is not None:
                raise InvalidSystem(f"control {control.name!r}: expected no period, only states have one")
        if self.motion is not None:
            self.motion.check(self.state_names)

    def facts(self) -> Mapping[str, str]:
        return {
            **({"name": self.name} if self.name else {}),
            "states": listed(map(_described, self.states)),
            "controls": listed(map(_described, self.controls)),
            "dt": f"{self.dt:g} s",
            **({} if self.motion is None else {"motion": self.motion.kind}),
            **({"advance": "a step has the control logged after it"} if self.advance else {}),
        }

    @property
    def nx(self) -> int:
        """Number of states."""
        return len(self.states)

    @property
    def nu(self) -> int:
        """Number of controls."""
        return len(self.controls)

    @property
    def n_pose(self) -> int:
        """Number of pose coordinates, 0 without a motion."""
        return 0 if self.motion is None else self.motion.n_pose

    @cached_property
    def state_names(self) -> tuple[str, ...]:
        return tuple(channel.name for channel in self.states)

    @cached_property
    def control_names(self) -> tuple[str, ...]:
        return tuple(channel.name for channel in self.controls)

    @cached_property
    def neutral_state(self) -> Array:
        """The state at rest, (nx,)."""
        return np.array([channel.neutral for channel in self.states], dtype=np.float64)

    @cached_property
    def neutral_control(self) -> Array:
        """The control without a command, (nu,)."""
        return np.array([channel.neutral for channel in self.controls], dtype=np.float64)

    def actuate(self, raw: Array) -> Array:
        """Return the legal controls (..., nu) for controller outputs in [-1, 1], (..., nu).

        A continuous channel scales [-1, 1] to its limits. A discrete one switches between its
        levels: its boundaries are equal parts of [-1, 1] times 0.9, so three levels switch at
        -0.3 and 0.3 (paper, section 5.2). Outputs beyond [-1, 1] saturate.
        """
        raw = check_last("raw", raw, self.nu)
        control = np.empty_like(raw)
        for i, channel in enumerate(self.controls):
            if channel.levels is not None:
                switch(raw[..., i], channel.levels, control[..., i])
            elif channel.bounded:
                share = (np.clip(raw[..., i], -1.0, 1.0) + 1.0) / 2.0
                control[..., i] = channel.low + share * (channel.high - channel.low)
            else:
                raise InvalidSystem(
                    f"control {channel.name!r} has no finite limits, so [-1, 1] cannot be scaled to it: "
                    "give low and high, or levels"
                )
        return control

    def raw_output(self, control: Array) -> Array:
        """Return the outputs in [-1, 1] for ``control`` (..., nu), the inverse of `actuate`.

        Values beyond the limits are clipped, values between two levels are rounded to the nearest level.
        """
        control = check_last("control", control, self.nu)
        raw = np.empty_like(control)
        for i, channel in enumerate(self.controls):
            if channel.levels is not None:
                levels = np.asarray(channel.levels)
                nearest = np.abs(control[..., i, None] - levels).argmin(axis=-1)
                raw[..., i] = (2 * nearest + 1 - len(levels)) / len(levels)
            else:
                share = (control[..., i] - channel.low) / (channel.high - channel.low)
                raw[..., i] = np.clip(2.0 * share - 1.0, -1.0, 1.0)
        return raw

    def controls_of_steps(self, logged: Array) -> Array:
        """Return the controls of T steps (T, nu), given those logged with each of the T + 1 samples."""
        return logged[1:] if self.advance else logged[:-1]

    def check_causal(self, use: str) -> None:
        """Raise `IncompatibleSystem` with ``advance``: controllers do not know the command of the next sample."""
        if self.advance:
            raise IncompatibleSystem(
                f"{use}: the data have advance, so each step has the control that was logged after it, not known "
                "in time. Their models are for simulation: compare --stop-after prediction. If the log only stamps "
                "commands too late, correct the stamps there and import it without advance"
            )

    def check_control(self, control: Array) -> Array:
        """Return ``control`` (nu,) as float64. Raises `ShapeError`, or `InvalidArgument` if it is not legal."""
        control = check_shape("control", control, (self.nu,))
        for value, channel in zip(control, self.controls, strict=True):
            if not channel.low <= value <= channel.high or (channel.levels and value not in channel.levels):
                legal = f"one of {channel.levels}" if channel.levels else f"[{channel.low}, {channel.high}]"
                raise InvalidArgument(f"control {channel.name!r}: expected {legal}, got {value}")
        return control

    def acceleration(self, before: Array, after: Array) -> Array:
        """Return the change from ``before`` to ``after`` per second, (..., nx) each.

        The motion removes the rotation of its frame from its velocities (paper, footnote 1). Other channels are
        differences, for periodic states the shortest one.
        """
        before, after = check_last("before", before, self.nx), check_last("after", after, self.nx)
        if self.periods:
            after = self.unwrap_towards(after, before)
        if self.motion is None:
            return (after - before) / self.dt
        return self.motion.acceleration(before, after, self.dt, self.state_names)

    @cached_property
    def periods(self) -> Mapping[int, float]:
        """The period of each periodic state, by its index."""
        return {i: channel.period for i, channel in enumerate(self.states) if channel.period is not None}

    def difference(self, after: Array, before: Array) -> Array:
        """Return ``after`` - ``before`` (..., nx), for periodic states the shortest difference."""
        change = np.asarray(after - before, dtype=np.float64)
        for i, period in self.periods.items():
            change[..., i] = wrap(change[..., i], period)
        return change

    def unwrap_towards(self, states: Array, reference: Array) -> Array:
        """Return ``states`` (..., nx) with periodic ones moved by whole periods to be nearest to ``reference``."""
        return reference + self.difference(states, reference) if self.periods else states

    def wrap(self, states: Array) -> Array:
        """Return ``states`` (..., nx) with periodic ones within half a period of their neutral value."""
        return self.unwrap_towards(states, np.broadcast_to(self.neutral_state, np.shape(states)))

    def spread(self, states: Array) -> Array:
        """Return the standard deviation (nx,) of ``states`` (..., nx).

        That of a periodic state is the deviation from its mean direction, regardless of full turns.
        """
        axes = tuple(range(states.ndim - 1))
        if not self.periods:
            return np.asarray(states.std(axis=axes))
        middle = states.mean(axis=axes)
        for i, period in self.periods.items():
            angle = TURN / period * states[..., i]
            middle[i] = period / TURN * np.arctan2(np.sin(angle).mean(), np.cos(angle).mean())
        off = self.difference(states, np.broadcast_to(middle, states.shape))
        return np.asarray(np.sqrt(np.mean(off**2, axis=axes)))

    def unwrap(self, states: Array) -> Array:
        """Return the states of one run (T, nx) with periodic ones unwrapped; the first sample is unchanged."""
        if not self.periods:
            return states
        smooth = np.array(states, dtype=np.float64)
        for i, period in self.periods.items():
            smooth[:, i] = np.unwrap(smooth[:, i], period=period)
        return smooth

    def regressors(self, states: Array) -> Array:
        """Return ``states`` (..., nx) with each periodic one replaced by two columns, its sine and cosine."""
        columns: list[Array] = []
        for i in range(self.nx):
            if i in self.periods:
                angle = TURN / self.periods[i] * states[..., i]
                columns += [np.sin(angle), np.cos(angle)]
            else:
                columns.append(states[..., i])
        return np.stack(columns, axis=-1)

    @cached_property
    def limits(self) -> Array:
        """The lowest and highest value of each state, (2, nx), infinite where its channel has no limit."""
        return np.array([[c.low for c in self.states], [c.high for c in self.states]], dtype=np.float64)

    def within(self, states: Array) -> System:
        """Return this system without the limits that ``states`` (N, nx) exceed by over `NEAR_LIMIT` of their range."""
        margin = NEAR_LIMIT * np.ptp(states, axis=0)
        below, above = states.min(axis=0) < self.limits[0] - margin, states.max(axis=0) > self.limits[1] + margin
        if not (below | above).any():
            return self
        channels = [
            replace(channel, low=-np.inf if low else channel.low, high=np.inf if high else channel.high)
            for channel, low, high in zip(self.states, below, above, strict=True)
        ]
        return replace(self, states=tuple(channels))

    @property
    def limited(self) -> bool:
        """Whether a state has a limit."""
        return bool(np.isfinite(self.limits).any())

    @cached_property
    def regressor_names(self) -> tuple[str, ...]:
        """The names of the columns of `regressors`."""
        pairs = [(f"sin {c.name}", f"cos {c.name}") if c.period else (c.name,) for c in self.states]
        return tuple(name for pair in pairs for name in pair)

    def integrate(self, state: Array, acceleration: Array) -> Array:
        """Return the state one ``dt`` later: the exact inverse of `acceleration`."""
        if self.motion is None:
            return state + acceleration * self.dt
        return self.motion.integrate(state, acceleration, self.dt, self.state_names)

    def motion_kernel(self) -> MotionKernel | None:
        """Return the compiled form of the motion, `STRAIGHT` without a motion; None if the motion has none.

        Systems with such a motion run in NumPy, which is logged once for each kind of motion.
        """
        if self.motion is None:
            return STRAIGHT
        kernel = self.motion.kernel(self.state_names)
        if kernel is None:
            _remark_slow(self.motion.kind)
        return kernel

    def motion_gradient(self) -> MotionGradient:
        """Return the derivatives of the motion, of straight integration without one."""
        return StraightGradient() if self.motion is None else self.motion.gradient_form(self.state_names)

    def differences(self, other: System) -> tuple[str, ...]:
        """Return the differences to ``other`` that matter to a controller, as texts; empty if there are none.

        Compared are names, units and order of the channels, legal controls, the sampling time and the motion. Limits
        of states are not compared, because they depend on the recording.
        """
        found = []
        for what, mine, theirs in (("states", self.states, other.states), ("controls", self.controls, other.controls)):
            names = [", ".join(map(_described, side)) for side in (mine, theirs)]
            if names[0] != names[1]:
                found.append(f"{what} {names[0] or 'none'} against {names[1] or 'none'}")
        if len(self.controls) == len(other.controls):
            for own, its in zip(self.controls, other.controls, strict=True):
                legal = [(c.low, c.high, c.levels, c.neutral) for c in (own, its)]
                if own.name == its.name and legal[0] != legal[1]:
                    found.append(f"legal values of {own.name}: {_legal(own)} against {_legal(its)}")
        if not np.isclose(self.dt, other.dt, rtol=1e-9, atol=0.0):
            found.append(f"{1 / self.dt:g} Hz against {1 / other.dt:g} Hz")
        if self.motion != other.motion:
            found.append(f"motion {_motion_text(self)} against {_motion_text(other)}")
        if self.advance != other.advance:
            ours, others = ("after", "before") if self.advance else ("before", "after")
            found.append(f"controls logged {ours} against {others} each step")
        return tuple(found)

    def frame_rotation(self, state: Array) -> Array:
        """Return w(x) (..., nx), the rate of change of the state per second due to the turning frame; 0 without one."""
        if self.motion is None:
            return np.zeros_like(state)
        return self.motion.frame_rotation(state, self.state_names)

    def move(self, pose: Array, before: Array, after: Array, dt: float | None = None) -> Array:
        """Return the pose (..., n_pose) after ``dt`` s (default: the system's), given the states at both ends.

        Without a motion, ``pose`` is returned unchanged.
        """
        if self.motion is None:
            return pose
        return self.motion.move(pose, before, after, self.dt if dt is None else dt, self.state_names)

    def initial_pose(self, state: Array) -> Array:
        """Return the pose (..., n_pose) in the origin of a body with this ``state`` (..., nx)."""
        if self.motion is None:
            return np.zeros((*np.shape(state)[:-1], 0))
        return self.motion.initial_pose(state, self.state_names)

    def relative_pose(self, origin: Array, pose: Array) -> Array:
        """Return ``pose`` (..., n_pose) in the frame of ``origin`` (n_pose,); unchanged without a motion."""
        return pose if self.motion is None else self.motion.relative_pose(origin, pose)

    def with_dt(self, dt: float) -> System:
        """Return the same system sampled every ``dt`` seconds."""
        return replace(self, dt=dt)

    def to_dict(self) -> dict[str, Any]:
        """Return the system as strict JSON."""
        return {
            "name": self.name,
            "dt": self.dt,
            "states": [channel.to_dict() for channel in self.states],
            "controls": [channel.to_dict() for channel in self.controls],
            "motion": None if self.motion is None else self.motion.to_dict(),
            **({"advance": True} if self.advance else {}),
        }

    @classmethod
    def from_dict(cls, value: Mapping[str, Any]) -> System:
        """Undo `to_dict`."""
        return cls(
            states=tuple(Channel.from_dict(channel) for channel in value["states"]),
            controls=tuple(Channel.from_dict(channel) for channel in value["controls"]),
            dt=value["dt"],
            motion=None if value["motion"] is None else motion_from_dict(value["motion"]),
            name=value["name"],
            advance=value.get("advance", False),
        )


def rigid_body_states(motion: RigidBody, *, speed: float = np.inf, rate: float = np.inf) -> tuple[Channel, ...]:
    """Return the channels of a rigid body: velocities up to ``speed`` m/s, rates up to ``rate`` rad/s, and up."""
    names = list(motion.roles().values())
    return (
        *(Channel(name, "m/s", -speed, speed) for name in names[:3]),
        *(Channel(name, "rad/s", -rate, rate) for name in names[3:6]),
        *(Channel(name, low=-1.0, high=1.0) for name in names[6:8]),
        Channel(names[8], low=-1.0, high=1.0, neutral=motion.up, description="up along the third axis of the body"),
    )


def _motion_text(system: System) -> str:
    """Return the motion as in a column map, such as planar_body (forward = speed, yaw_rate = turn)."""
    if system.motion is None:
        return "none"
    fields = system.motion.to_dict()
    kind = fields.pop("kind", "")
    return f"{kind} ({', '.join(f'{role} = {state}' for role, state in fields.items())})"


def _described(channel: Channel) -> str:
    parts = [*([channel.unit] if channel.unit else []), *([f"period {channel.period:g}"] if channel.period else [])]
    return f"{channel.name} ({', '.join(parts)})" if parts else channel.name


def _legal(channel: Channel) -> str:
    return str(list(channel.levels)) if channel.levels else f"[{channel.low:g}, {channel.high:g}]"


def _channels(what: str, given: Iterable[Channel | str] | Channel) -> tuple[Channel, ...]:
    """Return ``given`` as channels; a single name is one channel."""
    listed = [given] if isinstance(given, (str, Channel)) else list(given)
    channels = [Channel(entry) if isinstance(entry, str) else entry for entry in listed]
    for channel in channels:
        if not isinstance(channel, Channel):
            raise InvalidSystem(f"system: expected Channel(...) or names as {what}, got {type(channel).__name__}")
    return tuple(channels)


@cache
def _remark_slow(kind: str) -> None:
    LOG.warning("motion %s has no compiled form: its systems run in NumPy, about ten times slower", kind)


SWITCH_MARGIN = 0.9
"""Factor that scales the boundaries between levels, which divide [-1, 1] equally.

Three levels then switch at -0.3 and 0.3, as in section 5.2 of the paper.
"""


@cache
def level_boundaries(n_levels: int) -> tuple[float, ...]:
    """Return the ``n_levels - 1`` outputs at which the level changes."""
    return tuple(SWITCH_MARGIN * np.arange(2 - n_levels, n_levels, 2) / n_levels)


def switch(raw: Array, levels: Sequence[float], control: Array) -> None:
    """Write the level that each output in [-1, 1] selects to ``control``; a boundary belongs to its inner side."""
    control[...] = levels[0]
    for boundary, level in zip(level_boundaries(len(levels)), levels[1:], strict=True):
        np.copyto(control, level, where=(raw >= boundary) if boundary < 0 else (raw > boundary))
