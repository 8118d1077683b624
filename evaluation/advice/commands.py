"""Commands that do nothing in a part of the state space."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from evaluation.advice.evidence import Evidence
from evaluation.advice.remark import Remark
from evaluation.exploitability.steps import Steps
from evaluation.labels import percent
from evaluation.prediction.regions import Region, candidate_regions
from sysid_evo.arrays import Array, BoolArray
from sysid_evo.data import Dataset
from sysid_evo.data.delays import Delay, find_delays

DEAD = 0.25
"""An effect that is surely below a quarter of that elsewhere: lag and noise alone do not shrink it so far."""
SURE = 3.0
"""Standard errors of an effect; those of a regression on neighbouring samples are too small by about a half."""
FEWEST, MOST_STEPS = 60, 20_000
TRIED = 0.3
"""Share of the spread that a command has elsewhere, below which nothing can be said of its effect."""


@dataclass(frozen=True)
class Effect:
    """How much a unit of a control changes a state's acceleration, and the standard error of that."""

    size: float
    error: float


def dead_command(evidence: Evidence) -> Remark | None:
    """Return the command and region where the data show none of the effect that it has elsewhere."""
    found = []
    delays = [delay for delay in find_delays(evidence.training) if delay.clear]
    for control in dict.fromkeys(delay.control for delay in delays):
        strongest = max((d for d in delays if d.control == control), key=lambda delay: abs(delay.strength))
        found += _dead(evidence.training, strongest)
    if not found:
        return None
    share, ratio, delay, region = max(found, key=lambda one: one[0] * (1.0 - one[1]))
    return Remark(
        "dead command",
        f"{delay.control} has no effect on {delay.state} with {region.words} ({percent(share)} of the time; at most "
        f"{percent(ratio)} of its effect elsewhere). See whether it is a dead band, a limit, or lost grip: models that "
        "do not know it promise what the robot does not do. Record more there.",
        share * (1.0 - ratio),
        {"share": share, "ratio": ratio},
    )


def _dead(dataset: Dataset, delay: Delay) -> list[tuple[float, float, Delay, Region]]:
    """Return share of time, largest ratio of the effects, and region, of each where the command is dead."""
    system, late = dataset.system, max(delay.steps, 0)
    steps = Steps.of(system, [episode for episode in dataset if len(episode) > late])
    moving = np.concatenate(
        [rows[:-1] for rows, episode in zip(dataset.moving, dataset, strict=True) if len(episode) > late]
    )
    place, state = system.control_names.index(delay.control), system.state_names.index(delay.state)
    control = np.concatenate(
        [np.append(np.full(late, np.nan), e.controls[: len(e) - late, place]) for e in dataset if len(e) > late]
    )
    if delay.at_speed:
        control = control * steps.before[:, _forward(dataset)]
    usable = np.flatnonzero(moving & np.isfinite(control))
    usable = usable[:: max(1, len(usable) // MOST_STEPS)]
    change = system.acceleration(steps.before, steps.after)[usable, state]
    before, now, control = system.wrapped(steps.before)[usable], steps.control[usable], control[usable]
    others = np.concatenate([system.regressors(before), np.delete(now, place, axis=1)], axis=1)
    now[:, place] = control
    found = []
    for region, inside in candidate_regions(system, before, now):
        if region.channel in system.control_names and region.channel != delay.control:
            continue
        if (region.channel == delay.control and delay.at_speed) or region.kind == "at":
            continue
        here, elsewhere = _effect(change, control, others, inside), _effect(change, control, others, ~inside)
        if here is None or elsewhere is None or abs(elsewhere.size) < SURE * elsewhere.error:
            continue
        ratio = (abs(here.size) + SURE * here.error) / abs(elsewhere.size)
        tried = control[inside].std() >= TRIED * control[~inside].std()
        if ratio <= DEAD and tried:
            found.append((float(inside.mean()), float(ratio), delay, region))
    return found


def _effect(change: Array, control: Array, others: Array, rows: BoolArray) -> Effect | None:
    """Regress the change on control and states; None with too few rows."""
    if rows.sum() < FEWEST:
        return None
    x = np.concatenate([control[rows, None], others[rows], np.ones((int(rows.sum()), 1))], axis=1)
    weights, _, rank, _ = np.linalg.lstsq(x, change[rows], rcond=None)
    if rank < x.shape[1]:
        return None
    left = change[rows] - x @ weights
    variance = (left @ left) / (len(left) - rank) * np.linalg.inv(x.T @ x)[0, 0]
    return Effect(float(weights[0]), float(np.sqrt(variance)))


def _forward(dataset: Dataset) -> int:
    from sysid_evo.motion import PlanarBody

    motion = dataset.system.motion
    assert isinstance(motion, PlanarBody)
    return motion.indices(dataset.system.state_names)[0]
