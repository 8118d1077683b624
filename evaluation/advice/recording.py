"""Checks of a recording by itself: length, standstill, use of the controls, delays, noise, time stamps."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np

from evaluation.advice.evidence import Recordings, Remark
from evaluation.formatting import few, percent
from sysid_evo.data.response import Delay
from sysid_evo.data.units import spelled, spelled_time

TIMES_PER_CHANNEL, NEARLY = 30.0, 0.9
"""How often a recording should last the slowest time scale, for each state and control: a rule of thumb, so
that nine tenths of it pass."""
RULE = 0.3
"""Weight of a rule of thumb, as a part of the share of time that it is about: what is measured comes first."""


def too_short(recordings: Recordings) -> Remark | None:
    """Return that the recording lasts few of the slowest time scales, or that none is known."""
    quality = recordings.quality
    if quality.unusable:
        return Remark("unusable", quality.unusable, 1.0)
    if not quality.scales:
        return Remark(
            "time scale",
            "How fast the states answer cannot be told from this recording: excite the controls more, and record "
            "episodes that last several times as long as the slowest answer.",
            RULE,
        )
    driven, slowest = quality.duration * quality.moving, quality.scales[-1]
    channels = len(quality.states) + len(quality.controls)
    wanted = TIMES_PER_CHANNEL * channels * slowest
    if driven >= NEARLY * wanted:
        return None
    return Remark(
        "length",
        f"{spelled_time(driven)}{' in motion' if quality.moving < 1.0 else ''} are {driven / slowest:.0f} times the "
        f"slowest time scale of the states, {spelled_time(slowest)}. {TIMES_PER_CHANNEL:.0f} times for each of the "
        f"{channels} states and controls are a good rule: record {spelled_time(wanted)} in all.",
        RULE * (1.0 - driven / wanted),
        {"seconds": driven, "wanted": wanted},
    )


def nothing_moves(recordings: Recordings) -> Remark | None:
    """Return in which episodes nothing moves."""
    idle, episodes = recordings.quality.idle, recordings.quality.episodes
    if not idle:
        return None
    return Remark(
        "idle episodes",
        f"Nothing moves in {len(idle)} of {episodes} episodes: {few(idle)}. Leave them out, and see whether the robot "
        "was switched on and its sensors alive.",
        RULE * len(idle) / episodes,
    )


IDLE = 0.3
"""Share of the time that a robot may stand still."""


def standstill(recordings: Recordings) -> Remark | None:
    """Return that the robot stands still for much of the time."""
    still = 1.0 - recordings.quality.moving
    if still <= IDLE:
        return None
    return Remark(
        "standstill",
        f"The robot stands still {percent(still)} of the time: little can be learned there, and prediction errors "
        "leave such stretches out.",
        RULE * still,
        {"share": still},
    )


RARE, RARE_TOGETHER = 0.02, 0.01
"""Share of the time below which a level of a control, and a combination of levels, is rare."""


def rare_levels(recordings: Recordings) -> Remark | None:
    """Return which levels of a control were hardly used; nothing where it is known what controllers use."""
    if recordings.visited is not None:
        return None
    rare = {
        use.name: [(level, share) for level, share in zip(use.levels, use.shares, strict=True) if share < RARE]
        for use in recordings.quality.controls
    }
    levels = {use.name: use.levels for use in recordings.quality.controls}
    named = [
        f"{name} is near {', '.join(spelled(level, levels[name]) for level, _ in found)}"
        for name, found in rare.items()
        if found
    ]
    if not named:
        return None
    missing = max(sum(1.0 / len(levels[name]) - share for _, share in found) for name, found in rare.items())
    return Remark(
        "rare levels",
        f"{' and '.join(named)} less than {100 * RARE:.0f} % of the time: models will guess there.",
        RULE * missing,
    )


def rare_combinations(recordings: Recordings) -> Remark | None:
    """Return which combinations of levels were hardly used; nothing where it is known what controllers use."""
    quality = recordings.quality
    rare = [command for command in quality.commands if command.share < RARE_TOGETHER]
    if recordings.visited is not None or not rare or len(quality.controls) < 2:
        return None
    names = ", ".join(use.name for use in quality.controls)
    listed = "; ".join(", ".join(map(spelled, command.levels)) for command in rare)
    missing = len(rare) / len(quality.commands) - sum(command.share for command in rare)
    return Remark(
        "rare combinations",
        f"Less than {100 * RARE_TOGETHER:.0f} % of the time at ({names}) near: {listed}.",
        max(0.0, RULE * missing),
    )


SETTLED = 5.0
"""A control held for this many time scales lets the states settle, and more of the same teaches nothing."""
FEW_SWITCHES = 10
"""Changes of a control in all, where no time scale is known."""


def slow_switching(recordings: Recordings) -> Remark | None:
    """Return which control is held for so long that the states have settled for most of the time."""
    quality = recordings.quality
    settled = SETTLED * quality.scales[-1] if quality.scales else None
    held = {use.name: quality.duration / (use.switches + 1) for use in quality.controls}
    slow = {
        use.name: held[use.name]
        for use in sorted(quality.controls, key=lambda use: use.switches)
        if (use.switches < FEW_SWITCHES if settled is None else held[use.name] > settled)
    }
    if not slow:
        return None
    name, *others = slow
    likewise = f" Likewise {few(others)}." if others else ""
    if settled is None:
        return Remark(
            "slow switching",
            f"{name} stays near a level for {spelled_time(held[name])} on average: change it more often, so that the "
            f"answer to a change is in the data.{likewise}",
            RULE,
        )
    return Remark(
        "slow switching",
        f"{name} stays near a level for {spelled_time(held[name])} on average, but the states settle within "
        f"{spelled_time(settled)}: change it more often, so that the way there is in the data.{likewise}",
        RULE * (1.0 - settled / held[name]),
        {"held": held[name], "settled": settled},
    )


def answers_late(recordings: Recordings) -> Remark | None:
    """Return how late controls act, for models that are not fitted yet."""
    late = [delay for delay in recordings.delays if delay.steps > 0]
    if not late:
        return None
    named = ", ".join(f"{one.state} answers {one.control} {spelled_time(one.seconds)} later" for one in late)
    steps = max(delay.steps for delay in late)
    return Remark(
        "late answer",
        f"{named}: give the models control_lags of {steps} or more.",
        _explained(late),
        {"steps": float(steps)},
    )


def late_stamps(recordings: Recordings) -> Remark | None:
    """Return that states move before a control is logged."""
    early = [delay for delay in recordings.delays if delay.steps < 0]
    if not early:
        return None
    named = ", ".join(f"{one.state} moves {spelled_time(-one.seconds)} before {one.control} is logged" for one in early)
    return Remark(
        "late stamps",
        f"{named}: commands are stamped late, or something fast feeds the state back.",
        _explained(early),
    )


def _explained(delays: Iterable[Delay]) -> float:
    """Return the share of the error that a control as strong as the strongest of them takes off."""
    return float(1.0 - np.sqrt(1.0 - max(min(1.0, delay.strength**2) for delay in delays)))


NOISY_BAND = 0.6
"""Share of half the control rate above which a state changes too fast for it."""
EXPLAINED = 0.5
"""Share of the variance of the next state below which the sample before tells little."""


def fast_states(recordings: Recordings) -> Remark | None:
    """Return which state changes as fast as it is sampled, by noise or because dt is long."""
    quality, half = recordings.quality, 0.5 / recordings.quality.dt
    fast = [] if quality.unusable else [state for state in quality.states if state.bandwidth > NOISY_BAND * half]
    if not fast:
        return None
    worst = min(fast, key=lambda state: state.explained)
    others = few([state.name for state in fast if state is not worst])
    why = (
        "and the sample before tells little of it: it is noisy, or dt is too long."
        if worst.explained < EXPLAINED
        else "and it changes within few samples, so a shorter dt would show more of it."
    )
    return Remark(
        "fast states",
        f"95 % of {worst.name} lies below {worst.bandwidth:.2g} Hz, close to half the control rate ({half:g} Hz), {why}"
        + (f" Likewise {others}." if others else ""),
        RULE * (1.0 - worst.explained),
    )


JITTER = 0.1
"""Share of a step by which time stamps may scatter."""
NEAR = 0.2
"""Share of dt by which the rows of a log may be off to be taken one by one."""


def uneven_stamps(recordings: Recordings) -> Remark | None:
    """Return which logs have time stamps that scatter."""
    quality = recordings.quality
    scattered = {
        log.name: log.scatter / log.median
        for log in quality.sampling
        if log.scatter > JITTER * log.median and abs(log.median / quality.dt - 1.0) <= NEAR
    }
    if not scattered:
        return None
    worst = max(scattered.values())
    return Remark(
        "time stamps",
        f"The time stamps of {few(list(scattered))} scatter by up to {percent(worst)} of a step, but rows count as "
        "equal steps: stamp each row where its sensor is read.",
        RULE * min(1.0, worst),
        {"scatter": worst},
    )


CHECKS: tuple[Callable[[Recordings], Remark | None], ...] = (
    too_short,
    nothing_moves,
    standstill,
    rare_levels,
    rare_combinations,
    slow_switching,
    late_stamps,
    fast_states,
    uneven_stamps,
)
"""What is looked at with a model too; of one that is fitted, `late_controls` tells more than `answers_late`."""
