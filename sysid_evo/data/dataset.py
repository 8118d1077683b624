"""Data sets of several episodes of one system: construction, reading, splitting, subsampling, windows, storage."""

from __future__ import annotations

import hashlib
import json
import warnings
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from sysid_evo.carry import CarryLayout
from sysid_evo.data.frames import (
    HEADER,
    episodes_of_frame,
    frame_of,
    is_stored_dataset,
    read_samples,
    unreadable,
    write_samples,
)
from sysid_evo.data.reading import ADVANCED, Recording, paths_of, read_recording
from sysid_evo.data.trajectory import Trajectory, WindowIndex, Windows, as_columns, moving_rows, recording
from sysid_evo.display import Displayed, listed
from sysid_evo.errors import ArtefactError, DataWarning, IncompatibleSystem, InvalidArgument, InvalidData, ShapeError
from sysid_evo.system import Channel, System
from sysid_evo.types import Array, BoolArray, IntArray, check_shape

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class Transitions:
    """N single steps from ``carry`` (N, n_carry) under ``control`` (N, nu) to ``after`` (N, nx).

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


@dataclass(frozen=True, repr=False)
class Dataset(Displayed):
    """Episodes of one ``system``, sampled at its ``dt``; their lengths may differ.

    Periodic states are unwrapped within an episode. ``notes`` are remarks of the preparation on the recording. The
    conditions and rewards of episodes are not part of the ``fingerprint``, because they do not affect a fit.
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
                f"data set: expected Trajectory objects as episodes, got {other}. For arrays use "
                "Dataset.from_arrays(system, states, controls), for a table Dataset.from_pandas(system, frame)"
            )
        if not self.episodes:
            raise InvalidData("data set: expected at least one episode, got none")
        times = Counter(episode.name for episode in self.episodes)
        repeated = sorted(name for name, count in times.items() if count > 1)
        if repeated:
            raise InvalidData(f"data set: episode names must differ, repeated: {', '.join(map(repr, repeated))}")
        system = self.system
        if system.periods:
            smooth = [replace(episode, states=system.unwrap(episode.states)) for episode in self.episodes]
            object.__setattr__(self, "episodes", tuple(smooth))
        for episode in self.episodes:
            check_shape(f"states of {episode.name!r}", episode.states, (None, system.nx))
            check_shape(f"controls of {episode.name!r}", episode.controls, (None, system.nu))
            if episode.pose is not None:
                check_shape(f"pose of {episode.name!r}", episode.pose, (None, system.n_pose))
            if not np.isclose(episode.dt, system.dt, rtol=1e-9, atol=0.0):
                raise InvalidData(
                    f"episode {episode.name!r}: expected dt = {system.dt} s, that of the system, got {episode.dt} s"
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
        """Return a data set made from arrays: a list with one for each episode, or one array for one episode.

        States are (T + 1, nx). Controls are (T, nu), or (T + 1, nu) as in logs; the last row, which has no next state,
        is then dropped (with `System.advance` the first one). One state or one control may be 1-D. A system without
        controls needs none.

        Raises `ShapeError`, `InvalidArgument`.
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
            u = system.controls_of_steps(u) if len(u) == len(x) else u
            pose = None if poses is None else np.asarray(poses[i], dtype=np.float64)
            episodes.append(Trajectory(x, u, system.dt, pose, name))
        return cls(system, tuple(episodes))

    @classmethod
    def from_pandas(cls, system: System, frame: pd.DataFrame, *, episode: str | None = None) -> Dataset:
        """Return a data set made from a table with one column for each channel and one row for each ``dt``.

        ``episode`` is the column that names the episodes (default: all rows are one episode). Pose columns
        (``x``, ``y``, ``heading`` for a planar body) are used if all exist, like ``reward``, ``terminated`` and
        ``truncated``, see `to_pandas`.

        Raises `InvalidData` if a column is missing, or if the column ``time`` (s) or an index of times has steps that
        differ from ``dt`` by more than 5 %; `InvalidArgument` if ``frame`` is not a table.
        """
        _expect_system(system, "Dataset.from_pandas(system, frame)")
        return cls(system, tuple(episodes_of_frame(system, frame, episode=episode)))

    def to_pandas(self) -> pd.DataFrame:
        """Return a table with one row per sample: ``episode``, ``time`` (s), states, controls and pose by name.

        Recordings of an environment have the columns ``reward``, ``terminated`` and ``truncated`` of the step that
        begins with the sample. Controls and rewards of an episode's last sample are nan.
        ``Dataset.from_pandas(system, frame, episode="episode")`` is the inverse. Raises `InvalidData` if a channel has
        the name of another column.
        """
        return frame_of(self.system, self.episodes)

    @classmethod
    def read(
        cls,
        paths: str | Path | Iterable[str | Path],
        *,
        columns: str | Path | None = None,
        condition_column: str | None = None,
    ) -> Dataset:
        """Return the data set in one log, several logs, a folder of logs, or a stored data set; see `read_recording`.

        Each remark about a log is also issued as a `DataWarning`.
        """
        files = paths_of(paths)
        if len(files) == 1 and is_stored_dataset(files[0]):
            if columns is not None:
                raise InvalidArgument(f"{files[0]}: this is a stored data set, which needs no column map")
            if condition_column is not None:
                raise InvalidArgument(
                    f"{files[0]}: this is a stored data set; name its conditions when the logs are imported"
                )
            return cls.load(files[0])
        read = read_recording(files, columns=columns, condition_column=condition_column)
        for remark in read.remarks:
            warnings.warn(remark, DataWarning, stacklevel=2)
        return cls.of_recording(read)

    @classmethod
    def of_recording(cls, recording: Recording) -> Dataset:
        """Return the data set prepared from the logs of a recording, see `Recording.prepared`. Raises `InvalidData`."""
        return cls(recording.system, *recording.prepared())

    def facts(self) -> Mapping[str, str]:
        conditions = tuple(filter(None, self.conditions))
        steps = self.n_steps
        return {
            "episodes": f"{len(self):,} ({listed(self.names)})",
            "steps": f"{steps:,} of {self.system.dt:g} s, {self.duration:,.1f} s in all",
            **{{"name": "system"}.get(name, name): text for name, text in self.system.facts().items() if name != "dt"},
            **({"conditions": listed(conditions)} if conditions else {}),
            **({"notes": f"{len(self.notes)}, see notes"} if self.notes else {}),
        }

    def __len__(self) -> int:
        """Return the number of episodes."""
        return len(self.episodes)

    def __iter__(self) -> Iterator[Trajectory]:
        return iter(self.episodes)

    def __getitem__(self, chosen: int | slice | Sequence[int] | IntArray) -> Dataset:
        """Return the data set of the episodes with these numbers."""
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
        """The conditions of the episodes, each once, in the order of the recording; "" for episodes without one."""
        return tuple(dict.fromkeys(episode.condition for episode in self.episodes))

    def of_condition(self, *names: str) -> Dataset:
        """Return the episodes recorded in one of these conditions. Raises `InvalidArgument` if there are none."""
        unknown = [name for name in names if name not in self.conditions]
        if unknown or not names:
            raise InvalidArgument(
                f"no episode has the condition {', '.join(map(repr, unknown)) or '(none given)'}; there are "
                f"{', '.join(map(repr, self.conditions))}"
            )
        return self.with_episodes([episode for episode in self.episodes if episode.condition in names])

    def label_conditions(self, patterns: Mapping[str, str]) -> Dataset:
        """Return this data set with conditions assigned by the names of episodes.

        ``patterns`` maps each condition to a file pattern: ``{"wet": "*rain*", "dry": "2024-05-*"}``. A part such as
        ``log[0:400]`` has the name of its log. Raises `InvalidArgument` if a pattern matches no episode, or two
        patterns match the same one.
        """
        found: dict[str, str] = {}
        for name, pattern in patterns.items():
            fitting = [episode for episode in self.names if fnmatchcase(recording(episode), pattern)]
            if not fitting:
                raise InvalidArgument(
                    f"condition {name!r}: no episode matches {pattern!r}; there are {', '.join(self.names)}"
                )
            twice = [episode for episode in fitting if found.get(episode, name) != name]
            if twice:
                raise InvalidArgument(
                    f"condition {name!r}: {twice[0]!r} also matches the pattern of {found[twice[0]]!r}"
                )
            found.update(dict.fromkeys(fitting, name))
        return self.with_episodes([replace(e, condition=found.get(e.name, e.condition)) for e in self])

    @cached_property
    def moving(self) -> tuple[BoolArray, ...]:
        """For each episode, a mask (T + 1,) of the samples that are not part of a standstill (`moving_rows`)."""
        return tuple(moving_rows(episode.states, self.system) for episode in self.episodes)

    @cached_property
    def fingerprint(self) -> str:
        """SHA-256 of the system and of every number."""
        system = self.system.to_dict()
        for channel in (*system["states"], *system["controls"]):
            channel.pop("description", None)  # text for readers, not data
        digest = hashlib.sha256(json.dumps(system, sort_keys=True).encode())
        for episode in self.episodes:
            digest.update(episode.name.encode())
            for array in (episode.states, episode.controls, episode.pose):
                digest.update(b"none" if array is None else np.ascontiguousarray(array).reshape(-1).data)
        return digest.hexdigest()

    def advanced(self) -> Dataset:
        """Return the data set of the same system with `System.advance`: every step has the control of the next one.

        It suits records whose signals are all sampled at the same instant, if `inspect` reports that. Each episode
        loses its last step. Raises `InvalidArgument` if the system has ``advance`` already or no controls.
        """
        if self.system.advance or not self.system.nu:
            raise InvalidArgument(
                f"advanced: expected a system with controls and without advance, got "
                f"{'advance' if self.system.advance else 'no controls'}"
            )
        episodes = [
            replace(episode[:-1], controls=episode.controls[1:], name=episode.name)
            for episode in self.episodes
            if len(episode) > 1
        ]
        return Dataset(replace(self.system, advance=True), tuple(episodes), (*self.notes, ADVANCED))

    def with_episodes(self, episodes: Sequence[Trajectory]) -> Dataset:
        """Return a data set of the same system with other episodes."""
        return replace(self, episodes=tuple(episodes))

    def split(self, test: str | Sequence[str] | float) -> tuple[Dataset, Dataset]:
        """Return training and test set; ``test`` names episodes, or is the share of each episode's end to hold out.

        The name of a log, ``log``, includes its parts, such as ``log[0:400]``.
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
        names = self.names  # an episode can also be named by the log of which it is a part
        owners = [[name, *(name[:place] for place, letter in enumerate(name) if letter == "[")] for name in names]
        known = {name for of_episode in owners for name in of_episode}
        unknown = [name for name in test if name not in known]
        if unknown:
            stem = Path(unknown[0]).stem  # a file name was given instead of the episode's name
            meant = f" Did you mean {stem!r}?" if stem in known else ""
            raise InvalidArgument(
                f"split: no episode is called {', '.join(map(repr, unknown))}.{meant} There are {', '.join(self.names)}"
            )
        requested = set(test)
        chosen = [any(name in requested for name in of_episode) for of_episode in owners]
        if all(chosen) or not any(chosen):
            raise InvalidArgument("split: training and test set need an episode each; name some episodes, not all")
        return (
            self.with_episodes([e for e, hit in zip(self.episodes, chosen, strict=True) if not hit]),
            self.with_episodes([e for e, hit in zip(self.episodes, chosen, strict=True) if hit]),
        )

    def windows(
        self, horizon: int, *, stride: int = 1, history: int = 0, first: int | None = None, moving: bool = False
    ) -> Windows:
        """Return windows of ``horizon`` steps; `find_windows` returns their positions without copying samples."""
        places = self.find_windows(horizon, stride=stride, history=history, first=first, moving=moving)
        return places[:]

    def find_windows(
        self, horizon: int, *, stride: int = 1, history: int = 0, first: int | None = None, moving: bool = False
    ) -> WindowIndex:
        """Return the positions of windows of ``horizon`` steps, see `WindowIndex.of`; ``index[rows]`` cuts some.

        With ``moving``, only windows that start in motion.
        """
        if horizon < 1 or stride < 1 or history < 0:
            raise InvalidArgument(
                f"windows: expected horizon >= 1, stride >= 1, history >= 0, got {horizon}, {stride}, {history}"
            )
        rows = self.moving if moving else None
        return WindowIndex.of(self.episodes, horizon, stride=stride, history=history, first=first, rows=rows)

    def transitions(self, *, state_lags: int = 0, control_lags: int = 0, moving: bool = False) -> Transitions:
        """Return all single steps with ``state_lags`` earlier states and ``control_lags`` earlier controls.

        With ``moving``, standstills are left out, unless there is nothing else.
        """
        layout = CarryLayout(self.system.nx, self.system.nu, state_lags, control_lags)
        w = self.windows(1, history=layout.n_lags, moving=moving)
        if moving and not len(w):
            w = self.windows(1, history=layout.n_lags)
        if not len(w):
            raise InvalidData(f"data set: no episode is longer than {layout.n_lags} steps, the required history")
        carry = np.concatenate(layout.initial_parts(w.past_states, w.past_controls), axis=1)
        return Transitions(carry, w.controls[:, 0], w.states[:, 0])

    def save(self, path: str | Path) -> Path:
        """Write the data set to the folder ``path`` (``dataset.json``, ``samples.parquet``)."""
        return write_samples(Path(path), self.system, self.episodes, self.notes, self.fingerprint)

    @classmethod
    def load(cls, path: str | Path) -> Dataset:
        """Return the data set that `save` wrote. Raises `ArtefactError`."""
        system, episodes, notes, fingerprint = read_samples(Path(path))
        try:
            dataset = cls(system, episodes, notes)
        except ValueError as error:
            raise unreadable(Path(path), error) from error
        if dataset.fingerprint != fingerprint:
            raise ArtefactError(f"{path}: the samples do not match the fingerprint in {HEADER}; the files were changed")
        return dataset


def _expect_system(system: object, call: str) -> None:
    """Raise `InvalidArgument`, with the correct ``call``, unless ``system`` is a `System`."""
    if not isinstance(system, System):
        raise InvalidArgument(f"expected a System first, got {type(system).__name__}: {call}")


def _by_episode(arrays: npt.ArrayLike | Sequence[npt.ArrayLike], width: int) -> Sequence[npt.ArrayLike]:
    """Return one array per episode; a single array, or a list of rows of length ``width``, is one episode."""
    if isinstance(arrays, (list, tuple)) and arrays and np.ndim(arrays[0]) == 0:
        return [np.asarray(arrays)]
    if isinstance(arrays, (list, tuple)):
        return [np.asarray(arrays)] if arrays and all(np.shape(row) == (width,) for row in arrays) else arrays
    rows = np.asarray(arrays)
    return [rows] if rows.ndim < 3 else list(rows)


SHORTEST, LONGEST = 100, 1000
"""Range of consecutive steps in a block; short blocks would lose many windows at their ends."""

BLOCKS = 20
"""Least number of blocks from different times, unless they would be too short."""


def subsample(dataset: Dataset, most: int, rng: np.random.Generator) -> Dataset:
    """Return ``dataset`` if it has at most ``most`` steps, else a random part of it of at most ``most`` steps.

    The part consists of blocks of up to 1000 consecutive steps (a twentieth of ``most``, at least 100, if that is
    less), drawn without replacement and joined where they are adjacent, in the order of the recording. ``rng`` is used
    only if something is left out.
    """
    if dataset.n_steps <= most:
        return dataset
    block = min(LONGEST, max(SHORTEST, most // BLOCKS), most)
    owner, begin, end = [], [], []
    for number, episode in enumerate(dataset):
        edges = np.linspace(0, len(episode), -(-len(episode) // block) + 1).astype(np.int64)
        owner.append(np.full(len(edges) - 1, number))
        begin.append(edges[:-1])
        end.append(edges[1:])
    owners, begins, ends = (np.concatenate(part) for part in (owner, begin, end))
    order = rng.permutation(len(owners))
    kept = np.sort(order[np.cumsum((ends - begins)[order]) <= most])
    first = np.concatenate([[True], np.diff(kept) > 1]) | np.concatenate([[True], np.diff(owners[kept]) > 0])
    runs = np.split(kept, np.flatnonzero(first)[1:])
    blocks = [dataset.episodes[owners[run[0]]][int(begins[run[0]]) : int(ends[run[-1]])] for run in runs]
    return dataset.with_episodes(blocks)


MAX_STEP_DEVIATION = 1e-3
"""Largest deviation of a time step from the mean, as a share of the mean, in equally spaced times."""


def from_samples(
    x: npt.ArrayLike | Sequence[npt.ArrayLike],
    t: float | npt.ArrayLike | Sequence[npt.ArrayLike],
    u: npt.ArrayLike | Sequence[npt.ArrayLike] | None = None,
    feature_names: Sequence[str] | None = None,
) -> Dataset:
    """Return a data set made from arrays as in pysindy, with states x0, x1, ... and controls u0, u1, ...

    ``x`` is (T + 1, nx), or a list with one for each trajectory; one state may be 1-D. ``t`` is the time step in
    seconds, or the times (T + 1,), a list of them for a list. ``u`` is (T + 1, nu) or (T, nu), held from one
    sample to the next. ``feature_names`` replaces the names of the states and controls, in this order.

    Raises `InvalidData` if the times are not equally spaced or do not match the samples, `ShapeError`,
    `InvalidArgument`.
    """
    if isinstance(x, Dataset) or (isinstance(x, (list, tuple)) and any(isinstance(part, Dataset) for part in x)):
        raise InvalidArgument("fit: a Dataset has its own times and controls: expected no t and no u")
    runs = [np.asarray(as_columns(part)) for part in _listed(x)]
    pushes = None if u is None else [np.asarray(as_columns(part)) for part in _listed(u)]
    for what, arrays in (("x", runs), ("u", pushes or [])):
        if any(array.ndim != 2 for array in arrays):
            shapes = ", ".join(str(array.shape) for array in arrays)
            raise ShapeError(f"{what}: expected (samples, columns), or a list of such arrays, got {shapes}")
    n_controls = 0 if pushes is None else pushes[0].shape[1]
    numbered = (*(f"x{i}" for i in range(runs[0].shape[1])), *(f"u{i}" for i in range(n_controls)))
    names = numbered if feature_names is None else tuple(feature_names)
    if len(names) != len(numbered):
        raise InvalidArgument(
            f"feature_names: expected {len(numbered)} names, for {', '.join(numbered)}, got {len(names)}"
        )
    channels = tuple(map(Channel, names))
    system = System(channels[: runs[0].shape[1]], channels[runs[0].shape[1] :], _step(t, runs))
    return Dataset.from_arrays(system, list(runs), None if pushes is None else list(pushes))


def _listed(given: npt.ArrayLike | Sequence[npt.ArrayLike]) -> list[npt.ArrayLike]:
    """Return one entry for each trajectory; an array, or a list of numbers or of rows, is one trajectory."""
    if isinstance(given, (list, tuple)) and any(isinstance(part, np.ndarray) for part in given):
        return list(given)
    return [np.asarray(given)]


def _step(t: float | npt.ArrayLike | Sequence[npt.ArrayLike], runs: Sequence[Array]) -> float:
    """Return the common time step of all runs, in seconds."""
    if isinstance(t, (int, float, np.integer, np.floating)):
        return float(t)
    times = [np.asarray(part, dtype=np.float64).ravel() for part in _listed(t)]
    if [len(part) for part in times] != [len(run) for run in runs]:
        raise InvalidData(
            f"t: expected one time for each sample ({', '.join(str(len(run)) for run in runs)}), or the time step, got "
            f"{', '.join(str(len(part)) for part in times)}"
        )
    steps = np.concatenate([np.diff(part) for part in times])
    if not len(steps):
        raise InvalidData("t: expected at least two samples, got one")
    dt = float(steps.mean())
    worst = float(steps[np.argmax(np.abs(steps - dt))])
    if not abs(worst - dt) <= MAX_STEP_DEVIATION * abs(dt):
        raise InvalidData(
            f"t: expected equally spaced times, got a mean step of {dt:g} s and one of {worst:g} s; write "
            "the log to a file and resample it with `sysid-evo import`"
        )
    return dt


def as_dataset(given: object, caller: str, *, of: System | None = None) -> Dataset:
    """Return ``given`` as one data set; a list is joined. Raises `InvalidData` that shows the correct call.

    With ``of`` it must have that system's channels, else `IncompatibleSystem`.
    """
    if isinstance(given, Dataset):
        here = given.system
        if of is not None and (here.state_names, here.control_names) != (of.state_names, of.control_names):
            names = [", ".join((*one.state_names, *one.control_names)) for one in (of, here)]
            raise IncompatibleSystem(f"{caller}: the model has the channels {names[0]}, the data have {names[1]}")
        if of is not None and abs(here.dt - of.dt) > MAX_STEP_DEVIATION * of.dt:
            raise IncompatibleSystem(
                f"{caller}: the model makes steps of {of.dt:g} s, the data have {here.dt:g} s: fit it to such data, or "
                "resample them"
            )
        if of is not None and here.advance != of.advance:
            raise IncompatibleSystem(
                f"{caller}: expected data {'with' if of.advance else 'without'} advance, as the model was fitted to; "
                f"{'use Dataset.advanced()' if of.advance else 'import them again without it'}"
            )
        return given
    parts = list(given) if isinstance(given, (list, tuple)) else []
    if parts and all(isinstance(part, Dataset) for part in parts):
        if any(part.system != parts[0].system for part in parts):
            raise InvalidData(f"{caller}: expected data sets of one system, got several systems")
        return parts[0].with_episodes([episode for part in parts for episode in part])
    if isinstance(given, Trajectory) or any(isinstance(part, Trajectory) for part in parts):
        hint = "make a data set from episodes with Dataset(system, episodes)"
    elif type(given).__module__.split(".")[0] in ("pandas", "polars"):
        hint = "make one from a table with Dataset.from_pandas(system, table)"
    else:
        hint = "make one from arrays with Dataset.from_arrays(system, states, controls), or use fit(x, t=dt, u=u)"
    raise InvalidData(f"{caller}: expected a Dataset, got a {type(given).__name__}: {hint}")
