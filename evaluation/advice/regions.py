"""Checks of regions: uncovered states and commands, commands without effect, regions of large error."""

from __future__ import annotations

import numpy as np

from evaluation.advice.evidence import Evidence, Recordings, Remark
from evaluation.coverage import MIN_SHARE, MOST_STEPS, largest_gap, suggest_recordings, untried_pair
from evaluation.formatting import percent
from evaluation.prediction.cases import PredictionProtocol, measured_cases
from evaluation.prediction.regions import Region, candidate_regions, region_errors, worst_region
from evaluation.steps import Steps
from sysid_evo.data import Dataset
from sysid_evo.data.response import Delay
from sysid_evo.data.support import Support
from sysid_evo.motion import PlanarBody
from sysid_evo.types import Array, BoolArray


def missing_excitation(recordings: Recordings) -> Remark | None:
    """Return a remark on a region that controllers use and the training data do not cover."""
    if recordings.visited is None or (gap := largest_gap(recordings.seen, recordings.visited)) is None:
        return None
    return Remark(
        "excitation",
        f"Controllers spend {percent(gap.needed)} of their time with {gap.words} (training data: {_share(gap.seen)}): "
        "models extrapolate there. Record more there.",
        gap.needed,
        gap.figures,
    )


def untried_command(evidence: Evidence) -> Remark | None:
    """Return a remark on a command that was rarely given in a state; None if the use by controllers is known."""
    if evidence.visited is not None or (untried := untried_pair(evidence.seen)) is None:
        return None
    state, command = untried.place
    return Remark(
        "excitation",
        f"{command.words} is rare with {state.words}: {_share(untried.seen)} of the time, compared with "
        f"{percent(untried.needed)} if every command were used everywhere. Controllers that use it leave the data. "
        "Record more there.",
        0.5 * untried.needed,
        untried.figures,
    )


BOXES = 3
"""Number of boxes that are named."""


def outside_the_data(recordings: Recordings) -> Remark | None:
    """Return a remark on the share of the controllers' steps outside the training data, and where most of them are."""
    return None if recordings.visited is None else driven_outside(recordings.visited, recordings.support)


def often_outside(evidence: Evidence) -> Remark | None:
    """Return the same if it is a twentieth or more: held-out data, too, are sometimes outside the training data."""
    remark = outside_the_data(evidence)
    return remark if remark is not None and remark.weight >= MIN_SHARE else None


def driven_outside(visited: Steps, support: Support) -> Remark | None:
    """Return a remark on the share of ``visited`` steps outside ``support``, and the boxes with most of them."""
    visited = visited.thinned(MOST_STEPS)
    share, boxes = visited.share_outside(support), suggest_recordings(support, visited, most=BOXES)
    if share is None or not boxes:
        return None
    places = "; ".join(f"{box.words}: {percent(box.share)} of the steps" for box in boxes)
    return Remark(
        "outside the data",
        f"{percent(share)} of the controllers' steps are outside the training data, most of them at "
        f"{places}. Record more there, if the robot gets there.",
        share,
        {"outside": share},
    )


def other_states(recordings: Recordings) -> Remark | None:
    """Return a remark if test data lie outside the training data, or are missing where controllers go."""
    if recordings.test is None:
        return None
    held_out = Steps.moving(recordings.test)
    gap = largest_gap(recordings.seen, held_out)
    if gap is not None:
        return Remark(
            "test part",
            f"{percent(gap.needed)} of the test part has {gap.words} (training part: {_share(gap.seen)}): test errors "
            "are those of extrapolation. Hold out other recordings (--test), or record more there.",
            gap.needed,
            gap.figures,
        )
    gap = None if recordings.visited is None else largest_gap(held_out, recordings.visited)
    if gap is None or missing_excitation(recordings) is not None:
        return None
    return Remark(
        "test part",
        f"Controllers spend {percent(gap.needed)} of their time with {gap.words} (test part: {_share(gap.seen)}): test "
        "errors do not show how accurate models are there. Hold out recordings that cover it.",
        0.5 * gap.needed,
        gap.figures,
    )


def _share(share: float) -> str:
    """Return a small share in percent, with a decimal."""
    return "none" if share == 0.0 else percent(share)


MAX_DEAD_RATIO = 0.25
"""Upper bound of an effect, relative to that elsewhere, that counts as none: lag and noise alone do not cause it."""
MIN_STANDARD_ERRORS = 3.0
"""Required size of an effect in standard errors; those of a regression on neighbouring samples are half too small."""

FEWEST_ROWS = 60
"""Minimum number of steps inside and outside a region to estimate an effect."""

MIN_COMMAND_SPREAD = 0.3
"""Spread of a command, relative to that elsewhere, below which its effect is not estimated."""


def dead_command(recordings: Recordings) -> Remark | None:
    """Return a remark on a command and a region where it lacks the effect that it has elsewhere."""
    found = [one for delay in recordings.delays for one in _dead(recordings.training, delay)]
    if not found:
        return None
    share, ratio, delay, region = max(found, key=lambda one: one[0] * (1.0 - one[1]))
    return Remark(
        "dead command",
        f"{delay.control} has no effect on {delay.state} with {region.words} ({percent(share)} of the time; at most "
        f"{percent(ratio)} of its effect elsewhere). Check whether this is a dead band, a limit or lost grip: models "
        "that ignore it predict an effect that the robot does not have. Record more there.",
        share * (1.0 - ratio),
        {"share": share, "ratio": ratio},
    )


def _dead(dataset: Dataset, delay: Delay) -> list[tuple[float, float, Delay, Region]]:
    """Return share of time, largest ratio of the effects, delay and region wherever the command has no effect."""
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
        assert isinstance(system.motion, PlanarBody)
        control = control * steps.before[:, system.motion.indices(system.state_names)[0]]
    usable = np.flatnonzero(moving & np.isfinite(control))
    usable = usable[:: max(1, len(usable) // MOST_STEPS)]
    change = system.acceleration(steps.before, steps.after)[usable, state]
    before, now, control = system.wrap(steps.before)[usable], steps.control[usable], control[usable]
    others = np.concatenate([system.regressors(before), np.delete(now, place, axis=1)], axis=1)
    now[:, place] = control
    found = []
    for region, inside in candidate_regions(system, before, now):
        if region.channel in system.control_names and region.channel != delay.control:
            continue
        if (region.channel == delay.control and delay.at_speed) or region.kind == "at":
            continue
        here, elsewhere = _effect(change, control, others, inside), _effect(change, control, others, ~inside)
        if here is None or elsewhere is None or abs(elsewhere[0]) < MIN_STANDARD_ERRORS * elsewhere[1]:
            continue
        ratio = (abs(here[0]) + MIN_STANDARD_ERRORS * here[1]) / abs(elsewhere[0])
        tried = control[inside].std() >= MIN_COMMAND_SPREAD * control[~inside].std()
        if ratio <= MAX_DEAD_RATIO and tried:
            found.append((float(inside.mean()), float(ratio), delay, region))
    return found


def _effect(change: Array, control: Array, others: Array, rows: BoolArray) -> tuple[float, float] | None:
    """Return the effect of a unit of the control on the state's acceleration, and its error; None with few rows."""
    if rows.sum() < FEWEST_ROWS:
        return None
    x = np.concatenate([control[rows, None], others[rows], np.ones((int(rows.sum()), 1))], axis=1)
    weights, _, rank, _ = np.linalg.lstsq(x, change[rows], rcond=None)
    if rank < x.shape[1]:
        return None
    left = change[rows] - x @ weights
    row = np.linalg.pinv(x)[0]  # its square is the first variance, never negative as that of an inverse may be
    return float(weights[0]), float(np.sqrt((left @ left) / (len(left) - rank) * (row @ row)))


def weak_region(evidence: Evidence) -> Remark | None:
    """Return a remark on the region where the error is clearly larger than elsewhere, see `region_errors`."""
    lags = evidence.model.n_lags
    protocol = PredictionProtocol(first=max(PredictionProtocol.first, lags))
    cases = measured_cases(evidence.training, evidence.evaluated, protocol)
    steps = cases.near_horizon
    if steps is None:
        return None
    predicted = evidence.model.simulate(*cases.history(lags), cases.windows.controls[:, :steps])
    if not np.isfinite(predicted).all():
        return None
    worst = worst_region(region_errors(cases, predicted, steps))
    if worst is None:
        return None
    return Remark(
        "weak region",
        f"{evidence.name} is least accurate with {worst.region.words}, {percent(worst.share)} of the windows: N "
        f"{worst.n:.3f} after {steps * evidence.system.dt:g} s, {worst.ratio.value:.1f} times that of all windows. "
        "Record more there, and check what is different.",
        worst.share * (1.0 - 1.0 / worst.ratio.value),
        {"ratio": worst.ratio.value, "share": worst.share},
    )
