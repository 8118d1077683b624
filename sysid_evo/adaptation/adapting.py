"""A model and some seconds of a new condition become a correction, or a refit, or nothing, as a gate decides."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sysid_evo.adaptation.gate import NONE, Block, Held, Trial, Verdict, blocks_of, decided, judged
from sysid_evo.adaptation.learning import corrections
from sysid_evo.adaptation.pieces import Pieces, error_of, free_runs, off
from sysid_evo.adaptation.terms import Terms
from sysid_evo.arrays import Array
from sysid_evo.data import Dataset
from sysid_evo.dynamics.model import DynamicsModel
from sysid_evo.errors import SysidEvoError
from sysid_evo.progress import Counter, Progress

KINDS = ("linear", "gains", "products")
"""What a correction may be linear in, the simplest first."""
RIDGES = (3.0, 0.3, 0.03, 0.003)
"""The strongest first, which leaves the simplest correction."""
ANEW = "fit anew"
REFIT = "refit"
"""What a fit of the family to the new seconds alone is called, and one to the training data as well."""


@dataclass(frozen=True)
class Adaptation:
    """What was learned: the model to correct (a refitted one, if that was chosen), the correction, and why."""

    model: DynamicsModel
    terms: Terms
    coefficients: Array
    verdict: Verdict


def adaptation(
    model: DynamicsModel,
    dataset: Dataset,
    *,
    training: Dataset | None = None,
    rng: np.random.Generator,
    progress: Progress | None = None,
) -> Adaptation:
    """Learn what ``model`` lacks in ``dataset``; with the ``training`` data, a refit with both is tried as well.

    A fit of its family to ``dataset`` alone is tried too, unless that is one that fits others.

    Corrections linear in (state, control, 1), with what the model itself predicts and with products too, each with
    several ridges, are learned by free runs on two of three blocks of time and run freely over the third. What is best
    is learned again from everything, if it is good enough (`decided`); otherwise the model stays as it is. Raises
    `InvalidData` if no window fits.
    """
    pieces, seconds = Pieces.of(model, dataset, model.envelope), moving_seconds(dataset)
    blocks = blocks_of(pieces.first, pieces.horizon)
    fits: dict[str, Dataset | None] = {} if model.uses() else {ANEW: None}
    fits |= {} if training is None else {REFIT: training}
    counter = Counter(progress, 1 + len(blocks) * (len(KINDS) * len(RIDGES) + len(fits)))
    held = [pieces[block.held(pieces.first)] for block in blocks]
    plain = [_run(model, Terms.of(dataset), None, part) for part in held]
    trials: list[Trial] = []
    for kind in KINDS if blocks else ():
        errors: dict[float, list[Held]] = {ridge: [] for ridge in RIDGES}
        for block, part in zip(blocks, held, strict=True):
            terms = _terms(kind, model, block.rest(dataset))
            learned = pieces[block.learned(pieces.first)]
            share = len(learned) / len(pieces)
            found = corrections(model, terms, learned, RIDGES, share * seconds)
            for ridge, coefficients in zip(RIDGES, found, strict=True):
                errors[ridge].append(_run(model, terms, coefficients, part))
                counter.advance()
        trials += [judged(_name(kind, ridge), plain, each) for ridge, each in errors.items()]
    for name, old in fits.items() if blocks else ():
        shown = _refits(model, old, dataset, blocks, rng, counter.advance)
        if shown is not None:
            trials.append(judged(name, plain, shown))
    error = error_of(np.concatenate([part.errors for part in plain])) if plain else float("nan")
    verdict = Verdict(seconds, len(blocks), error, tuple(trials), decided(trials))
    if verdict.chosen in fits:
        again, terms = refitted(model, fits[verdict.chosen], dataset, rng), Terms.of(dataset)
        return Adaptation(again, terms, np.zeros(terms.shape), verdict)
    return _learned(model, dataset, pieces, verdict)


def moving_seconds(dataset: Dataset) -> float:
    """Return how long ``dataset`` is in motion, in s."""
    return dataset.system.dt * sum(int(rows[:-1].sum()) for rows in dataset.moving)


def refitted(model: DynamicsModel, training: Dataset | None, new: Dataset, rng: np.random.Generator) -> DynamicsModel:
    """Return the family of ``model`` fitted to ``new`` and ``training``, if that is given.

    ``new`` is repeated until it counts as much. Raises what the family raises where that is too short for it.
    """
    if training is None:
        return model.unfitted().fit(new, rng=rng)
    copies = max(1, round(training.n_steps / new.n_steps))
    again = [replace(e, name=f"new {copy} {e.name}") for copy in range(copies) for e in new]
    return model.unfitted().fit(training.with_episodes([*training, *again]), rng=rng)


def _learned(model: DynamicsModel, dataset: Dataset, pieces: Pieces, verdict: Verdict) -> Adaptation:
    """Return the correction that ``verdict`` chose, learned from everything."""
    terms = Terms.of(dataset)
    for kind in KINDS:
        for number, ridge in enumerate(RIDGES):
            if verdict.chosen == _name(kind, ridge):
                terms = _terms(kind, model, dataset)
                path = corrections(model, terms, pieces, RIDGES[: number + 1], verdict.seconds)
                return Adaptation(model, terms, list(path)[-1], verdict)
    return Adaptation(model, terms, np.zeros(terms.shape), replace(verdict, chosen=NONE))


def _refits(
    model: DynamicsModel,
    training: Dataset | None,
    dataset: Dataset,
    blocks: Sequence[Block],
    rng: np.random.Generator,
    told: Callable[[], None],
) -> list[Held] | None:
    """Return what each block shows of a refit with the rest, whose lags may be others; None if that is too short."""
    errors = []
    for block in blocks:
        try:
            again = refitted(model, training, block.rest(dataset), rng)
            pieces = Pieces.of(again, dataset, again.envelope, stride=1)
        except (SysidEvoError, ValueError):
            return None
        errors.append(_run(again, Terms.of(dataset), None, pieces[block.held(pieces.first)]))
        told()
    return errors


def _run(model: DynamicsModel, terms: Terms, coefficients: Array | None, pieces: Pieces) -> Held:
    """Return the errors of the free runs over ``pieces``."""
    candidate = np.zeros(terms.shape) if coefficients is None else coefficients
    errors = off(terms, free_runs(model, terms, candidate[None], pieces), pieces)[0]
    return Held(errors, (pieces.first * terms.system.dt).astype(np.int64))


def _terms(kind: str, model: DynamicsModel, dataset: Dataset) -> Terms:
    return Terms.of(dataset, products=kind == "products", model=None if kind == "linear" else model)


def _name(kind: str, ridge: float) -> str:
    return f"{kind}, ridge {ridge:g}"
