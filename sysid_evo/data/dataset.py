"""Several episodes of one system: made from arrays or tables, split, windowed, stored."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from sysid_evo.arrays import Array, BoolArray, check_shape
from sysid_evo.data.moving import moving_rows
from sysid_evo.data.trajectory import Trajectory, as_columns
from sysid_evo.data.windows import WindowPlaces, Windows
from sysid_evo.errors import InvalidArgument, InvalidData, ShapeError
from sysid_evo.lags import CarryLayout
from sysid_evo.system import System

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr


@dataclass(frozen=True)
class Transitions:
    """N single steps: ``carry`` (N, n_carry) under ``control`` (N, nu) leads to ``after`` (N, nx).

    ``carry`` is the state, then earlier states, then earlier controls, newest first.
    """

    carry: Array
    control: Array
    after: Array

    def __len__(self) -> int:
        return len(self.after)

    @property
    def state(self) -> Array:
        """The state before each step, (N, nx)."""
        return self.carry[:, : self.after.shape[1]]


@dataclass(frozen=True)
class Dataset:
    """Episodes of possibly unequal length, all of one ``system`` and at its ``dt``.

    Periodic states run on without jumps within an episode, as if they were not.
    ``notes`` list what the preparation has to say about the recording. Conditions of episodes are no part of the
    ``fingerprint``: they change nothing in what a model learns.
    """

    system: System
    episodes: tuple[Trajectory, ...]
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        _expect_system(self.system, "Dataset(system, episodes)")
        object.__setattr__(self, "episodes", tuple(self.episodes))
        other = next((type(entry).__name__ for entry in self.episodes if not isinstance(entry, Trajectory)), None)
        if other is not None:
            raise InvalidArgument(
                f"data set: expected Trajectory objects as episodes, got {other}. Arrays become a data set by "
                "Dataset.from_arrays(system, states, controls), a table by Dataset.from_pandas(system, frame)"
            )
        if not self.episodes:
            raise InvalidData("data set: expected at least one episode, got none")
        times = Counter(episode.name for episode in self.episodes)
        repeated = sorted(name for name, count in times.items() if count > 1)
        if repeated:
            raise InvalidData(f"data set: episode names must differ, repeated: {', '.join(map(repr, repeated))}")
        system = self.system
        if system.periods:
            smooth = [replace(episode, states=system.unwrapped(episode.states)) for episode in self.episodes]
            object.__setattr__(self, "episodes", tuple(smooth))
        for episode in self.episodes:
            check_shape(f"states of {episode.name!r}", episode.states, (None, system.nx))
            check_shape(f"controls of {episode.name!r}", episode.controls, (None, system.nu))
            if episode.pose is not None:
                check_shape(f"pose of {episode.name!r}", episode.pose, (None, system.n_pose))
            if not np.isclose(episode.dt, system.dt, rtol=1e-9, atol=0.0):
                raise InvalidData(
                    f"episode {episode.name!r}: expected dt = {system.dt} s as the system has, got {episode.dt} s"
                )

    @classmethod
    def from_arrays(
        cls,
        system: System,
        states: npt.ArrayLike | Sequence[npt.ArrayLike],
        controls: npt.ArrayLike | Sequence[npt.ArrayLike] | None = None,
        *,
        poses: npt.ArrayLike | Sequence[npt.ArrayLike] | None = None,
        names: Sequence[str] | None = None,
    ) -> Dataset:
        """Make a data set from arrays: a list with one for each episode, or one array for one episode.

        States are (T + 1, nx). Controls are (T, nu), or (T + 1, nu) as logs have them: the last row
        then leads nowhere and is left out. One state or one control may be 1-D. A system without
        controls needs none. Raises `ShapeError`, `InvalidArgument`.
        """
        _expect_system(system, "Dataset.from_arrays(system, states, controls)")
        states = _by_episode(states, system.nx)
        if controls is None:
            if system.nu:
                raise InvalidArgument(
                    f"from_arrays: the system has the controls {', '.join(system.control_names)}, got none: "
                    "Dataset.from_arrays(system, states, controls)"
                )
            controls = [np.empty((max(len(np.asarray(x)) - 1, 0), 0)) for x in states]
        one = len(states) == 1
        controls = _by_episode(controls, system.nu if one else 0)
        poses = None if poses is None else _by_episode(poses, system.n_pose if one else 0)
        if len(states) != len(controls) or (poses is not None and len(poses) != len(states)):
            raise ShapeError(
                f"expected as many control (and pose) arrays as state arrays, got {len(states)} states, "
                f"{len(controls)} controls" + ("" if poses is None else f", {len(poses)} poses")
            )
        names = [f"episode-{i}" for i in range(len(states))] if names is None else names
        episodes = []
        for i, (x, u, name) in enumerate(zip(states, controls, names, strict=True)):
            x = check_shape(f"states of {name!r}", as_columns(x), (None, system.nx))
            u = check_shape(f"controls of {name!r}", as_columns(u), (None, system.nu))
            u = u[:-1] if len(u) == len(x) else u
            pose = None if poses is None else np.asarray(poses[i], dtype=np.float64)
            episodes.append(Trajectory(x, u, system.dt, pose, name))
        return cls(system, tuple(episodes))

    @classmethod
    def from_pandas(cls, system: System, frame: pd.DataFrame, *, episode: str | None = None) -> Dataset:
        """Make a data set from a table with one column for each channel, one row for each ``dt``.

        ``episode`` is the column that names the episodes (default: all rows are one). Pose columns
        (``x``, ``y``, ``heading`` for a planar body) are taken if all are there. Raises `InvalidData`
        if a column is missing, or if a column ``time`` (s) or an index of times says that rows are not
        ``dt`` apart (5 %), `InvalidArgument` if there is no table.
        """
        _expect_system(system, "Dataset.from_pandas(system, frame)")
        from sysid_evo.data.frames import from_frame

        return from_frame(system, frame, episode=episode)

    def to_pandas(self) -> pd.DataFrame:
        """Return one row a sample: the columns ``episode`` and ``time`` (s), then states, controls and pose by name.

        The controls of an episode's last sample are nan, as nobody held them any longer.
        ``Dataset.from_pandas(system, frame, episode="episode")`` makes the data set again. Raises `InvalidData` if a
        channel has the name of another column.
        """
        from sysid_evo.data.frames import to_frame

        return to_frame(self)

    def to_xarray(self) -> xr.Dataset:
        """Return one variable (episode, time) for each channel, with its unit and its role (state, control, pose).

        Shorter episodes end in nan; the coordinate ``length`` says how many samples each has, ``condition`` when or
        where it was recorded. Raises `MissingExtra` without xarray, `InvalidData` if a channel has the name of a
        coordinate.
        """
        from sysid_evo.data.frames import to_labelled

        return to_labelled(self)

    @classmethod
    def read(
        cls,
        paths: str | Path | Iterable[str | Path],
        *,
        columns: str | Path | None = None,
        condition_column: str | None = None,
    ) -> Dataset:
        """Read a log, several, a folder of logs, or what `save` wrote, see `read_recording`."""
        from sysid_evo.data.reading import read_dataset

        return read_dataset(paths, columns=columns, condition_column=condition_column)

    def __len__(self) -> int:
        """Return the number of episodes."""
        return len(self.episodes)

    def __iter__(self) -> Iterator[Trajectory]:
        return iter(self.episodes)

    def __getitem__(self, chosen: int | slice | Sequence[int]) -> Dataset:
        """Return the data set of these episodes only, by number."""
        if isinstance(chosen, slice):
            return self.with_episodes(self.episodes[chosen])
        return self.with_episodes([self.episodes[i] for i in np.atleast_1d(chosen)])

    @property
    def n_steps(self) -> int:
        """Number of steps in all episodes."""
        return sum(len(episode) for episode in self.episodes)

    @property
    def duration(self) -> float:
        """Length of all episodes in seconds."""
        return self.n_steps * self.system.dt

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(episode.name for episode in self.episodes)

    @property
    def conditions(self) -> tuple[str, ...]:
        """The conditions of the episodes, each once, in the order of the recording; "" of those without."""
        return tuple(dict.fromkeys(episode.condition for episode in self.episodes))

    def of_condition(self, *names: str) -> Dataset:
        """Return the episodes that were recorded in one of these conditions. Raises `InvalidArgument` without any."""
        unknown = [name for name in names if name not in self.conditions]
        if unknown or not names:
            raise InvalidArgument(
                f"no episode has the condition {', '.join(map(repr, unknown)) or 'that was asked for'}; there are "
                f"{', '.join(map(repr, self.conditions))}"
            )
        return self.with_episodes([episode for episode in self.episodes if episode.condition in names])

    def labelled(self, patterns: Mapping[str, str]) -> Dataset:
        """Return this data set with a condition for each episode whose name fits one of the ``patterns``, by name.

        ``{"wet": "*rain*", "dry": "2024-05-*"}``; a piece such as ``log[0:400]`` goes by the name of its log. Raises
        `InvalidArgument` if a pattern fits nothing, or two fit one episode.
        """
        from sysid_evo.data.conditions import labelled

        return labelled(self, patterns)

    @cached_property
    def moving(self) -> tuple[BoolArray, ...]:
        """For each episode, which samples (T + 1,) are not part of a standstill (`moving_rows`)."""
        return tuple(moving_rows(episode.states, self.system) for episode in self.episodes)

    @cached_property
    def fingerprint(self) -> str:
        """SHA-256 of the system and of every number."""
        digest = hashlib.sha256(json.dumps(self.system.to_dict(), sort_keys=True).encode())
        for episode in self.episodes:
            digest.update(episode.name.encode())
            for array in (episode.states, episode.controls, episode.pose):
                digest.update(b"none" if array is None else np.ascontiguousarray(array).reshape(-1).data)
        return digest.hexdigest()

    def with_episodes(self, episodes: Sequence[Trajectory]) -> Dataset:
        """Return a data set of the same system with other episodes."""
        return replace(self, episodes=tuple(episodes))

    def split(self, test: str | Sequence[str] | float) -> tuple[Dataset, Dataset]:
        """Return training and test set: by one episode's name, several, or the last share of time of each episode.

        A piece of an episode, such as ``log[0:400]``, goes where its name ``log`` goes.
        """
        if isinstance(test, (int, float)):
            if not 0.0 < test < 1.0:
                raise InvalidArgument(f"split: expected a share between 0 and 1, got {test}")
            cuts = [len(episode) - round(test * len(episode)) for episode in self.episodes]
            pairs = [(e[:cut], e[cut:]) for e, cut in zip(self.episodes, cuts, strict=True) if 0 < cut < len(e)]
            if not pairs:
                raise InvalidData(f"split: every episode is too short to split at {test}")
            return self.with_episodes([a for a, _ in pairs]), self.with_episodes([b for _, b in pairs])
        test = [test] if isinstance(test, str) else list(test)
        owners = [_owners(episode.name) for episode in self.episodes]
        known = {name for of_episode in owners for name in of_episode}
        unknown = [name for name in test if name not in known]
        if unknown:
            raise InvalidArgument(
                f"split: no episode is called {', '.join(map(repr, unknown))}; there are {', '.join(self.names)}"
            )
        asked = set(test)
        chosen = [any(name in asked for name in of_episode) for of_episode in owners]
        if all(chosen) or not any(chosen):
            raise InvalidArgument("split: both sides need an episode; name some, not all or none, for the test")
        return (
            self.with_episodes([e for e, hit in zip(self.episodes, chosen, strict=True) if not hit]),
            self.with_episodes([e for e, hit in zip(self.episodes, chosen, strict=True) if hit]),
        )

    def windows(
        self, horizon: int, *, stride: int = 1, history: int = 0, first: int | None = None, moving: bool = False
    ) -> Windows:
        """Cut windows of ``horizon`` steps, see `window_places`, which takes no memory for windows never looked at."""
        places = self.window_places(horizon, stride=stride, history=history, first=first, moving=moving)
        return places[:]

    def window_places(
        self, horizon: int, *, stride: int = 1, history: int = 0, first: int | None = None, moving: bool = False
    ) -> WindowPlaces:
        """Find windows of ``horizon`` steps, see `WindowPlaces.of`; with ``moving``, only those that start in motion.

        ``places[rows]`` cuts some of them.
        """
        if horizon < 1 or stride < 1 or history < 0:
            raise InvalidArgument(
                f"windows: expected horizon >= 1, stride >= 1, history >= 0, got {horizon}, {stride}, {history}"
            )
        rows = self.moving if moving else None
        return WindowPlaces.of(self.episodes, horizon, stride=stride, history=history, first=first, rows=rows)

    def transitions(self, *, state_lags: int = 0, control_lags: int = 0, moving: bool = False) -> Transitions:
        """Return every single step with that many earlier states and controls.

        With ``moving``, only those that are no standstill, unless there is nothing else.
        """
        layout = CarryLayout(self.system.nx, self.system.nu, state_lags, control_lags)
        w = self.windows(1, history=layout.history, moving=moving)
        if moving and not len(w):
            w = self.windows(1, history=layout.history)
        if not len(w):
            raise InvalidData(f"data set: no episode is longer than {layout.history} steps, the history asked for")
        carry = np.concatenate(layout.started(w.past_states, w.past_controls), axis=1)
        return Transitions(carry, w.controls[:, 0], w.states[:, 0])

    def save(self, path: str | Path) -> Path:
        """Write the data set into the folder ``path`` (``dataset.json``, ``samples.parquet``)."""
        from sysid_evo.data.storage import save_dataset

        return save_dataset(self, Path(path))

    @classmethod
    def load(cls, path: str | Path) -> Dataset:
        """Read what `save` wrote. Raises `ArtefactError`."""
        from sysid_evo.data.storage import load_dataset

        return load_dataset(Path(path))


def _expect_system(system: object, call: str) -> None:
    """Raise `InvalidArgument`, which names the right ``call``, unless ``system`` is one."""
    if not isinstance(system, System):
        raise InvalidArgument(f"expected a System first, got {type(system).__name__}: {call}")


def _by_episode(arrays: npt.ArrayLike | Sequence[npt.ArrayLike], width: int) -> Sequence[npt.ArrayLike]:
    """Return a list with one array for each episode; one array or list of rows, ``width`` long, is one episode."""
    if isinstance(arrays, (list, tuple)) and arrays and np.ndim(arrays[0]) == 0:
        return [np.asarray(arrays)]
    if isinstance(arrays, (list, tuple)):
        return [np.asarray(arrays)] if arrays and all(np.shape(row) == (width,) for row in arrays) else arrays
    rows = np.asarray(arrays)
    return [rows] if rows.ndim < 3 else list(rows)


def _owners(episode: str) -> list[str]:
    """Return the names by which an episode goes: its own, and those of which it is a piece."""
    return [episode, *(episode[:place] for place, letter in enumerate(episode) if letter == "[")]
