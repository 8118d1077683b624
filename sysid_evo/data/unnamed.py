"""Arrays whose columns have no names, as ``fit(x, t=, u=)`` takes them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from sysid_evo.arrays import Array
from sysid_evo.data.dataset import Dataset
from sysid_evo.data.trajectory import as_columns
from sysid_evo.errors import InvalidArgument, InvalidData, ShapeError
from sysid_evo.system import Channel, System

EVEN = 1e-3
"""Times are equally spaced if no step differs from the mean step by more than this share of it."""


def from_samples(
    x: npt.ArrayLike | Sequence[npt.ArrayLike],
    t: float | npt.ArrayLike | Sequence[npt.ArrayLike],
    u: npt.ArrayLike | Sequence[npt.ArrayLike] | None = None,
) -> Dataset:
    """Make a data set of the states x0, x1, ... and the controls u0, u1, ... of arrays, as pysindy takes them.

    ``x`` is (T + 1, nx), or a list with one for each trajectory; one state may be flat. ``t`` is the time step in
    seconds, or the times (T + 1,), a list of them for a list. ``u`` is (T + 1, nu) or (T, nu), held from one
    sample to the next. Raises `InvalidData` if the times are not equally spaced or do not belong to the samples,
    `ShapeError`, `InvalidArgument`.
    """
    if isinstance(x, Dataset) or (isinstance(x, (list, tuple)) and any(isinstance(part, Dataset) for part in x)):
        raise InvalidArgument("fit: expected a Dataset alone, as it has times and controls of its own, got t or u too")
    runs = [np.asarray(as_columns(part)) for part in _listed(x)]
    pushes = None if u is None else [np.asarray(as_columns(part)) for part in _listed(u)]
    for what, arrays in (("x", runs), ("u", pushes or [])):
        if any(array.ndim != 2 for array in arrays):
            shapes = ", ".join(str(array.shape) for array in arrays)
            raise ShapeError(f"{what}: expected (samples, columns), or a list of such arrays, got {shapes}")
    n_controls = 0 if pushes is None else pushes[0].shape[1]
    system = System(_numbered("x", runs[0].shape[1]), _numbered("u", n_controls), _step(t, runs))
    return Dataset.from_arrays(system, list(runs), None if pushes is None else list(pushes))


def _listed(given: npt.ArrayLike | Sequence[npt.ArrayLike]) -> list[npt.ArrayLike]:
    """Return one entry for each trajectory; an array, or a list of numbers or rows of them, is one."""
    if isinstance(given, (list, tuple)) and any(isinstance(part, np.ndarray) for part in given):
        return list(given)
    return [np.asarray(given)]


def _numbered(letter: str, n: int) -> tuple[Channel, ...]:
    """Return ``n`` channels without units: x0, x1, ..."""
    return tuple(Channel(f"{letter}{i}") for i in range(n))


def _step(t: float | npt.ArrayLike | Sequence[npt.ArrayLike], runs: Sequence[Array]) -> float:
    """Return the one time step of all runs, in seconds."""
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
    if not abs(worst - dt) <= EVEN * abs(dt):
        raise InvalidData(
            f"t: expected equally spaced times, got steps of {dt:g} s in the mean and one of {worst:g} s; write "
            "the log to a file and `sysid-evo import` resamples it"
        )
    return dt
