"""Episodes (states, controls, pose), detection of standstills, windows of episodes."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from sysid_evo.display import Displayed
from sysid_evo.errors import InvalidData
from sysid_evo.motion import PlanarBody
from sysid_evo.system import System
from sysid_evo.types import Array, BoolArray, IntArray, check_shape

TERMINATED, TRUNCATED = "terminated", "truncated"
"""How an episode of an environment ends."""


@dataclass(frozen=True, repr=False)
class Trajectory(Displayed):
    """One episode of T steps.

    ``states`` is (T + 1, nx), ``controls`` (T, nu): ``controls[k]`` is held from k dt to (k + 1) dt
    and takes ``states[k]`` to ``states[k + 1]``. ``dt`` is in seconds. ``pose`` is (T + 1, n_pose)
    in the units of the system's motion, or None. ``condition`` is the operating condition, such as the floor or the
    battery, or "". A single state or control may be 1-D.

    ``rewards`` (T,) are those of an environment, or None; ``ending`` is "terminated" if its last step ended the
    episode, "truncated" if the time was up, else "". Models do not use them. Raises `ShapeError` or `InvalidData`.
    """

    states: Array
    controls: Array
    dt: float
    pose: Array | None = None
    name: str = ""
    condition: str = ""
    rewards: Array | None = None
    ending: str = ""

    def __post_init__(self) -> None:
        states = check_shape(f"states of {self.name!r}", as_columns(self.states), (None, None))
        controls = check_shape(f"controls of {self.name!r}", as_columns(self.controls), (len(states) - 1, None))
        object.__setattr__(self, "states", states)
        object.__setattr__(self, "controls", controls)
        if self.pose is not None:
            object.__setattr__(self, "pose", check_shape(f"pose of {self.name!r}", self.pose, (len(states), None)))
        if self.rewards is not None:
            rewards = check_shape(f"rewards of {self.name!r}", self.rewards, (len(controls),))
            object.__setattr__(self, "rewards", rewards)
        if self.ending not in ("", TERMINATED, TRUNCATED):
            raise InvalidData(
                f"episode {self.name!r}: expected the ending {TERMINATED!r}, {TRUNCATED!r} or none, got {self.ending!r}"
            )
        if len(controls) < 1:
            raise InvalidData(f"episode {self.name!r}: expected at least one step, got {len(states)} sample(s)")
        column = None if self.rewards is None else self.rewards[:, None]
        for what, array in (("state", states), ("control", controls), ("pose", self.pose), ("reward", column)):
            if array is not None and not np.isfinite(array).all():
                row, column = np.argwhere(~np.isfinite(array))[0]
                raise InvalidData(f"episode {self.name!r}: {what} {column} at sample {row} is {array[row, column]}")

    def facts(self) -> Mapping[str, str]:
        columns = {"states": self.states.shape[1], "controls": self.controls.shape[1]}
        columns |= {} if self.pose is None else {"pose": self.pose.shape[1]}
        return {
            **({"name": self.name} if self.name else {}),
            "steps": f"{len(self)} of {self.dt:g} s, {self.duration:g} s in all",
            **{what: f"{count} columns" if count != 1 else "1 column" for what, count in columns.items()},
            **({"condition": self.condition} if self.condition else {}),
            **({} if self.total_reward is None else {"total reward": f"{self.total_reward:.6g}"}),
            **({"ending": self.ending} if self.ending else {}),
        }

    @property
    def total_reward(self) -> float | None:
        """Sum of the rewards, the return of the episode; None without rewards."""
        return None if self.rewards is None else float(self.rewards.sum())

    def __len__(self) -> int:
        """Return the number of steps, T."""
        return len(self.controls)

    @property
    def duration(self) -> float:
        """Length in seconds."""
        return len(self) * self.dt

    def __getitem__(self, steps: slice) -> Trajectory:
        """Return the episode of a range of steps, including the state at its end."""
        if not isinstance(steps, slice) or steps.step not in (None, 1):
            raise InvalidData("episode: expected a plain range of steps, like episode[10:50]")
        first, last, _ = steps.indices(len(self))
        return replace(
            self,
            states=self.states[first : last + 1],
            controls=self.controls[first:last],
            pose=None if self.pose is None else self.pose[first : last + 1],
            name=f"{self.name}[{first}:{last}]",
            rewards=None if self.rewards is None else self.rewards[first:last],
            ending=self.ending if last == len(self) else "",
        )


def reward_digest(episodes: Iterable[Trajectory]) -> str:
    """Return the SHA-256 of rewards and endings, which are not part of a data set's fingerprint; "" without rewards."""
    digest, found = hashlib.sha256(), False
    for episode in episodes:
        digest.update(f"{episode.name} {episode.ending}".encode())
        if episode.rewards is not None:
            digest.update(np.ascontiguousarray(episode.rewards).data)
            found = True
    return digest.hexdigest() if found else ""


def recording(name: str) -> str:
    """Return the name of the recording of which ``name`` is a part: ``log`` for ``log[0:400]``."""
    return name.split("[")[0]


def as_columns(values: npt.ArrayLike) -> npt.ArrayLike:
    """Return 1-D ``values``, those of a single channel, as one column; anything else unchanged."""
    return np.asarray(values)[:, None] if np.ndim(values) == 1 else values


STANDSTILL_SPEED = 0.05  # m/s
STANDSTILL_YAW_RATE = 0.1  # rad/s
STANDSTILL_TIME = 0.5  # s
MARGIN_TIME = 0.25  # s, counted as motion on either side, so that starts and stops are included


def moving_rows(states: Array, system: System) -> BoolArray:
    """Return a mask (T + 1,) that is false in standstills of a planar body.

    A standstill is at least 0.5 s below 0.05 m/s and 0.1 rad/s; its first and last 0.25 s count as
    moving. A system without a planar motion always moves.
    """
    if not isinstance(system.motion, PlanarBody):
        return np.ones(len(states), dtype=bool)
    forward, lateral, yaw_rate = system.motion.indices(system.state_names)
    speed = np.abs(states[:, forward]) if lateral is None else np.hypot(states[:, forward], states[:, lateral])
    slow = (speed < STANDSTILL_SPEED) & (np.abs(states[:, yaw_rate]) < STANDSTILL_YAW_RATE)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], slow, [False]]).astype(np.int8)))
    moving = np.ones(len(states), dtype=bool)
    margin = round(MARGIN_TIME / system.dt)
    begin, end = edges.reshape(-1, 2).T
    long = end - begin >= round(STANDSTILL_TIME / system.dt)
    for first, last in zip(begin[long].tolist(), end[long].tolist(), strict=True):
        first = first + margin if first > 0 else first
        last = last - margin if last < len(states) else last
        moving[first : max(first, last)] = False
    return moving


INDICES = 2**16
"""Number of samples that are copied at a time."""


@dataclass(frozen=True)
class Windows:
    """N windows of H steps, each with L samples of history and within one episode.

    ``past_states`` (N, L + 1, nx) ends at the start of the window, ``past_controls`` (N, L, nu) at
    the sample before it; ``controls`` (N, H, nu) lead to ``states`` (N, H, nx). ``episode`` and
    ``start`` (N,) are the episode and the sample at which each window begins.
    """

    past_states: Array
    past_controls: Array
    controls: Array
    states: Array
    episode: IntArray
    start: IntArray

    def __len__(self) -> int:
        return len(self.start)

    @property
    def start_states(self) -> Array:
        """The measured state at the start of each window, (N, nx)."""
        return self.past_states[:, -1]

    def __getitem__(self, rows: IntArray | slice) -> Windows:
        return Windows(**{name: array[rows] for name, array in vars(self).items()})


@dataclass(frozen=True)
class WindowIndex:
    """Positions of N windows of ``horizon`` steps with ``history`` earlier samples; ``index[rows]`` copies some.

    ``states`` (M + E, nx) and ``controls`` (M, nu) are those of all E episodes, concatenated; a window begins at sample
    ``start`` (N,) of ``episode`` (N,), which is row ``place`` (N,) of ``states``.
    """

    states: Array
    controls: Array
    episode: IntArray
    start: IntArray
    place: IntArray
    horizon: int
    history: int

    @classmethod
    def of(
        cls,
        episodes: Sequence[Trajectory],
        horizon: int,
        *,
        stride: int = 1,
        history: int = 0,
        first: int | None = None,
        rows: Sequence[BoolArray] | None = None,
    ) -> WindowIndex:
        """Return the windows of ``horizon`` steps with ``history`` samples before them, every ``stride`` samples.

        The first window starts at sample ``first``, or at ``history`` if that is later, so that its whole history is
        measured. ``rows`` are masks (T + 1,), one for each episode: windows whose start is false there are left out.
        """
        first = history if first is None else max(first, history)
        starts = []
        for number, episode in enumerate(episodes):
            start = np.arange(first, len(episode) - horizon + 1, stride, dtype=np.int64)
            starts.append(start if rows is None else start[rows[number][start]])
        counts = [len(start) for start in starts]
        begins = np.cumsum([0, *(len(episode) + 1 for episode in episodes)])[:-1]
        start = np.concatenate(starts)
        return cls(
            _joined([episode.states for episode in episodes]),
            _joined([episode.controls for episode in episodes]),
            np.repeat(np.arange(len(episodes), dtype=np.int64), counts),
            start,
            start + np.repeat(begins, counts),
            horizon,
            history,
        )

    def __len__(self) -> int:
        return len(self.start)

    @property
    def last_states(self) -> Array:
        """The state after the last step of each window, (N, nx)."""
        return self.states[self.place + self.horizon]

    def __getitem__(self, rows: IntArray | slice) -> Windows:
        """Return the windows ``rows``."""
        episode, start, place = self.episode[rows], self.start[rows], self.place[rows]
        before, ahead = np.arange(-self.history, 1), np.arange(self.horizon)
        return Windows(
            _cut(self.states, place, before),
            _cut(self.controls, place - episode, before[:-1]),
            _cut(self.controls, place - episode, ahead),
            _cut(self.states, place, ahead + 1),
            episode,
            start,
        )


def evenly_spaced(count: int, most: int, *, nearest: bool = False) -> IntArray:
    """Return at most ``most`` of the rows 0 to ``count`` - 1, evenly spaced, including the first and the last.

    Positions between two rows are rounded down, or to the ``nearest``.
    """
    if count <= most:
        return np.arange(count, dtype=np.int64)
    places = np.linspace(0, count - 1, most)
    return (places.round() if nearest else places).astype(np.int64)


def _joined(arrays: Sequence[Array]) -> Array:
    return arrays[0] if len(arrays) == 1 else np.concatenate(arrays)


def _cut(samples: Array, place: IntArray, around: IntArray) -> Array:
    """Return the samples (N, H, c) ``around`` (H,) each ``place`` (N,), without index arrays of that size."""
    found = np.empty((len(place), len(around), samples.shape[1]))
    at_once = max(1, INDICES // max(1, len(around)))
    for begin in range(0, len(place), at_once):
        part = slice(begin, begin + at_once)
        np.take(samples, place[part, None] + around, axis=0, out=found[part], mode="clip")
    return found
