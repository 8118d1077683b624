"""What limits a recording or a fitted model, and what to record next: one list, the most important first."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np

from evaluation.advice.evidence import Evidence, ModelAdvice, Recordings, Remark
from evaluation.advice.generalisation import halved, overfit, shift, too_few_data
from evaluation.advice.one_step import hidden_state, late_controls, noise_floor
from evaluation.advice.recording import CHECKS, late_answers
from evaluation.advice.regions import (
    dead_command,
    missing_excitation,
    often_outside,
    other_states,
    outside_the_data,
    untried_command,
    weak_region,
)
from evaluation.steps import Steps
from evaluation.sufficiency import enough_blocks
from sysid_evo.data import Dataset, RecordingQuality, Trajectory, recording_quality
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
EVEN_THEN = ("noise", "excitation", "outside the data", "test part", "dead command")
"""What is said of such a model all the same: that little is left to gain, and where the data do not lie."""
EXPLAINS = {
    "shift": ("hidden state", "noise"),
    "late controls": ("noise", "shift"),
    "form": ("shift", "hidden state"),
    "hidden state": ("noise",),
    "noisy states": ("noise", "fast states"),
    "excitation": ("outside the data",),
    "few data": ("length",),
}
"""What follows from what, and what says the same less well: a recording that differs leaves errors that are not white;
one that is driven otherwise seems to differ where the model is wrong anyway; noise is only called so where nothing that
could be known explains it; a place of one or two channels is simpler than a box of all."""
BY_INTERVAL = ("shift", "overfit", "few data", "weak region")
"""Remarks that rest on a block-bootstrap interval; they are left out where there are too few blocks."""
OF_PLACES: tuple[Callable[[Recordings], Remark | None], ...] = (
    missing_excitation,
    other_states,
    dead_command,
)
OF_MODELS: tuple[Callable[[Evidence], Remark | None], ...] = (
    noise_floor,
    late_controls,
    hidden_state,
    shift,
    untried_command,
    often_outside,
    weak_region,
    overfit,
)


def ranked(remarks: Iterable[Remark | None]) -> tuple[Remark, ...]:
    """Return the ``remarks`` that no other explains, the most important first."""
    made = [remark for remark in remarks if remark is not None]
    explained = {topic for remark in made for topic in EXPLAINS.get(remark.topic, ())}
    return tuple(sorted((one for one in made if one.topic not in explained), key=lambda remark: -remark.weight))


def advise_recording(
    dataset: Dataset, quality: RecordingQuality | None = None, *, visited: Iterable[Trajectory] = ()
) -> tuple[Remark, ...]:
    """Say what limits the models that will be fitted to ``dataset``, and what to record next: `ranked` remarks.

    ``quality`` is that of the recording, with its logs if their time stamps are to be looked at. ``visited`` is what
    controllers do in models and on robots.
    """
    where = Recordings(training=dataset, visited=Steps.of(dataset.system, visited) or None, known=quality)
    return ranked(look(where) for look in (*CHECKS, late_answers, outside_the_data, *OF_PLACES))


def advise_model(
    model: DynamicsModel,
    training: Dataset,
    test: Dataset | None = None,
    *,
    visited: Iterable[Trajectory] = (),
    name: str = "",
    seed: int = 0,
) -> ModelAdvice:
    """Say what limits a fitted ``model`` and what to record next, at most five sentences: `ranked` remarks.

    ``test`` are recordings that it has not learned from. Without them a copy is fitted to three quarters of each
    episode and judged on the rest, if the family is `DynamicsModel.fast_fit`; any other is judged on its own training
    data. ``visited`` is what controllers do in models and on robots.
    """
    name = name or type(model).__name__
    where = Evidence(
        name=name,
        model=model.without_noise(),
        training=training,
        test=test,
        visited=Steps.of(training.system, visited) or None,
        known=recording_quality(training),
    )
    evaluated_on = "the test part"
    if test is None:
        where, evaluated_on = _held_back(where, seed)
    if not where.varying.any():
        said = f"No state varies in the data that {name} is judged on: nothing can be said of it. Excite the controls."
        return ModelAdvice(name, evaluated_on, (Remark("variation", said, 1.0),))
    looks = (*CHECKS, *OF_PLACES, *OF_MODELS)
    remarks = [remark for look in looks if (remark := look(where)) is not None]
    if where.test is not None and where.model.fast_fit and (more := _with_half(where, seed)) is not None:
        remarks.append(more)
    if len(where.test_windows.errors) and where.test_windows.n(where.std) <= NEGLIGIBLE:
        remarks = [remark for remark in remarks if remark.topic in EVEN_THEN]
    if not enough_blocks(len(np.unique(where.test_windows.blocks))):
        remarks = [remark for remark in remarks if remark.topic not in BY_INTERVAL]
    return ModelAdvice(name, evaluated_on, ranked(remarks)[:MOST])


def _held_back(evidence: Evidence, seed: int) -> tuple[Evidence, str]:
    """Return the evidence on a copy with a part held back, or as it is, and what it is judged on."""
    if not evidence.model.fast_fit:
        return evidence, "its own training data"
    try:
        training, test = evidence.training.split(HELD_BACK)
        copy = evidence.model.clone_unfitted().fit(training, rng=np.random.default_rng(seed))
        found = replace(evidence, model=copy, training=training, test=test)
        short = len(found.test_windows.errors) < FEWEST
    except InvalidData:
        short = True
    if short:
        return evidence, "its own training data"
    return found, "the last quarter of each episode, which a copy of it has not learned from"


def _with_half(evidence: Evidence, seed: int) -> Remark | None:
    try:
        half = evidence.model.clone_unfitted().fit(halved(evidence.training), rng=np.random.default_rng(seed))
    except InvalidData:
        return None
    return too_few_data(evidence, half)
