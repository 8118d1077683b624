"""What to do about a recording, in sentences, from what `advise` measured."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from sysid_evo.data.delays import Delay

if TYPE_CHECKING:
    from sysid_evo.data.advice import Advice, ControlUse, StateUse

TIMES_PER_CHANNEL, NEARLY = 30.0, 0.9
"""How often a recording should last the slowest time scale, for each state and control: a rule of thumb, so
that nine tenths of it pass."""

SETTLED = 5.0
"""A control held for this many time scales lets the states settle, and more of the same teaches nothing."""

FEW_SWITCHES = 10  # in all, where no time scale is known
RARE = 0.02  # share of time
RARE_TOGETHER = 0.01  # share of time
IDLE = 0.3  # share of time
NOISY_BAND = 0.6  # share of half the control rate
EXPLAINED = 0.5  # share of the variance of the next state
JITTER = 0.1  # share of a step
NEAR = 0.2  # share of dt by which the rows of a log may be off to be taken one by one
NAMED = 4


def suggestions(advice: Advice) -> Iterator[str]:
    """Yield what to do, in sentences; nothing if the recording is fine."""
    yield from _about_length(advice)
    yield from _about_standstill(advice)
    for use in advice.controls:
        yield from _about_control(use, advice)
    yield from _about_combinations(advice)
    for use in advice.controls:
        clear = [delay for delay in advice.delays if delay.control == use.name and delay.clear]
        if clear:
            yield from _about_delay(max(clear, key=lambda delay: abs(delay.strength)))
    if not advice.unusable:
        for state in advice.states:
            yield from _about_band(state, 0.5 / advice.dt)
    yield from _about_stamps(advice)


def _about_length(advice: Advice) -> Iterator[str]:
    if advice.unusable:
        yield advice.unusable
        return
    if not advice.scales:
        yield (
            "How fast the states answer cannot be told from this recording: excite the controls more, and record "
            "episodes that last several times as long as the slowest answer."
        )
        return
    driven, slowest = advice.duration * advice.moving, advice.scales[-1]
    channels = len(advice.states) + len(advice.controls)
    wanted = TIMES_PER_CHANNEL * channels * slowest
    if driven < NEARLY * wanted:
        motion = " in motion" if advice.moving < 1.0 else ""
        yield (
            f"{spell(driven)}{motion} are {driven / slowest:.0f} times the slowest time scale of the states, "
            f"{spell(slowest)}. {TIMES_PER_CHANNEL:.0f} times for each of the {channels} states and controls are a "
            f"good rule: record {spell(wanted)} in all."
        )


def _about_standstill(advice: Advice) -> Iterator[str]:
    if advice.idle:
        yield (
            f"Nothing moves in {len(advice.idle)} of {advice.episodes} episodes: {named(advice.idle)}. Leave them out, "
            "and see whether the robot was switched on and its sensors alive."
        )
    if advice.moving < 1.0 - IDLE:
        yield (
            f"The robot stands still {1.0 - advice.moving:.0%} of the time: little can be learned there, and "
            "prediction errors leave such stretches out."
        )


def _about_control(use: ControlUse, advice: Advice) -> Iterator[str]:
    rare = [f"{level:.3g}" for level, share in zip(use.levels, use.shares, strict=True) if share < RARE]
    if rare:
        yield f"{use.name} is near {', '.join(rare)} less than {RARE:.0%} of the time: models will guess there."
    hold = advice.duration / (use.switches + 1)
    if advice.scales and hold > SETTLED * advice.scales[-1]:
        yield (
            f"{use.name} stays near a level for {spell(hold)} on average, but the states settle within "
            f"{spell(SETTLED * advice.scales[-1])}: change it more often, so that the way there is in the data."
        )
    elif not advice.scales and use.switches < FEW_SWITCHES:
        how_often = "once" if use.switches == 1 else f"{use.switches} times"
        yield (
            f"{use.name} changes its level only {how_often}: change it more often, so that the answer to a change is "
            "in the data."
        )


def _about_combinations(advice: Advice) -> Iterator[str]:
    never = [command.levels for command in advice.commands if command.share < RARE_TOGETHER]
    if never and len(advice.controls) > 1:
        names = ", ".join(use.name for use in advice.controls)
        listed = "; ".join(", ".join(f"{level:.3g}" for level in levels) for levels in never)
        yield f"Less than {RARE_TOGETHER:.0%} of the time at ({names}) near: {listed}."


def _about_delay(delay: Delay) -> Iterator[str]:
    if delay.steps < 0:
        yield (
            f"{delay.state} moves {spell(-delay.seconds)} before {delay.control} is logged: commands are stamped late, "
            "or something fast feeds the state back."
        )
    elif delay.steps > 0:
        yield (
            f"{delay.state} answers {delay.control} {spell(delay.seconds)} later: "
            f"give the models control_lags of {delay.steps} or more."
        )


def _about_band(use: StateUse, half: float) -> Iterator[str]:
    if use.bandwidth <= NOISY_BAND * half:
        return
    so_far = f"95 % of {use.name} lies below {use.bandwidth:.2g} Hz, close to half the control rate ({half:g} Hz)"
    if use.explained < EXPLAINED:
        yield f"{so_far}, and the sample before tells little of it: it is noisy, or dt is too long."
    else:
        yield f"{so_far}: it changes within few samples, so a shorter dt would show more of it."


def _about_stamps(advice: Advice) -> Iterator[str]:
    scattered = [
        log
        for log in advice.sampling
        if log.scatter > JITTER * log.median and abs(log.median / advice.dt - 1.0) <= NEAR
    ]
    if scattered:
        worst = max(log.scatter / log.median for log in scattered)
        yield (
            f"The time stamps of {named([log.name for log in scattered])} scatter by up to {worst:.0%} of a step, but "
            "rows count as equal steps: stamp each row where its sensor is read."
        )


def named(names: Sequence[str]) -> str:
    """Return the first names, and how many more there are."""
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return ", ".join(names[:NAMED]) + more


def spell(seconds: float) -> str:
    """Return a length of time in the unit that people use for it."""
    if seconds < 0.9995:
        return f"{1e3 * seconds:.0f} ms"
    size, unit = next(
        (size, unit)
        for size, unit in ((1.0, "s"), (60.0, "min"), (3600.0, "h"))
        if seconds < 120.0 * size or unit == "h"
    )
    return f"{seconds / size:.2g} {unit}" if seconds < 10.0 * size else f"{seconds / size:.0f} {unit}"
