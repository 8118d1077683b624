"""What limits a fitted model, and what to record next: a short list, the most important first."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np

from evaluation.advice.evidence import Evidence, ModelAdvice, Remark
from evaluation.advice.generalisation import halved, overfit, shift, too_few_data
from evaluation.advice.one_step import hidden_state, late_controls, noise_floor
from evaluation.advice.regions import dead_command, missing_excitation, other_states, weak_region
from evaluation.steps import Steps
from evaluation.sufficiency import enough_blocks
from sysid_evo.data import Dataset, Trajectory
from sysid_evo.errors import InvalidData
from sysid_evo.models import DynamicsModel

MOST = 5
"""Remarks that are made at most: a list that is longer is not read."""

FEWEST = 20
"""Windows of the part held back below which there is nothing to judge on."""
HELD_BACK = 0.25
"""Share of the end of each episode that a copy is judged on where there is no test part."""
NEGLIGIBLE = 0.05
"""N at the main horizon up to which a model is not limited by anything that is worth a word."""
EVEN_THEN = ("noise", "excitation", "test part", "dead command")
"""What is said of such a model all the same: that little is left to gain, and where the data do not lie."""
EXPLAINS = {
    "shift": ("hidden state", "noise"),
    "late controls": ("noise", "shift"),
    "form": ("shift", "hidden state"),
    "hidden state": ("noise",),
    "noisy states": ("noise",),
}
"""What follows from what: a recording that differs leaves errors that are not white; one that is driven otherwise seems
to differ where the model is wrong anyway; and noise is only called so where nothing that could be known explains it."""
BY_INTERVAL = ("shift", "overfit", "few data", "weak region")
"""Remarks that rest on a block-bootstrap interval; they are left out where there are too few blocks."""
LOOKS: tuple[Callable[[Evidence], Remark | None], ...] = (
    noise_floor,
    late_controls,
    hidden_state,
    shift,
    missing_excitation,
    other_states,
    dead_command,
    weak_region,
    overfit,
)


def advise_model(
    model: DynamicsModel,
    training: Dataset,
    test: Dataset | None = None,
    *,
    visited: Iterable[Trajectory] = (),
    name: str = "",
    seed: int = 0,
) -> ModelAdvice:
    """Say what limits a fitted ``model`` and what to record next, at most five sentences.

    ``test`` are recordings that it has not learned from. Without them a copy is fitted to three quarters of each
    episode and judged on the rest, if the family is `DynamicsModel.cheap`; any other is judged on its own training
    data. ``visited`` is what controllers do in models and on robots.
    """
    name = name or type(model).__name__
    where, judged_on = Evidence(name, model.without_noise(), training, test), "the test part"
    if test is None:
        where, judged_on = _held_back(where, seed)
    if not where.varying.any():
        said = f"No state varies in the data that {name} is judged on: nothing can be said of it. Excite the controls."
        return ModelAdvice(name, judged_on, (Remark("variation", said, 1.0),))
    trajectories = list(visited)
    if trajectories:
        where = replace(where, visited=Steps.of(training.system, trajectories))
    remarks = [remark for look in LOOKS if (remark := look(where)) is not None]
    if where.test is not None and where.model.cheap and (more := _with_half(where, seed)) is not None:
        remarks.append(more)
    if len(where.test_windows.errors) and where.test_windows.n(where.std) <= NEGLIGIBLE:
        remarks = [remark for remark in remarks if remark.topic in EVEN_THEN]
    if not enough_blocks(len(np.unique(where.test_windows.blocks))):
        remarks = [remark for remark in remarks if remark.topic not in BY_INTERVAL]
    explained = {topic for remark in remarks for topic in EXPLAINS.get(remark.topic, ())}
    ordered = sorted((one for one in remarks if one.topic not in explained), key=lambda remark: -remark.weight)
    return ModelAdvice(name, judged_on, tuple(ordered[:MOST]))


def _held_back(evidence: Evidence, seed: int) -> tuple[Evidence, str]:
    """Return the evidence on a copy with a part held back, or as it is, and what it is judged on."""
    if not evidence.model.cheap:
        return evidence, "its own training data"
    try:
        training, test = evidence.training.split(HELD_BACK)
        copy = evidence.model.unfitted().fit(training, rng=np.random.default_rng(seed))
        found = replace(evidence, model=copy, training=training, test=test)
        short = len(found.test_windows.errors) < FEWEST
    except InvalidData:
        short = True
    if short:
        return evidence, "its own training data"
    return found, "the last quarter of each episode, which a copy of it has not learned from"


def _with_half(evidence: Evidence, seed: int) -> Remark | None:
    try:
        half = evidence.model.unfitted().fit(halved(evidence.training), rng=np.random.default_rng(seed))
    except InvalidData:
        return None
    return too_few_data(evidence, half)
