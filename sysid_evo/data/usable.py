"""Whether a data set is long enough for anything, asked before any work is done with it."""

from __future__ import annotations

from sysid_evo.data.dataset import Dataset
from sysid_evo.errors import InvalidData

STEPS_PER_CHANNEL = 10
"""Fewest steps for each state, each control and one more: with less, a linear model is not determined well."""


def check_usable(dataset: Dataset, *, horizon: int = 10, first: int = 5, name: str = "data set") -> None:
    """Raise `InvalidData` if ``dataset`` is too short to fit a model to, or to test one on.

    It needs one episode of ``first + horizon`` steps, those of a prediction over ``horizon`` steps after
    ``first`` samples of history, ten steps in all for each channel and one more, and something that
    moves. ``name`` stands at the head of the sentence.
    """
    system = dataset.system
    longest = max(dataset, key=len)
    wanted = STEPS_PER_CHANNEL * (system.nx + system.nu + 1)
    if len(longest) < first + horizon or dataset.n_steps < wanted:
        raise InvalidData(
            f"{name}: expected an episode of {first + horizon} steps or more, to predict {horizon} steps after {first} "
            f"of history, and {wanted} steps in all for {system.nx + system.nu} states and controls; got "
            f"{dataset.n_steps} steps of {system.dt:g} s, the longest episode {longest.name!r} with {len(longest)}. "
            "Record for longer, or see in the notes of the import why so little was left"
        )
    if not any(rows.any() for rows in dataset.moving):
        raise InvalidData(f"{name}: the robot stands still throughout; record it in motion")
