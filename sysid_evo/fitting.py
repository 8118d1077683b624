"""What surrounds the `fit` of every family: what may be given to it, and what is undone when it fails."""

from __future__ import annotations

import functools
import time
import warnings
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from importlib.metadata import entry_points
from typing import TYPE_CHECKING, cast

import numpy as np
import numpy.typing as npt

from sysid_evo.data import Dataset
from sysid_evo.data.thinning import thinned
from sysid_evo.data.trajectory import Trajectory
from sysid_evo.data.unnamed import from_samples
from sysid_evo.errors import DataWarning, IncompatibleSystem, InvalidArgument, InvalidData
from sysid_evo.extras import DISTRIBUTION, check_installed
from sysid_evo.progress import Progress, shown
from sysid_evo.system import System

if TYPE_CHECKING:
    from sysid_evo.dynamics import DynamicsModel


def recorded(fit: Callable[..., DynamicsModel]) -> Callable[..., DynamicsModel]:
    """Wrap a family's `fit`: check what it is given, record system and envelope, undo what is interrupted."""

    @functools.wraps(fit)
    def wrapped(
        self: DynamicsModel,
        dataset: Dataset | Sequence[Dataset] | npt.ArrayLike,
        *,
        rng: np.random.Generator | int | None = None,
        progress: Progress | bool | None = None,
        t: float | npt.ArrayLike | Sequence[npt.ArrayLike] | None = None,
        u: npt.ArrayLike | Sequence[npt.ArrayLike] | None = None,
    ) -> DynamicsModel:
        called, generator = f"{type(self).__name__}.fit", as_generator(rng)
        if u is not None and t is None:
            raise InvalidArgument(f"{called}: expected the time step or the times as well as u: fit(x, t=0.05, u=u)")
        data = as_dataset(dataset, called) if t is None else from_samples(cast(npt.ArrayLike, dataset), t, u)
        self.check_parameters()
        self.check_installed()
        self.check_system(data.system)
        with shown(f"fit {type(self).__name__}") if progress is True else nullcontext(progress or None) as told:
            return _kept(self, fit, data, generator, told)

    del wrapped.__wrapped__  # so that its signature says what may be given
    return wrapped


def _kept(
    self: DynamicsModel,
    fit: Callable[..., DynamicsModel],
    dataset: Dataset,
    rng: np.random.Generator,
    progress: Progress | None,
) -> DynamicsModel:
    before = dict(vars(self))
    began, told = time.perf_counter(), (0, 1)

    def report(done: int, total: int, note: str = "") -> None:  # noqa: ARG001  # of a fit, numbers are told
        nonlocal told
        told = done, total
        if progress is not None:
            progress(done, total)

    try:
        report(0, 1)
        self.record(dataset)
        fitted: object = fit(self, _few_enough(self, dataset, rng), rng=rng, progress=report)
        if fitted is not self:
            raise TypeError(f"{type(self).__name__}.fit must return self, got {type(fitted).__name__}")
        if told[0] != told[1]:
            report(told[1], told[1])
    except BaseException:  # an interruption too leaves what was there before
        self.__dict__.clear()
        self.__dict__.update(before)
        raise
    self.fit_seconds = time.perf_counter() - began
    return self


def _few_enough(self: DynamicsModel, dataset: Dataset, rng: np.random.Generator) -> Dataset:
    """Return what there is to learn from; where that is not all of it, warn and record how much it is."""
    few = dataset if self.most_steps is None else thinned(dataset, self.most_steps, rng)
    self.__dict__.pop("kept_steps_", None)
    if few is not dataset:
        self.kept_steps_ = [few.n_steps, dataset.n_steps]
        warnings.warn(f"{type(self).__name__} {self.fit_note}", DataWarning, stacklevel=4)
    return few


def as_dataset(given: object, asked_by: str, *, of: System | None = None) -> Dataset:
    """Return the data set that was given, several joined to one. Raises `InvalidData` that names the right call.

    With ``of`` it must have that system's channels, else `IncompatibleSystem`.
    """
    if isinstance(given, Dataset):
        here = given.system
        if of is not None and (here.state_names, here.control_names) != (of.state_names, of.control_names):
            names = [", ".join((*one.state_names, *one.control_names)) for one in (of, here)]
            raise IncompatibleSystem(f"{asked_by}: the model has the channels {names[0]}, the data have {names[1]}")
        return given
    parts = list(given) if isinstance(given, (list, tuple)) else []
    if parts and all(isinstance(part, Dataset) for part in parts):
        if any(part.system != parts[0].system for part in parts):
            raise InvalidData(f"{asked_by}: expected data sets of one system, got several systems")
        return parts[0].with_episodes([episode for part in parts for episode in part])
    if isinstance(given, Trajectory) or any(isinstance(part, Trajectory) for part in parts):
        hint = "make a data set of episodes with Dataset(system, episodes)"
    elif type(given).__module__.split(".")[0] in ("pandas", "polars"):
        hint = "make one of a table with Dataset.from_pandas(system, table)"
    else:
        hint = "make one of arrays with Dataset.from_arrays(system, states, controls), or say fit(x, t=dt, u=u)"
    raise InvalidData(f"{asked_by}: expected a Dataset, got a {type(given).__name__}: {hint}")


def as_generator(rng: np.random.Generator | int | None) -> np.random.Generator:
    """Return a generator: the one given, or that of a seed; None is seed 0, so that the same call gives the same."""
    if isinstance(rng, np.random.Generator):
        return rng
    if rng is None or (isinstance(rng, (int, np.integer)) and not isinstance(rng, bool) and rng >= 0):
        return np.random.default_rng(0 if rng is None else rng)
    raise InvalidArgument(f"rng: expected a seed (a whole number >= 0), a Generator or None, got {rng!r}")


def require_packages(family: type, packages: Sequence[str]) -> None:
    """Raise `MissingExtra` with the command that installs it if one of ``packages`` cannot be imported."""
    points = [point for point in entry_points(group="sysid_evo.models") if point.module == family.__module__]
    owner = points[0].dist if points else None
    check_installed(family.__name__, packages, owner or DISTRIBUTION)
