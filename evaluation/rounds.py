"""Rounds of recording: the controller of each, its claim, its fitness on the robot, the error of its models."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sysid_evo.types import Array, IntArray

ROUNDS = "rounds"
"""Name of the controller that is chosen among those of all rounds."""
ERROR_STEPS = 20
"""Steps after which the error of the models of a round is measured, on its new episodes."""
PREDICTS = 0.5
"""Error ahead up to which the models of a round predict its episodes."""
SHORT_EPISODE = 50
"""Median steps of an episode below which a recording shows little of what a controller meets later."""
MOST_AGAIN = 4
"""Most controllers that are tried again after the last round."""
CONSTANT_ERROR = 1.0
"""Error ahead of the mean of the data."""
HOLDS = 0.1
"""Share of a claim that may be missing in the recorded episodes of a round whose claim holds."""


@dataclass(frozen=True)
class RecordingRound:
    """The controller of one round, and the episodes that were recorded under it.

    ``parameters`` (n,) are those of ``controller``, a spec as text. ``claimed`` (J,) is its fitness in the models,
    ``achieved`` (J,) that of the judged episodes on the robot: those without noise on the commands, or all if each has
    noise. Both are under the same conditions. ``steps`` (E,) are those of every episode. ``errors`` gives the error of
    each model `ERROR_STEPS` steps ahead on these episodes, in standard deviations of the data; the models were fitted
    without them. ``again`` (K,) is the fitness in further episodes on the robot, without noise, of a controller that
    may be the best of all rounds; None of others.
    """

    number: int
    controller: str
    parameters: Array
    claimed: Array
    achieved: Array
    steps: IntArray
    errors: Mapping[str, float]
    again: Array | None = None

    @property
    def fitness(self) -> Array:
        """Fitness on the robot by which the controller is compared: ``again`` if it is known, else ``achieved``."""
        return self.achieved if self.again is None else self.again

    @property
    def judged_steps(self) -> IntArray:
        """Steps of the judged episodes, the last ones."""
        return self.steps[-len(self.achieved) :]

    @property
    def holds(self) -> bool:
        """Whether the episodes achieve what the models claimed, up to a tenth of it and two standard errors."""
        claimed, achieved = float(self.claimed.mean()), float(self.achieved.mean())
        return achieved >= claimed - self.tolerance

    @property
    def is_exact(self) -> bool:
        """Whether the claim holds and is not exceeded, within the same limits."""
        return self.holds and float(self.achieved.mean()) <= float(self.claimed.mean()) + self.tolerance

    @property
    def tolerance(self) -> float:
        """Difference to a claim that counts as none."""
        return max(HOLDS * abs(float(self.claimed.mean())), 2.0 * self.standard_error)

    @property
    def standard_error(self) -> float:
        """Standard error of the mean fitness of the judged episodes."""
        return float(self.achieved.std(ddof=1) / np.sqrt(len(self.achieved)))


@dataclass(frozen=True)
class RoundsSummary:
    """All rounds so far, the steps of the ``first`` recording, and the median length of its episodes.

    ``ended`` is the reason why no further round is made, empty if there is none. ``rest`` (K,) is the fitness of
    controls at rest on the robot, measured after the last round, in the episodes of ``again``; None before. The latter
    have ``steps_again`` steps in all, and are ``whole`` if they are as long as a trial of the task.
    """

    first: int
    first_episode: int
    rounds: tuple[RecordingRound, ...] = ()
    ended: str = ""
    rest: Array | None = None
    steps_again: int = 0
    whole: bool = False

    @property
    def steps(self) -> int:
        """All steps on the robot, but those at rest."""
        return self.first + sum(int(one.steps.sum()) for one in self.rounds) + self.steps_again

    @property
    def compared(self) -> tuple[RecordingRound, ...]:
        """The rounds among whose controllers one is chosen: those tried again, all of them if none was."""
        return tuple(one for one in self.rounds if one.again is not None) or self.rounds

    def round_of(self, parameters: Array) -> RecordingRound | None:
        """Return the round whose controller has these ``parameters``, None without."""
        return next((one for one in self.rounds if np.array_equal(one.parameters, parameters)), None)

    @property
    def better_than_rest(self) -> bool:
        """Whether the best controller achieved more on the robot than controls at rest."""
        best = max((float(one.fitness.mean()) for one in self.compared), default=-np.inf)
        return self.rest is not None and best > float(self.rest.mean())


def best_round(known: Sequence[RecordingRound]) -> RecordingRound | None:
    """Return the round with the highest mean fitness in its judged episodes, None without any."""
    return max(known, key=lambda one: float(one.achieved.mean()), default=None)


def rounds_to_try_again(known: Sequence[RecordingRound]) -> list[RecordingRound]:
    """Return the rounds that may be the best, the best first and of equals the latest: at most `MOST_AGAIN`.

    They are within two standard errors of the difference to the best one. The highest of many means of a few episodes
    is too high by chance, so the choice among them needs others.
    """
    ranked = sorted(known, key=lambda one: (float(one.achieved.mean()), one.number), reverse=True)
    best = ranked[0]
    near = [
        one
        for one in ranked
        if best.achieved.mean() - one.achieved.mean() <= 2.0 * np.hypot(best.standard_error, one.standard_error)
    ]
    return near[:MOST_AGAIN]


def round_to_continue(known: Sequence[RecordingRound]) -> RecordingRound | None:
    """Return the last round that is no worse than the best up to its standard error, None without any.

    A search that always continued from the best would do the same again after every round that is just below it.
    """
    best = best_round(known)
    equal = [
        one for one in known if best and float(one.achieved.mean()) + one.standard_error >= float(best.achieved.mean())
    ]
    return equal[-1] if equal else None


def labels_to_search(known: Sequence[RecordingRound], labels: Sequence[str]) -> list[str]:
    """Return the models in which the next round evolves: all, or without those that are worse than a constant.

    The latter if another one predicted the last round: the minimum over the models forbids what one of them underrates.
    Where none predicts, that minimum is what protects from exploits.
    """
    errors = known[-1].errors if known else {}
    if min(errors.values(), default=np.inf) > PREDICTS:
        return list(labels)
    return [label for label in labels if errors[label] <= CONSTANT_ERROR]


def reason_to_end(known: Sequence[RecordingRound], last: RecordingRound, steps: int) -> str:
    """Return why no round follows ``last``, empty if one does; ``known`` are those before it.

    Where every episode has noise, rounds end if the last two claims were exact, and the last one gained nothing over
    the best before it: models that claim less than is achieved have more to learn. Its episodes must have lasted all
    ``steps``, or a model must predict them, because a claim of next to nothing holds easily. Rounds that are worse than
    an earlier one are no reason to end: a double pendulum rises after seven of them.
    """
    if len(last.achieved) < len(last.steps):
        return ""
    settled = bool((last.steps >= steps).all()) or min(last.errors.values(), default=np.inf) <= PREDICTS
    best = best_round(known)
    if best is None or not known[-1].is_exact or not last.is_exact or not settled:
        return ""
    gains = float(last.achieved.mean()) > float(best.achieved.mean()) + 2.0 * best.standard_error
    return "" if gains else "the claims of two rounds were exact, and the last one gained nothing"
