"""Recording an environment: scripts that excite it, an episode of the data set for each of its own."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import numpy as np

from hardware.environments.environment import LONGEST_SEED, Environment, EnvironmentSession
from hardware.environments.scripts import HOLDS, RandomFeedback, Script, Steps, Sweep, Tried
from hardware.loop.report import LoopReport, Reason
from hardware.recording.scripted import Recorded
from sysid_evo.arrays import Array
from sysid_evo.data import Dataset, Trajectory
from sysid_evo.errors import InvalidArgument, InvalidData
from sysid_evo.progress import Progress

if TYPE_CHECKING:
    from hardware.loop.stops import Stops

FEWEST = 100
"""Samples that every script must last to be worth a recording."""
SHORTEST = 2
"""Samples of an episode that is kept."""
SCRIPTS = (*(f"steps-{hold:g}" for hold in HOLDS), "sweep", *(f"feedback-{i}" for i in range(1, 5)))
"""Feedback is half of the recording."""


def record_environment(
    environment: Environment,
    *,
    seed: int,
    duration: float,
    stops: Stops | None = None,
    progress: Progress | None = None,
) -> Recorded:
    """Excite ``environment`` for ``duration`` s of its time and return what it showed.

    An eighth of the time goes to each of steps of three lengths, sine sweeps, and four times random feedback.
    Whenever an episode ends, because it is over or its time is up, the next begins where the environment puts it.
    The same seed gives the same recording. Raises `InvalidArgument` if it is too short, `InvalidData` if the
    environment returns what is no number or ends every episode at once.
    """
    system = environment.system
    each = samples_each(environment, duration)
    rng = np.random.default_rng(seed)
    episodes: list[Trajectory] = []
    tried: list[Tried] = []
    reason = Reason.SAMPLES
    with environment.open() as session:
        for number, name in enumerate(SCRIPTS):
            script = _script(name, environment, episodes, tried, rng.spawn(1)[0])
            counted = _counter(progress, number * each, len(SCRIPTS) * each)
            for count, episode in enumerate(_episodes(session, environment, script, each, rng, counted)):
                if len(episode[1]) >= SHORTEST:
                    episodes.append(_trajectory(episode, environment, f"{name}-{count + 1}"))
                if stops is not None and stops.reason is not None:
                    reason = stops.reason
                    break
            if reason.is_fault:
                break
    if not episodes:
        raise InvalidData(
            f"{environment.id}: every episode ended within {SHORTEST} steps, so that nothing was recorded"
        )
    report = LoopReport(reason, "", np.zeros(0), np.zeros(0))
    return Recorded((), Dataset(system, tuple(episodes)), report)


def samples_each(environment: Environment, duration: float) -> int:
    """Return the samples of each script in a recording of ``duration`` s. Raises `InvalidArgument` for too few."""
    dt, count = environment.system.dt, len(SCRIPTS)
    each = round(duration / dt / count)
    if each < FEWEST:
        raise InvalidArgument(
            f"recording of {environment.id}: expected at least {FEWEST * count * dt / 60.0:.2g} min for "
            f"{count} scripts of {FEWEST} samples, got {duration / 60.0:.2g} min"
        )
    return each


def _script(
    name: str, environment: Environment, episodes: list[Trajectory], tried: list[Tried], rng: np.random.Generator
) -> Script:
    system = environment.system
    kind, _, which = name.partition("-")
    if kind == "steps":
        return Steps(system, float(which), rng)
    if kind == "sweep":
        return Sweep(system, rng)
    seen = [episode.states for episode in episodes]
    return RandomFeedback(system, np.concatenate(seen) if seen else system.neutral_state[None], tried, rng)


def _episodes(
    session: EnvironmentSession,
    environment: Environment,
    script: Script,
    steps: int,
    rng: np.random.Generator,
    counted: Callable[[int], None],
) -> Iterator[tuple[list[Array], list[Array]]]:
    """Yield states and controls of one episode after the other, ``steps`` in all."""
    system, done, lasted = environment.system, 0, 0
    while done < steps:
        states, controls = [session.reset(int(rng.integers(LONGEST_SEED)))], []
        script.begin(lasted)
        ended = False
        while done < steps and not ended:
            control = system.actuate(script.next(states[-1]))
            state, _, over, late = session.step(control)
            states.append(state)
            controls.append(control)
            ended = over or late
            done += 1
        lasted = len(controls)
        counted(done)
        yield states, controls


def _trajectory(episode: tuple[list[Array], list[Array]], environment: Environment, name: str) -> Trajectory:
    states, controls = episode
    return Trajectory(np.array(states), np.array(controls), environment.system.dt, name=name)


def _counter(progress: Progress | None, before: int, total: int) -> Callable[[int], None]:
    return lambda done: None if progress is None else progress(before + done, total)
