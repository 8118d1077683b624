"""Selection of an adaptation: candidates, held-out blocks, decision.

The candidates are corrections of the action or of the acceleration, fine-tuned models, refits and means of these. They
are compared by simulations of blocks of the recording that they were not fitted to. Nothing is tried if the error of
the model is similar to that on its own held-out data (`error_ratio`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np

from sysid_evo.data.dataset import Dataset
from sysid_evo.data.trajectory import evenly_spaced
from sysid_evo.errors import InvalidData, PluginError, SysidEvoError
from sysid_evo.models.adaptation.action import ActionCorrection, action_corrections
from sysid_evo.models.adaptation.correction import (
    SECOND,
    AdaptationWindows,
    CorrectionTerms,
    corrections,
    simulate_corrections,
)
from sysid_evo.models.base import DynamicsModel
from sysid_evo.models.dynamics import Dynamics
from sysid_evo.progress import Counter, Progress
from sysid_evo.registry.registry import models
from sysid_evo.types import Array
from sysid_evo.validation.acceptance import AND, AcceptanceResult, HeldOutErrors, Kind, acceptance_result, failed
from sysid_evo.validation.folds import Block, blocks_of

ACTION, DELAYED, BOTH = "action", "delayed action", "action + gains"
KINDS = (ACTION, "linear", "gains", BOTH, DELAYED, "products")
"""Kinds of corrections, the simplest first: of the action, of the acceleration with these regressors, or of both."""
RIDGES = (3.0, 0.3, 0.03, 0.003)
"""The strongest first, which gives the smallest correction."""
ACTION_RIDGES = RIDGES[:2]
"""Those of the action, which has few numbers."""

NONE = "none"
"""The choice if the model is not changed."""

NEW_FIT, REFIT = "fit to the new data", "refit"
"""Names of a fit of the family to the new data alone, and of one to old and new data."""
FINE_TUNED = {f"fine-tuned, {updates} updates": updates for updates in (50, 200, 800)}
"""Number of further training updates on the new data, from the present weights, by name."""
_KINDS: tuple[tuple[Kind, Kind], tuple[Kind, Kind]] = ("fit", "fit_mean"), ("fine_tuned", "fine_tuned_mean")
"""For fits and for fine-tuned models: the kind of the candidate, and that of its mean with a correction."""
ModelMaker: TypeAlias = Callable[[Dataset], DynamicsModel | None]
"""Returns a model of the new data other than by a correction; None if that is impossible."""


@dataclass(frozen=True)
class LearnedCorrection:
    """A model, its correction (size, nx), and that of its action; ``held`` are the data held out from all, if any."""

    model: DynamicsModel
    terms: CorrectionTerms
    coefficients: Array
    held: Dataset | None = None
    action: ActionCorrection | None = None


@dataclass(frozen=True)
class AdaptationDecision:
    """Result of the acceptance test: the ``trials`` of candidates, and the ``chosen`` one.

    ``chosen`` is the name of a trial, or "none". ``error_ratio`` (see there) is given if nothing was tried because it
    is at most ``least_ratio``.
    """

    seconds: float
    blocks: int
    trials: tuple[AcceptanceResult, ...]
    chosen: str
    error_ratio: float | None = None
    least_ratio: float = 1.0

    @property
    def sentence(self) -> str:
        """The decision as a sentence."""
        if self.error_ratio is not None:
            return (
                f"not adapted: the 1 s simulation error is at most {self.error_ratio:.2f} times the held-out training "
                f"error in every state; with {self.seconds:.0f} s, corrections are tried above {self.least_ratio:.2f}"
            )
        if not self.trials:
            return f"not adapted: {self.seconds:.0f} s in motion are too short for three blocks"
        chosen = next((trial for trial in self.trials if trial.name == self.chosen), None)
        if chosen is not None:
            lower = 100.0 * (1.0 - chosen.error)
            of_blocks = ", ".join(f"{100.0 * (1.0 - share):.0f}" for share in chosen.each)
            return (
                f"{chosen.name}: error {lower:.0f} % lower on {self.blocks} blocks it was not fitted to ({of_blocks} %)"
            )
        complete = [trial for trial in self.trials if len(trial.each) == self.blocks]
        best = min(complete, key=lambda trial: trial.error)
        change = 100.0 * (1.0 - best.error)
        reason = f"{100 * best.required:.0f} % are required"
        if change >= 100.0 * best.required:
            worse = 100.0 * (max(best.each) - 1.0)
            reason = (
                "which may be chance" if best.consistent else f"but {worse:.0f} % worse in one of {self.blocks} blocks"
            )
        better = "better" if change > 0 else "worse"
        return f"not adapted: the best candidate ({best.name}) is {abs(change):.0f} % {better}, {reason}"


@dataclass(frozen=True)
class Adaptation:
    """The correction ``learned`` from all data, the ``decision``, and ``fold_results`` without each block in turn."""

    learned: LearnedCorrection
    decision: AdaptationDecision
    fold_results: tuple[LearnedCorrection, ...] = ()


def adaptation(
    model: DynamicsModel,
    dataset: Dataset,
    *,
    training: Dataset | None = None,
    rng: np.random.Generator,
    progress: Progress | None = None,
) -> Adaptation:
    """Return the adaptation of ``model`` to ``dataset``; with its ``training`` data, a refit to both is tried as well.

    Corrections of the action; of the acceleration, linear in (1, state, control), then with gains; of both; of the
    action with a delay; and of the acceleration with products, each with several ridges, are fitted to two of three
    blocks of time and simulated on the third. Further candidates are fine-tuning, if the family has it; a fit to
    ``dataset`` alone, unless the family fits other families; and the mean of each of these and the best correction,
    unless the model draws noise. If a candidate and its mean are much worse in one block, its remaining blocks are
    skipped.

    The best candidate that passes the test (`decided`) is fitted again to all of ``dataset``; without one the model is
    not changed. Nothing is tried if the held-out error of the model is known and its error here is similar. Raises
    `InvalidData` if no window fits.
    """
    windows, seconds = AdaptationWindows.of(model, dataset), moving_seconds(dataset)
    blocks = blocks_of(windows.first, windows.horizon)
    makers = _model_makers(model, training, rng)
    counter = Counter(progress, 1 + len(blocks) * (sum(len(_ridges(kind)) for kind in KINDS) + len(makers)))
    held = [windows[block.held(windows.first)] for block in blocks]
    nothing = _uncorrected(model, dataset)
    uncorrected = [_errors(nothing, part) for part in held]
    if uncorrected and model.held_out_error_ is not None:
        errors_of_all = np.concatenate([part.errors for part in uncorrected])
        ratio = error_ratio(errors_of_all, windows.scale, model.held_out_error_)
        least = unchanged_ratio(sum(len(part.sizes()) for part in uncorrected))
        if ratio <= least:
            return Adaptation(nothing, AdaptationDecision(seconds, len(blocks), (), NONE, ratio, least))
    trials, fold_results = list[AcceptanceResult](), dict[str, list[LearnedCorrection]]()
    for kind in KINDS if blocks else ():
        errors: dict[str, list[HeldOutErrors]] = {_name(kind, ridge): [] for ridge in _ridges(kind)}
        for block, part in zip(blocks, held, strict=True):
            inside = windows[block.learned(windows.first)]
            share = len(inside) / len(windows)
            found = _corrections(kind, model, block.rest(dataset), inside, _ridges(kind), share * seconds)
            for name, one in zip(errors, found, strict=True):
                learned = replace(one, held=block.part(dataset))
                errors[name].append(_errors(learned, part))
                fold_results.setdefault(name, []).append(learned)
                counter.advance()
        trials += [acceptance_result(name, uncorrected, each) for name, each in errors.items()]
    best = min(trials, key=lambda trial: trial.error).name if trials else NONE
    averaged = fold_results.get(best, []) if not model.n_noise else []
    for name, make in makers.items() if blocks else ():
        tested = _tested(make, dataset, blocks, uncorrected, averaged, counter.advance)
        if tested is not None:
            fold_results[name], of_model, of_mean = tested
            kind_of_model, kind_of_mean = _KINDS[name in FINE_TUNED]
            trials.append(acceptance_result(name, uncorrected, of_model, kind_of_model))
            if averaged:
                trials.append(acceptance_result(best + AND + name, uncorrected, of_mean, kind_of_mean))
    decision = AdaptationDecision(seconds, len(blocks), tuple(trials), decided(trials))
    learned = _fitted_to_all(model, dataset, windows, decision, makers)
    return Adaptation(learned, decision, tuple(fold_results.get(decision.chosen, ())))


def moving_seconds(dataset: Dataset) -> float:
    """Return the time in motion of ``dataset``, in s."""
    return dataset.system.dt * sum(int(rows[:-1].sum()) for rows in dataset.moving)


def refitted(model: DynamicsModel, training: Dataset | None, new: Dataset, rng: np.random.Generator) -> DynamicsModel:
    """Return the family of ``model`` fitted to ``new`` and, if given, ``training``.

    ``new`` is repeated until it is about as long as ``training``. Raises the errors of the family for short data.
    """
    if training is None:
        return model.clone_unfitted().fit(new, rng=rng)
    copies = max(1, round(training.n_steps / new.n_steps))
    repeated = [replace(e, name=f"new {copy} {e.name}") for copy in range(copies) for e in new]
    return model.clone_unfitted().fit(training.with_episodes([*training, *repeated]), rng=rng)


def _model_makers(model: DynamicsModel, training: Dataset | None, rng: np.random.Generator) -> dict[str, ModelMaker]:
    """Return the candidates other than corrections by name, in order of increasing change."""
    (own,) = rng.spawn(1)

    def fine_tuned(updates: int) -> ModelMaker:
        return lambda data: model.fine_tuned(data, updates, rng=own)

    def fit(old: Dataset | None) -> ModelMaker:
        return lambda data: refitted(model, old, data, rng)

    makers = {name: fine_tuned(updates) for name, updates in FINE_TUNED.items()}
    makers |= {} if model.families_used() or model.chooses_families else {NEW_FIT: fit(None)}
    return makers | ({} if training is None else {REFIT: fit(training)})


def _fitted_to_all(
    model: DynamicsModel,
    dataset: Dataset,
    windows: AdaptationWindows,
    decision: AdaptationDecision,
    makers: Mapping[str, ModelMaker],
) -> LearnedCorrection:
    """Return the candidate that ``decision`` chose, fitted to all of ``dataset``."""
    first, _, second = decision.chosen.partition(AND)
    learned = _corrected(model, dataset, windows, decision.seconds, first)
    name = second or first
    other = makers[name](dataset) if name in makers else None
    if other is None:
        return learned
    return replace(_uncorrected(model, dataset), model=_mean(learned, other) if second else other)


def _corrected(
    model: DynamicsModel, dataset: Dataset, windows: AdaptationWindows, seconds: float, name: str
) -> LearnedCorrection:
    """Return the correction called ``name``, fitted to all of ``dataset``; zero if there is none of this name."""
    for kind in KINDS:
        for number, ridge in enumerate(_ridges(kind)):
            if name == _name(kind, ridge):
                return list(_corrections(kind, model, dataset, windows, _ridges(kind)[: number + 1], seconds))[-1]
    return _uncorrected(model, dataset)


def _corrections(
    kind: str,
    model: DynamicsModel,
    dataset: Dataset,
    windows: AdaptationWindows,
    ridges: Sequence[float],
    seconds: float,
) -> Iterator[LearnedCorrection]:
    """Yield the correction of this ``kind`` for each of ``ridges``, with regressors scaled to ``dataset``."""
    found = _uncorrected(model, dataset)
    if kind in (ACTION, DELAYED, BOTH):
        own_ridges, delayed = ACTION_RIDGES if kind == BOTH else ridges, kind == DELAYED
        for action in action_corrections(model, found.terms, windows, own_ridges, seconds, delayed=delayed):
            found = replace(found, action=action)
            if kind != BOTH:
                yield found
    if kind in (ACTION, DELAYED):
        return
    if found.action is not None:
        dataset, windows = found.action.recorded(dataset), found.action.applied(model, windows)
    terms = CorrectionTerms.of(dataset, products=kind == "products", model=None if kind == "linear" else model)
    for coefficients in corrections(model, terms, windows, ridges, seconds):
        yield replace(found, terms=terms, coefficients=coefficients)


def _mean(corrected: LearnedCorrection, other: DynamicsModel) -> DynamicsModel:
    """Return the mean of a corrected model and the ``other`` one."""
    adapted: Any = models.get("adapted")
    average: Any = models.get("average")
    found: DynamicsModel = average.made_of([adapted.holding(corrected), other])
    return found


def _uncorrected(model: DynamicsModel, dataset: Dataset) -> LearnedCorrection:
    terms = CorrectionTerms.of(dataset)
    return LearnedCorrection(model, terms, np.zeros(terms.shape))


def _tested(
    make: ModelMaker,
    dataset: Dataset,
    blocks: Sequence[Block],
    uncorrected: Sequence[HeldOutErrors],
    averaged: Sequence[LearnedCorrection],
    report: Callable[[], None],
) -> tuple[list[LearnedCorrection], list[HeldOutErrors], list[HeldOutErrors]] | None:
    """Return the models made without each block, their errors there, and those of their means with ``averaged``.

    Without ``averaged`` there are no means. The blocks end early once neither the model nor the mean can pass the test,
    compared with the ``uncorrected`` errors. None if the data without a block are too short, or such a model cannot be
    made. Its lags may differ from those of the adapted model.
    """
    made, of_model, of_mean = list[LearnedCorrection](), list[HeldOutErrors](), list[HeldOutErrors]()
    for number, block in enumerate(blocks):
        try:
            model = make(block.rest(dataset))
            if model is None:
                return None
            of_model.append(_errors_in(block, model, dataset))
            if averaged:
                of_mean.append(_errors_in(block, _mean(averaged[number], model), dataset))
        except (SysidEvoError, ValueError):
            return None
        made.append(replace(_uncorrected(model, dataset), held=block.part(dataset)))
        report()
        if failed(uncorrected, of_model) and (not averaged or failed(uncorrected, of_mean)):
            break
    return made, of_model, of_mean


def _errors_in(block: Block, model: DynamicsModel, dataset: Dataset) -> HeldOutErrors:
    """Return the errors in ``block`` of a model with its own lags."""
    windows = AdaptationWindows.of(model, dataset, stride=1)
    return _errors(_uncorrected(model, dataset), windows[block.held(windows.first)])


def _errors(learned: LearnedCorrection, windows: AdaptationWindows) -> HeldOutErrors:
    """Return the errors of the simulations of ``windows``."""
    terms = learned.terms
    windows = windows if learned.action is None else learned.action.applied(learned.model, windows)
    errors = windows.errors(simulate_corrections(learned.model, terms, learned.coefficients[None], windows))[0]
    return HeldOutErrors(errors, windows.first // max(windows.horizon, round(SECOND / terms.system.dt)))


def _ridges(kind: str) -> tuple[float, ...]:
    return ACTION_RIDGES if kind in (ACTION, DELAYED) else RIDGES


def _name(kind: str, ridge: float) -> str:
    return f"{kind}, ridge {ridge:g}"


EQUAL_SHARE = 0.10
"""A simpler candidate may be worse than the best by about this share of its error."""

_NOTHING = AcceptanceResult(NONE, 1.0, (1.0,), sure=False)


def decided(trials: Sequence[AcceptanceResult]) -> str:
    """Return the name of the best accepted candidate; "none" if there is none.

    The simplest correction or fit within `EQUAL_SHARE` of the best one is chosen, unless the error of a fine-tuned
    model or of its mean is lower by that share: fine-tuned models may diverge where the recording has no data. A fit
    gives way to its mean with a correction if that is about as good, for the same reason.
    """
    good = [trial for trial in trials if trial.good]
    fits = [trial for trial in good if trial.kind == "fit"]
    least = min((trial.error for trial in fits), default=0.0)
    simplest = [trial for trial in fits if trial.error <= (1.0 + EQUAL_SHARE) * least][:1]
    most = min(((1.0 - EQUAL_SHARE) * trial.error for trial in simplest), default=np.inf)
    tuned = [trial for trial in good if trial.kind in ("fine_tuned", "fine_tuned_mean") and trial.error <= most]
    best = min([*simplest, *tuned], key=lambda trial: trial.error, default=_NOTHING)
    means = [trial for trial in good if trial.kind == "fit_mean" and trial.other == best.name]
    safer = [trial for trial in means if trial.error <= (1.0 + EQUAL_SHARE) * best.error]
    return safer[0].name if safer else best.name


UNCHANGED_RATIO = 1.15, 1.45
"""Range of the largest `error_ratio` at which a model is left unchanged, see `unchanged_ratio`."""
MAX_ERROR_WINDOWS = 800
"""Largest number of windows per case; they overlap, so that more would add time but no information."""


def held_out_error(cases: Sequence[tuple[Dynamics, Dataset]]) -> Array | None:
    """Return the root mean square error (nx,) of simulations of one second, in the units of the states.

    ``cases`` are models of one family, each with its held-out data; the result is the median over the cases, since one
    fit that fails would make every other condition look unchanged. None if some data are too short.
    """
    errors = []
    for model, held in cases:
        try:
            windows = AdaptationWindows.of(model, held)
        except InvalidData:
            return None
        windows = windows[evenly_spaced(len(windows), MAX_ERROR_WINDOWS, nearest=True)]
        terms = CorrectionTerms.of(held)
        wrong = windows.errors(simulate_corrections(model, terms, np.zeros((1, *terms.shape)), windows))[0]
        errors.append(np.sqrt(np.mean((wrong * windows.scale) ** 2, axis=(0, 1))))
    return np.asarray(np.median(errors, axis=0))


def unchanged_ratio(intervals: int) -> float:
    """Return the largest `error_ratio` of an unchanged condition: 1 + 1 / sqrt(``intervals``), within its range.

    The fewer intervals are compared, the more the ratio varies by chance: 1.35 for 10 s, 1.19 for 30 s.
    """
    return float(np.clip(1.0 + 1.0 / np.sqrt(max(1, intervals)), *UNCHANGED_RATIO))


def error_ratio(errors: Array, scale: Array, baseline_error: Array) -> float:
    """Return the ratio of ``errors`` (B, H, nx), in units of ``scale`` (nx,), to ``baseline_error`` (nx,).

    It is that of the state with the largest ratio, because a slippery floor may affect only one of them. Raises
    `PluginError` unless ``baseline_error`` has a number for each state.
    """
    if np.shape(baseline_error) != scale.shape:
        raise PluginError(
            f"held_out_error_: expected a number for each of {len(scale)} states, got the shape "
            f"{np.shape(baseline_error)}; sysid_evo.models.adaptation.held_out_error measures it"
        )
    found = np.sqrt(np.mean(errors**2, axis=(0, 1))) * scale
    return float(np.max(found / np.maximum(baseline_error, 1e-12 * scale)))
