"""Which adaptation is taken: candidates, held-out blocks, decision.

A model and some seconds of a new condition become a correction, more training, a refit, a mean of these, or nothing, as
free runs over blocks of the recording decide that the candidate did not learn from. A model that is no farther off
there than on what was held out from its own training is left alone (`error_ratio`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np

from sysid_evo.data.dataset import Dataset
from sysid_evo.data.trajectory import evenly_spaced
from sysid_evo.errors import InvalidData, PluginError, SysidEvoError
from sysid_evo.models.adaptation.correction import AdaptationWindows, CorrectionTerms, corrections, free_runs
from sysid_evo.models.base import DynamicsModel
from sysid_evo.models.dynamics import Dynamics
from sysid_evo.progress import Counter, Progress
from sysid_evo.registry.registry import models
from sysid_evo.types import Array
from sysid_evo.validation.acceptance import AND, AcceptanceResult, HeldOutErrors, Kind, failed, judged
from sysid_evo.validation.folds import Block, blocks_of
from sysid_evo.validation.simulation_error import error_of

KINDS = ("linear", "gains", "products")
"""What a correction may be linear in, the simplest first."""
RIDGES = (3.0, 0.3, 0.03, 0.003)
"""The strongest first, which leaves the simplest correction."""

NONE = "none"
"""What is chosen where the model stays as it is."""

ANEW, REFIT = "fit anew", "refit"
"""What a fit of the family to the new seconds alone is called, and one to the training data as well."""
FURTHER = {f"trained further, {updates} updates": updates for updates in (50, 200, 800)}
"""More training of a model that learns in updates, on the new seconds from where it had ended."""
_KINDS: tuple[tuple[Kind, Kind], tuple[Kind, Kind]] = ("alone", "beside"), ("further", "mean")
"""Of another fit and of more training: what its trial is, and that of its mean with a correction."""
Way: TypeAlias = Callable[[Dataset], DynamicsModel | None]
"""How a model of new seconds is made, other than by a correction; None where that cannot be."""


@dataclass(frozen=True)
class LearnedCorrection:
    """A model, and a correction (size, nx) of it; ``held`` is what neither learned from, if there is any."""

    model: DynamicsModel
    terms: CorrectionTerms
    coefficients: Array
    held: Dataset | None = None


@dataclass(frozen=True)
class AdaptationDecision:
    """What the gate saw and decided: the error without a correction, the trials, and the one that is taken.

    ``chosen`` is the name of a trial, or "none". ``error_ratio`` is given where nothing was tried, as the model is in
    no state more than so many times farther off than on what was held out from its training.
    """

    seconds: float
    blocks: int
    plain: float
    trials: tuple[AcceptanceResult, ...]
    chosen: str
    times_home: float | None = None

    @property
    def sentence(self) -> str:
        """The decision in words."""
        if self.times_home is not None:
            return (
                "no correction: nothing much has shifted, free runs of a second are in no state more than "
                f"{self.times_home:.2f} times as far off as on what was held out from the training"
            )
        if not self.trials:
            return f"no correction: {self.seconds:.0f} s in motion are too short to hold a block back"
        taken = next((trial for trial in self.trials if trial.name == self.chosen), None)
        whole = [trial for trial in self.trials if len(trial.each) == self.blocks]
        best = min(whole, key=lambda trial: trial.error) if taken is None else taken
        change = 100.0 * (1.0 - best.error)
        seen = f"{abs(change):.0f} % {'better' if change > 0 else 'worse'} than none on {self.blocks} blocks"
        if taken is not None:
            return f"{taken.name}: {seen} it did not learn from"
        why = f"{100 * best.asked:.0f} % are asked"
        if change >= 100.0 * best.asked:
            why = "which may be chance" if best.everywhere else "but not on each of them"
        return f"no correction: the best, {best.name}, is {seen} it did not learn from; {why}"


@dataclass(frozen=True)
class Adaptation:
    """What was ``learned`` of everything, why, and ``fold_results``, without each block of time in turn; empty for
    none."""

    learned: LearnedCorrection
    verdict: AdaptationDecision
    fold_results: tuple[LearnedCorrection, ...] = ()


def adaptation(
    model: DynamicsModel,
    dataset: Dataset,
    *,
    training: Dataset | None = None,
    rng: np.random.Generator,
    progress: Progress | None = None,
) -> Adaptation:
    """Learn what ``model`` lacks in ``dataset``; with the ``training`` data, a refit with both is tried as well.

    More training is tried too, of families that can, and a fit to ``dataset`` alone, unless the family fits others; and
    the mean of each of these and the correction that is best. A model that draws noise has no such mean. What is no
    better in one block, and its mean neither, is not made for the others: it could not be believed any more.

    Corrections linear in (state, control, 1), with what the model itself predicts and with products too, each with
    several ridges, are learned by free runs on two of three blocks of time and run freely over the third. What is best
    is learned again from everything, if it is good enough (`decided`); otherwise the model stays as it is. Nothing is
    tried of a model that knows how far off it was on what was held out from its training, and is not farther off here.
    Raises `InvalidData` if no window fits.
    """
    pieces, seconds = AdaptationWindows.of(model, dataset), moving_seconds(dataset)
    blocks = blocks_of(pieces.first, pieces.horizon)
    ways = _ways(model, training, rng)
    counter = Counter(progress, 1 + len(blocks) * (len(KINDS) * len(RIDGES) + len(ways)))
    held = [pieces[block.held(pieces.first)] for block in blocks]
    nothing = _uncorrected(model, dataset)
    plain = [_run(nothing, part) for part in held]
    whole = np.concatenate([part.errors for part in plain]) if plain else np.empty(0)
    if plain and model.held_out_error_ is not None:
        times = error_ratio(whole, pieces.scale, model.held_out_error_)
        if times <= AS_AT_HOME:
            return Adaptation(nothing, AdaptationDecision(seconds, len(blocks), error_of(whole), (), NONE, times))
    trials, apart = list[AcceptanceResult](), dict[str, list[LearnedCorrection]]()
    for kind in KINDS if blocks else ():
        errors: dict[str, list[HeldOutErrors]] = {_name(kind, ridge): [] for ridge in RIDGES}
        for block, part in zip(blocks, held, strict=True):
            terms = _terms(kind, model, block.rest(dataset))
            inside = pieces[block.learned(pieces.first)]
            share = len(inside) / len(pieces)
            found = corrections(model, terms, inside, RIDGES, share * seconds)
            for name, coefficients in zip(errors, found, strict=True):
                learned = LearnedCorrection(model, terms, coefficients, block.part(dataset))
                errors[name].append(_run(learned, part))
                apart.setdefault(name, []).append(learned)
                counter.advance()
        trials += [judged(name, plain, each) for name, each in errors.items()]
    best = min(trials, key=lambda trial: trial.error).name if trials else NONE
    beside = apart.get(best, []) if not model.n_noise else []
    for name, way in ways.items() if blocks else ():
        shown = _shown(way, dataset, blocks, plain, beside, counter.advance)
        if shown is not None:
            apart[name], of_way, of_mean = shown
            alone, mean = _KINDS[name in FURTHER]
            trials.append(judged(name, plain, of_way, alone))
            if beside:
                trials.append(judged(best + AND + name, plain, of_mean, mean))
    error = error_of(whole) if plain else float("nan")
    verdict = AdaptationDecision(seconds, len(blocks), error, tuple(trials), decided(trials))
    learned = _again(model, dataset, pieces, verdict, ways)
    return Adaptation(learned, verdict, tuple(apart.get(verdict.chosen, ())))


def moving_seconds(dataset: Dataset) -> float:
    """Return how long ``dataset`` is in motion, in s."""
    return dataset.system.dt * sum(int(rows[:-1].sum()) for rows in dataset.moving)


def refitted(model: DynamicsModel, training: Dataset | None, new: Dataset, rng: np.random.Generator) -> DynamicsModel:
    """Return the family of ``model`` fitted to ``new`` and ``training``, if that is given.

    ``new`` is repeated until it counts as much. Raises what the family raises where that is too short for it.
    """
    if training is None:
        return model.clone_unfitted().fit(new, rng=rng)
    copies = max(1, round(training.n_steps / new.n_steps))
    again = [replace(e, name=f"new {copy} {e.name}") for copy in range(copies) for e in new]
    return model.clone_unfitted().fit(training.with_episodes([*training, *again]), rng=rng)


def _ways(model: DynamicsModel, training: Dataset | None, rng: np.random.Generator) -> dict[str, Way]:
    """Return how a model is made for new seconds without a correction, what changes the least first."""
    (own,) = rng.spawn(1)

    def further(updates: int) -> Way:
        return lambda data: model.fine_tuned(data, updates, rng=own)

    def again(old: Dataset | None) -> Way:
        return lambda data: refitted(model, old, data, rng)

    ways = {name: further(updates) for name, updates in FURTHER.items()}
    ways |= {} if model.families_used() or model.chooses_families else {ANEW: again(None)}
    return ways | ({} if training is None else {REFIT: again(training)})


def _again(
    model: DynamicsModel,
    dataset: Dataset,
    pieces: AdaptationWindows,
    verdict: AdaptationDecision,
    ways: Mapping[str, Way],
) -> LearnedCorrection:
    """Return what ``verdict`` chose, made of everything."""
    first, _, second = verdict.chosen.partition(AND)
    learned = _corrected(model, dataset, pieces, verdict.seconds, first)
    name = second or first
    again = ways[name](dataset) if name in ways else None
    if again is None:
        return learned
    return replace(_uncorrected(model, dataset), model=_mean(learned, again) if second else again)


def _corrected(
    model: DynamicsModel, dataset: Dataset, pieces: AdaptationWindows, seconds: float, name: str
) -> LearnedCorrection:
    """Return the correction called ``name``, learned from everything; none if none is."""
    for kind in KINDS:
        for number, ridge in enumerate(RIDGES):
            if name == _name(kind, ridge):
                terms = _terms(kind, model, dataset)
                path = corrections(model, terms, pieces, RIDGES[: number + 1], seconds)
                return LearnedCorrection(model, terms, list(path)[-1])
    return _uncorrected(model, dataset)


def _mean(corrected: LearnedCorrection, other: DynamicsModel) -> DynamicsModel:
    """Return the mean of a corrected model and another one."""
    adapted: Any = models.get("adapted")
    average: Any = models.get("average")
    found: DynamicsModel = average.made_of([adapted.holding(corrected), other])
    return found


def _uncorrected(model: DynamicsModel, dataset: Dataset) -> LearnedCorrection:
    terms = CorrectionTerms.of(dataset)
    return LearnedCorrection(model, terms, np.zeros(terms.shape))


def _shown(
    way: Way,
    dataset: Dataset,
    blocks: Sequence[Block],
    uncorrected: Sequence[HeldOutErrors],
    averaged: Sequence[LearnedCorrection],
    told: Callable[[], None],
) -> tuple[list[LearnedCorrection], list[HeldOutErrors], list[HeldOutErrors]] | None:
    """Return what is made of the rest of each block, its errors there, and those of its means with ``averaged``.

    Without ``averaged`` there are no means. The last block is one after which neither can be good any more, by the
    errors without a correction, ``uncorrected``. None if the rest of a block is too short, or a model cannot be made
    this way. Its lags may be others than those of the model that is adapted.
    """
    made, of_way, of_mean = list[LearnedCorrection](), list[HeldOutErrors](), list[HeldOutErrors]()
    for number, block in enumerate(blocks):
        try:
            again = way(block.rest(dataset))
            if again is None:
                return None
            of_way.append(_seen(again, dataset, block))
            if averaged:
                of_mean.append(_seen(_mean(averaged[number], again), dataset, block))
        except (SysidEvoError, ValueError):
            return None
        made.append(replace(_uncorrected(again, dataset), held=block.part(dataset)))
        told()
        if failed(uncorrected, of_way) and (not averaged or failed(uncorrected, of_mean)):
            break
    return made, of_way, of_mean


def _seen(model: DynamicsModel, dataset: Dataset, block: Block) -> HeldOutErrors:
    """Return the errors in ``block`` of a model whose lags are its own."""
    pieces = AdaptationWindows.of(model, dataset, stride=1)
    return _run(_uncorrected(model, dataset), pieces[block.held(pieces.first)])


def _run(learned: LearnedCorrection, pieces: AdaptationWindows) -> HeldOutErrors:
    """Return the errors of the free runs over ``pieces``."""
    terms = learned.terms
    errors = pieces.errors(free_runs(learned.model, terms, learned.coefficients[None], pieces))[0]
    return HeldOutErrors(errors, (pieces.first * terms.system.dt).astype(np.int64))


def _terms(kind: str, model: DynamicsModel, dataset: Dataset) -> CorrectionTerms:
    return CorrectionTerms.of(dataset, products=kind == "products", model=None if kind == "linear" else model)


def _name(kind: str, ridge: float) -> str:
    return f"{kind}, ridge {ridge:g}"


AS_GOOD = 0.10
"""Share of the lowest error by which a simpler correction may be worse."""

_NOTHING = AcceptanceResult(NONE, 1.0, (1.0,), sure=False)


def decided(trials: Sequence[AcceptanceResult]) -> str:
    """Return the name of what is best; "none" if nothing is good.

    Of corrections and other fits the first, which is the simplest, of those about as good as the best stands for all.
    More training, alone and in a mean with a correction, is no simpler and no less simple than these: the best of it is
    taken if it is better. Where another fit is taken, its mean with a correction takes its place if it is about as
    good: what learned from few seconds alone knows nothing of what they do not cover.
    """
    good = [trial for trial in trials if trial.good]
    alone = [trial for trial in good if trial.kind == "alone"]
    least = min((trial.error for trial in alone), default=0.0)
    simplest = [trial for trial in alone if trial.error <= (1.0 + AS_GOOD) * least][:1]
    found = [*simplest, *(trial for trial in good if trial.kind in ("further", "mean"))]
    best = min(found, key=lambda trial: trial.error, default=_NOTHING)
    beside = [trial for trial in good if trial.kind == "beside" and trial.other == best.name]
    safer = [trial for trial in beside if trial.error <= (1.0 + AS_GOOD) * best.error]
    return safer[0].name if safer else best.name


AS_AT_HOME = 1.5
"""Times the error at home, of the state that is worst, up to which nothing much has shifted."""
MOST_PIECES = 800
"""Free runs of one case: they overlap, and more of them take longer and say the same."""


def held_out_error(cases: Sequence[tuple[Dynamics, Dataset]]) -> Array | None:
    """Return the root mean square error (nx,) of free runs of one second, in the units of the states.

    ``cases`` are models of one family, each with what it did not learn from; None if one of these is too short.
    """
    squares = []
    for model, held in cases:
        try:
            pieces = AdaptationWindows.of(model, held)
        except InvalidData:
            return None
        pieces = pieces[evenly_spaced(len(pieces), MOST_PIECES, nearest=True)]
        terms = CorrectionTerms.of(held)
        wrong = pieces.errors(free_runs(model, terms, np.zeros((1, *terms.shape)), pieces))[0]
        squares.append(((wrong * pieces.scale) ** 2).reshape(-1, held.system.nx))
    return np.asarray(np.sqrt(np.concatenate(squares).mean(axis=0)))


def error_ratio(errors: Array, scale: Array, baseline_error: Array) -> float:
    """Return how many times farther off ``errors`` (B, H, nx), in units of ``scale`` (nx,), are than ``baseline_error``
    (nx,).

    What counts is the state for which these are the most: a floor that slips may show in one of them alone. Raises
    `PluginError` if ``baseline_error`` is something else than a number for each state.
    """
    if np.shape(baseline_error) != scale.shape:
        raise PluginError(
            f"held_out_error_: expected a number for each of {len(scale)} states, got the shape "
            f"{np.shape(baseline_error)}; sysid_evo.models.adaptation.held_out_error measures it"
        )
    found = np.sqrt(np.mean(errors**2, axis=(0, 1))) * scale
    return float(np.max(found / np.maximum(baseline_error, 1e-12 * scale)))
