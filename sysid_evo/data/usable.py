"""Whether a data set suffices to fit and test models."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from sysid_evo.data.dataset import Dataset
from sysid_evo.errors import InvalidData

STEPS_PER_CHANNEL = 10
"""Least number of steps per state, per control and one more; with fewer, a linear model is poorly determined."""


HISTORY, HORIZON = 5, 10
FEWEST = HISTORY + HORIZON
"""Steps of one window: a prediction over 10 steps after 5 of history; an error over fewer steps is meaningless."""


def check_usable(dataset: Dataset, *, name: str = "data set") -> None:
    """Raise `InvalidData` if ``dataset`` is too short to fit or test a model, or shows no motion.

    It needs one episode of 15 steps, and in all ten steps for each channel and one more. ``name`` begins the message.
    """
    system = dataset.system
    longest = max(dataset, key=len)
    wanted = STEPS_PER_CHANNEL * (system.nx + system.nu + 1)
    if len(longest) < FEWEST or dataset.n_steps < wanted:
        raise InvalidData(
            f"{name}: expected an episode of {FEWEST} steps or more, to predict {HORIZON} steps after {HISTORY} "
            f"of history, and {wanted} steps in all for {system.nx + system.nu} states and controls; got "
            f"{dataset.n_steps} steps of {system.dt:g} s, the longest episode {longest.name!r} with {len(longest)}. "
            "Record for longer, or read in the notes of the import why samples were removed"
        )
    if not any(rows.any() for rows in dataset.moving):
        raise InvalidData(f"{name}: the robot never moves; record it in motion")


LARGEST = 1e30
"""Largest recorded number. All families can be fitted up to this size; squares and fourth powers overflow later (1e75
for Gaussian processes), the float32 of compiled models at 3e38."""
CONSTANT = 1e-12
"""Rounding errors of a constant state, as a share of its size."""


def warnings_about(dataset: Dataset, use: str) -> Iterator[str]:
    """Yield the reasons why the error of a model ("fitted to", "scored on") is meaningless, to follow its name.

    Raises `InvalidData` for numbers that are too large to compute with.
    """
    system, states = dataset.system, np.concatenate([episode.states for episode in dataset])
    controls = np.concatenate([episode.controls for episode in dataset])
    size = np.abs(states).max(axis=0)
    names = (*system.state_names, *system.control_names)
    for name, most in zip(names, (*size, *np.abs(controls).max(axis=0)), strict=True):
        if most > LARGEST:
            raise InvalidData(
                f"data set: expected numbers up to {LARGEST:g}, got {most:g} in {name!r}: look for a broken sample, or "
                "use a larger unit"
            )
    wanted = max(FEWEST, 2 * (len(names) + 1))  # a linear model fits half as many exactly, whatever they are
    if dataset.n_steps < wanted:
        yield (
            f"is {use} {dataset.n_steps} steps, too few for {len(names)} states and controls: expected at least "
            f"{wanted}, better {STEPS_PER_CHANNEL * (len(names) + 1)}. Its error does not carry over to other data; "
            "record for longer"
        )
    if (np.ptp(states, axis=0) <= np.maximum(CONSTANT * size, 1.0 / LARGEST)).all():  # one may: a body that never slips
        yield f"is {use} a recording in which no state changes, so its error is meaningless"
