"""Remarks on what limits a recording or a fitted model, and what to record next, the most important first."""

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

MAX_REMARKS = 5
"""Maximum number of remarks: longer lists are not read."""

FEWEST = 20
"""Minimum number of held-out windows needed to evaluate a model."""
HELD_OUT_SHARE = 0.25
"""Share of each episode, at its end, on which a refitted copy is evaluated if there is no test part."""
NEGLIGIBLE = 0.05
"""Error N at the main horizon up to which only the topics of `ALWAYS_REPORTED` are reported."""
ALWAYS_REPORTED = ("noise", "excitation", "outside the data", "test part", "dead command")
"""Topics that are reported even for such an accurate model: the noise floor and missing data."""
EXPLAINED_TOPICS = {
    "shift": ("hidden state", "noise"),
    "late controls": ("noise", "shift"),
    "form": ("shift", "hidden state"),
    "hidden state": ("noise",),
    "noisy states": ("noise", "fast states"),
    "excitation": ("outside the data",),
    "few data": ("length",),
}
"""Topics that a topic explains; the explained ones are left out.

A recording that differs makes residuals correlated. A model of the wrong form makes recordings with other controls seem
to differ. An error counts as noise only if nothing else explains it. A region of one or two channels is simpler than a
box of all channels."""
INTERVAL_TOPICS = ("shift", "overfit", "few data", "weak region")
"""Remarks based on a block-bootstrap interval; left out if there are too few blocks."""
PLACE_CHECKS: tuple[Callable[[Recordings], Remark | None], ...] = (
    missing_excitation,
    other_states,
    dead_command,
)
MODEL_CHECKS: tuple[Callable[[Evidence], Remark | None], ...] = (
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
    """Return the ``remarks`` that no other remark explains, the most important first."""
    made = [remark for remark in remarks if remark is not None]
    explained = {topic for remark in made for topic in EXPLAINED_TOPICS.get(remark.topic, ())}
    return tuple(sorted((one for one in made if one.topic not in explained), key=lambda remark: -remark.weight))


def advise_recording(
    dataset: Dataset, quality: RecordingQuality | None = None, *, visited: Iterable[Trajectory] = ()
) -> tuple[Remark, ...]:
    """Return `ranked` remarks on what limits models fitted to ``dataset``, and what to record next.

    ``quality`` is the quality of the recording, with its logs if their time stamps are to be checked. ``visited`` are
    trajectories of controllers in models and on robots.
    """
    where = Recordings(training=dataset, visited=Steps.of(dataset.system, visited) or None, known=quality)
    return ranked(look(where) for look in (*CHECKS, late_answers, outside_the_data, *PLACE_CHECKS))


def advise_model(
    model: DynamicsModel,
    training: Dataset,
    test: Dataset | None = None,
    *,
    visited: Iterable[Trajectory] = (),
    name: str = "",
    seed: int = 0,
) -> ModelAdvice:
    """Return at most five `ranked` remarks on what limits a fitted ``model``, and what to record next.

    ``test`` are recordings that it was not fitted to. Without them, families with `DynamicsModel.fast_fit` are refitted
    to the first three quarters of each episode and evaluated on the rest; others are evaluated on their own training
    data. ``visited`` are trajectories of controllers in models and on robots.
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
        where, evaluated_on = _held_out(where, seed)
    if not where.varying.any():
        sentence = f"No state varies in the data that {name} is evaluated on: excite the controls."
        return ModelAdvice(name, evaluated_on, (Remark("variation", sentence, 1.0),))
    looks = (*CHECKS, *PLACE_CHECKS, *MODEL_CHECKS)
    remarks = [remark for look in looks if (remark := look(where)) is not None]
    if where.test is not None and where.model.fast_fit and (more := _with_half(where, seed)) is not None:
        remarks.append(more)
    if len(where.test_windows.errors) and where.test_windows.n(where.std) <= NEGLIGIBLE:
        remarks = [remark for remark in remarks if remark.topic in ALWAYS_REPORTED]
    if not enough_blocks(len(np.unique(where.test_windows.blocks))):
        remarks = [remark for remark in remarks if remark.topic not in INTERVAL_TOPICS]
    return ModelAdvice(name, evaluated_on, ranked(remarks)[:MAX_REMARKS])


def _held_out(evidence: Evidence, seed: int) -> tuple[Evidence, str]:
    """Return the evidence on a copy fitted without the held-out part, or as it is, and what it is evaluated on."""
    if not evidence.model.fast_fit:
        return evidence, "its own training data"
    try:
        training, test = evidence.training.split(HELD_OUT_SHARE)
        copy = evidence.model.clone_unfitted().fit(training, rng=np.random.default_rng(seed))
        found = replace(evidence, model=copy, training=training, test=test)
        short = len(found.test_windows.errors) < FEWEST
    except InvalidData:
        short = True
    if short:
        return evidence, "its own training data"
    return found, "the last quarter of each episode (a copy was fitted to the rest)"


def _with_half(evidence: Evidence, seed: int) -> Remark | None:
    try:
        half = evidence.model.clone_unfitted().fit(halved(evidence.training), rng=np.random.default_rng(seed))
    except InvalidData:
        return None
    return too_few_data(evidence, half)
