"""Checks of a recording by itself: length, standstill, use of the controls, delays, noise, time stamps."""

from __future__ import annotations

from collections.abc import Callable

from evaluation.advice.evidence import Recordings, Remark
from evaluation.formatting import few, percent
from sysid_evo.data.units import spelled, spelled_time

RULE_WEIGHT = 0.3
"""Weight of a rule of thumb, per share of time that it concerns: measured findings come first."""
TIMES_PER_CHANNEL, MIN_LENGTH_SHARE = 30.0, 0.9
"""Recommended length of a recording in slowest time scales, for each state and control (a rule of thumb), and the share
of it that is accepted."""


def too_short(recordings: Recordings) -> Remark | None:
    """Return a remark if the recording covers few of the slowest time scales, or if these are not known."""
    quality = recordings.quality
    if quality.unusable:
        return Remark("unusable", quality.unusable, 1.0)
    if not quality.scales:
        sentence = (
            "The response time of the states cannot be estimated from this recording: excite the controls more, and "
            "record episodes several times as long as the slowest response."
        )
        return Remark("time scale", sentence, RULE_WEIGHT)
    driven, slowest = quality.duration * quality.moving, quality.scales[-1]
    channels = len(quality.states) + len(quality.controls)
    wanted = TIMES_PER_CHANNEL * channels * slowest
    sentence = (
        f"{spelled_time(driven)}{' in motion' if quality.moving < 1.0 else ''} are only {driven / slowest:.0f} times "
        f"the slowest time scale of the states ({spelled_time(slowest)}). Recommended are {TIMES_PER_CHANNEL:.0f} "
        f"times for each of the {channels} states and controls: record {spelled_time(wanted)} in all."
    )
    return (
        Remark("length", sentence, RULE_WEIGHT * (1.0 - driven / wanted))
        if driven < MIN_LENGTH_SHARE * wanted
        else None
    )


IDLE = 0.3
"""Share of the time at rest that is accepted."""


def standstill(recordings: Recordings) -> Remark | None:
    """Return a remark if the robot is at rest for much of the time, and on episodes in which nothing moves."""
    idle, episodes, rest_share = recordings.quality.idle, recordings.quality.episodes, 1.0 - recordings.quality.moving
    in_episodes = (
        f"Nothing moves in {len(idle)} of {episodes} episodes: {few(idle)}. Leave them out, and check whether the "
        "robot was switched on and its sensors worked."
    )
    for_long = (
        f"The robot is at rest {percent(rest_share)} of the time: models learn little from that, and prediction errors "
        "leave it out."
    )
    sentence = " ".join([in_episodes] * bool(idle) + [for_long] * (rest_share > IDLE))
    return Remark("standstill", sentence, RULE_WEIGHT * max(rest_share, len(idle) / episodes)) if sentence else None


RARE, RARE_TOGETHER = 0.02, 0.01
"""Shares of the time below which a level of a control, and a combination of levels, is rare."""


def rare_commands(recordings: Recordings) -> Remark | None:
    """Return a remark on rare levels and combinations of levels of controls; None if the needed ones are known."""
    if recordings.visited is not None:
        return None
    controls, sentences, missing = recordings.quality.controls, [], 0.0
    near = []
    for use in controls:
        rare = [level for level, share in zip(use.levels, use.shares, strict=True) if share < RARE]
        if rare:
            near.append(f"{use.name} is near {', '.join(spelled(level, use.levels) for level in rare)}")
            missing = max(missing, len(rare) / len(use.levels))
    if near:
        sentences.append(f"{' and '.join(near)} less than {100 * RARE:.0f} % of the time: models extrapolate there.")
    together = [command for command in recordings.quality.commands if command.share < RARE_TOGETHER]
    if together and len(controls) > 1:
        names = ", ".join(use.name for use in controls)
        listed = "; ".join(", ".join(map(spelled, command.levels)) for command in together)
        sentences.append(f"Less than {100 * RARE_TOGETHER:.0f} % of the time at ({names}) near: {listed}.")
        missing = max(missing, len(together) / len(recordings.quality.commands))
    return Remark("rare commands", " ".join(sentences), RULE_WEIGHT * missing) if sentences else None


SETTLING_SCALES = 5.0
"""A control held for this many time scales lets the states settle; holding it longer adds no information."""
FEW_SWITCHES = 10
"""Number of changes of a control that is accepted if no time scale is known."""


def slow_switching(recordings: Recordings) -> Remark | None:
    """Return a remark on controls that are held so long that the states have settled most of the time."""
    quality = recordings.quality
    settled = SETTLING_SCALES * quality.scales[-1] if quality.scales else quality.duration / (FEW_SWITCHES + 1)
    held = {use.name: quality.duration / (use.switches + 1) for use in quality.controls}
    slow = sorted((name for name in held if held[name] > settled), key=lambda name: -held[name])
    if not slow:
        return None
    known = f", but the states settle within {spelled_time(settled)}" if quality.scales else ""
    sentence = (
        f"{slow[0]} stays near a level for {spelled_time(held[slow[0]])} on average{known}: change it more often, so "
        f"that the data contain transients.{f' Likewise {few(slow[1:])}.' if slow[1:] else ''}"
    )
    return Remark("slow switching", sentence, RULE_WEIGHT * (1.0 - settled / held[slow[0]]))


def late_stamps(recordings: Recordings) -> Remark | None:
    """Return a remark if states move before a control is logged."""
    early = [delay for delay in recordings.delays if delay.steps < 0]
    named = ", ".join(f"{one.state} moves {spelled_time(-one.seconds)} before {one.control} is logged" for one in early)
    sentence = f"{named}: commands are stamped late, or a fast loop controls the state."
    return Remark("late stamps", sentence, RULE_WEIGHT * max(abs(one.strength) for one in early)) if early else None


def simultaneous_samples(recordings: Recordings) -> Remark | None:
    """Return a remark if simulations are clearly better with the control that was logged after each step."""
    timing = recordings.timing
    if timing is None or not timing.simultaneous:
        return None
    sentence = (
        f"Simulations of held-out data are {timing.ratio:.2f} times as accurate if each step has the control that was "
        f"logged after it (error {timing.after:.3f} instead of {timing.before:.3f} standard deviations), as in records "
        "whose signals are sampled at the same instant: for models to simulate with, import the log with --advance, or "
        "use Dataset.advanced(). No controller can use such models: for controllers, check whether the log stamps "
        "commands too late."
    )
    return Remark("simultaneous samples", sentence, 1.0 - 1.0 / timing.ratio)


def late_answers(recordings: Recordings) -> Remark | None:
    """Return a remark on the delay with which controls act."""
    late = [delay for delay in recordings.delays if delay.steps > 0]
    if not late:
        return None
    named = ", ".join(f"{one.state} responds to {one.control} {spelled_time(one.seconds)} later" for one in late)
    sentence = f"{named}: set control_lags of the models to {max(one.steps for one in late)} or more."
    return Remark("late answers", sentence, RULE_WEIGHT)


NOISY_BAND = 0.6
"""Share of half the control rate above which a state changes too fast for it."""
EXPLAINED = 0.5
"""Share of the variance of the next state below which the previous sample explains little of it."""


def fast_states(recordings: Recordings) -> Remark | None:
    """Return a remark on states that change as fast as they are sampled, because of noise or a long dt."""
    quality, half = recordings.quality, 0.5 / recordings.quality.dt
    fast = sorted((one for one in quality.states if one.bandwidth > NOISY_BAND * half), key=lambda one: one.explained)
    if quality.unusable or not fast:
        return None
    worst, others = fast[0], few([one.name for one in fast[1:]])
    noisy = "and the previous sample explains little of it: it is noisy, or dt is too long."
    quick = "and it changes within few samples: a shorter dt would resolve it better."
    sentence = (
        f"95 % of {worst.name} lies below {worst.bandwidth:.2g} Hz, close to half the control rate ({half:g} Hz), "
        f"{noisy if worst.explained < EXPLAINED else quick}{f' Likewise {others}.' if others else ''}"
    )
    return Remark("fast states", sentence, RULE_WEIGHT * (1.0 - worst.explained))


JITTER = 0.1
"""Scatter of time stamps, as a share of a step, that is accepted."""
NEAR = 0.2
"""Deviation, as a share of dt, up to which the rows of a log are used one by one."""


def uneven_stamps(recordings: Recordings) -> Remark | None:
    """Return a remark on logs with scattered time stamps."""
    quality = recordings.quality
    scatter = {
        log.name: log.scatter / log.median
        for log in quality.sampling
        if log.scatter > JITTER * log.median and abs(log.median / quality.dt - 1.0) <= NEAR
    }
    worst = max(scatter.values(), default=0.0)
    sentence = (
        f"The time stamps of {few(list(scatter))} scatter by up to {percent(worst)} of a step, but rows are treated as "
        "equal steps: stamp each row where its sensor is read."
    )
    return Remark("time stamps", sentence, RULE_WEIGHT * min(1.0, worst)) if scatter else None


CHECKS: tuple[Callable[[Recordings], Remark | None], ...] = (
    too_short,
    standstill,
    rare_commands,
    slow_switching,
    late_stamps,
    simultaneous_samples,
    fast_states,
    uneven_stamps,
)
"""Checks that are made with a model, too; for a fitted model `late_controls` is more exact than `late_answers`."""
