"""Search of a family's hyper-parameters by simulation error on held-out data."""

from __future__ import annotations

import hashlib
import json
import time
import types
import typing
import warnings
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Union

import numpy as np

from sysid_evo.data.dataset import Dataset
from sysid_evo.errors import InvalidArgument, described
from sysid_evo.extras import check_installed
from sysid_evo.models.parameters import OneOf, SearchRange, Within, check_names, limits_of
from sysid_evo.processors import engine_inputs
from sysid_evo.progress import Progress, reporting
from sysid_evo.registry.grammar import Spec
from sysid_evo.registry.registry import models
from sysid_evo.validation.folds import make_folds
from sysid_evo.validation.simulation_error import FEWEST_STEPS, SECOND, HeldOutTest, Scorer, history_of, horizons_of

if TYPE_CHECKING:
    import optuna


WORST = 1e6
"""Error of a simulation that is not finite."""
PARTS = 1000
"""Number of parts in which a budget of time is reported."""


@dataclass(frozen=True)
class TuningTrial:
    """One trial: the complete spec, its error (None if it failed or was stopped early), and the reason."""

    spec: Spec
    error: float | None
    seconds: float
    reason: str = ""


class Tuning:
    """A search for the parameters of the family in ``spec``; parameters given there are fixed.

    The error of a trial is that of simulations after ``horizons`` steps (default: one second) on held-out data, in
    ``folds`` folds of whole recordings (blocks of time for a single one): RMSE / standard deviation, averaged over
    states and horizons. The first trial has the family's defaults, as far as they are in the `search_space`; the others
    are proposed by a tree of Parzen estimators (Bergstra et al. 2011). A trial that is worse than the median of the
    others after a fold is stopped. All trials use the same random numbers.

    With a ``file`` every trial is stored there, and a search with the same family, data, horizons and seed resumes.
    """

    def __init__(
        self,
        spec: str | Spec,
        dataset: Dataset,
        *,
        horizons: Sequence[int] | None = None,
        folds: int = 3,
        parameters: Sequence[str] | None = None,
        seed: int = 0,
        file: str | Path | None = None,
    ) -> None:
        check_installed("tuning", ["optuna"])
        self.spec, self.dataset, self.seed = models.check(spec), dataset, seed
        lacking = models.missing_package(self.spec.name)
        if lacking is not None:
            raise lacking
        models.make(self.spec).check_system(dataset.system)
        self.space = search_space(self.spec.name, fixed=self.spec.parameters, parameters=parameters)
        second = max(FEWEST_STEPS, round(SECOND / dataset.system.dt))
        pairs = make_folds(dataset, folds)
        self.horizons = tuple(horizons_of(pairs, list(horizons or [second])))
        if horizons and set(horizons) - {*self.horizons}:
            raise InvalidArgument(
                f"horizons: expected steps that fit into the held-out data, at most {max(self.horizons)}, got "
                f"{', '.join(map(str, horizons))}"
            )
        self.pairs = pairs
        history = history_of(pairs, self.horizons)
        self.scorer = Scorer.of(dataset, [HeldOutTest.of(held, self.horizons, history) for _, held in pairs])
        self.file = None if file is None else Path(file)
        self.seeds = np.random.default_rng(seed).integers(2**32, size=len(pairs)).tolist()

    @property
    def identity(self) -> str:
        """Identity of the search: one with the same identity resumes it."""
        parts = [
            str(self.spec),
            self.dataset.fingerprint,
            self.horizons,
            len(self.pairs),
            sorted(self.space),
            self.seed,
            *engine_inputs().items(),
        ]
        return f"{self.spec.name}-{hashlib.sha256(json.dumps(parts).encode()).hexdigest()[:12]}"

    @cached_property
    def study(self) -> optuna.Study:
        """The trials so far, including those in the file."""
        import optuna
        from optuna.storages import JournalStorage
        from optuna.storages.journal import JournalFileBackend

        optuna.logging.set_verbosity(optuna.logging.ERROR)
        storage = None
        if self.file is not None:
            self.file.parent.mkdir(parents=True, exist_ok=True)
            storage = JournalStorage(JournalFileBackend(str(self.file)))
        study = optuna.create_study(
            storage=storage,
            study_name=self.identity,
            load_if_exists=True,
            pruner=optuna.pruners.MedianPruner(n_startup_trials=5),
        )
        done = len(study.trials)
        study.sampler = optuna.samplers.TPESampler(seed=(self.seed + 7919 * done) % 2**32, n_startup_trials=8)
        if not done:
            study.enqueue_trial(self._defaults())
        return study

    def run(
        self, *, seconds: float | None = None, trials: int | None = None, progress: Progress | None = None
    ) -> Iterator[TuningTrial]:
        """Yield trials until ``seconds`` are over or there are ``trials`` of them, including earlier ones.

        A trial that has begun is completed. Ctrl-C, or an exception, loses the present trial only.
        """
        import optuna

        if seconds is None and trials is None:
            raise InvalidArgument("tune: expected seconds or a number of trials")
        began = time.monotonic()
        while True:
            share = 0.0 if seconds is None else (time.monotonic() - began) / seconds
            count = len(self.trials)
            share = max(share, 0.0 if trials is None else count / trials)
            if progress is not None:
                progress(min(PARTS, int(PARTS * share)), PARTS, self._note)
            if share >= 1.0:
                return
            trial = self.study.ask({key: self._distribution(key, where) for key, where in self.space.items()})
            started = time.monotonic()
            try:
                error, reason = self._error(trial)
            except BaseException:  # Ctrl-C too: this trial does not count
                self.study.tell(trial, state=optuna.trial.TrialState.FAIL)
                raise
            trial.set_user_attr("seconds", round(time.monotonic() - started, 2))
            trial.set_user_attr("reason", reason)
            state = optuna.trial.TrialState.COMPLETE
            if error is None:
                state = optuna.trial.TrialState.FAIL if reason else optuna.trial.TrialState.PRUNED
            self.study.tell(trial, error, state=state)
            yield self._trial_of(self.study.trials[trial.number])

    @property
    def trials(self) -> list[TuningTrial]:
        """All completed trials, the best first."""
        ended = [self._trial_of(trial) for trial in self.study.trials if "seconds" in trial.user_attrs]
        return sorted(ended, key=lambda one: np.inf if one.error is None else one.error)

    @property
    def best(self) -> TuningTrial:
        """The best trial. Raises `InvalidArgument` if none was completed."""
        found = [one for one in self.trials if one.error is not None]
        if not found:
            reasons = "; ".join(dict.fromkeys(one.reason for one in self.trials if one.reason)) or "there was no time"
            raise InvalidArgument(f"tune: no trial of {self.spec} was completed: {reasons}")
        return found[0]

    @property
    def importance(self) -> dict[str, float]:
        """Importance of each parameter for the error, as shares of 1, the largest first; empty with too few trials."""
        import optuna

        if sum(one.error is not None for one in self.trials) < 4:
            return {}
        evaluator = optuna.importance.FanovaImportanceEvaluator(seed=self.seed)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # hides that a method is experimental
            try:
                found = optuna.importance.get_param_importances(self.study, evaluator=evaluator)
            except (RuntimeError, ValueError):  # all errors are the same
                return {}
        return {key: float(share) for key, share in found.items()}

    @property
    def _note(self) -> str:
        found = [one for one in self.trials if one.error is not None]
        return f"{len(self.trials)} trials, best error {found[0].error:.3f}" if found else ""

    def _error(self, trial: optuna.Trial) -> tuple[float | None, str]:
        """Return the error of a trial; None with the reason if it fails, without one if it is stopped early."""
        parameters = self._parameters(trial.params)
        runs = []
        for fold, ((training, _), test) in enumerate(zip(self.pairs, self.scorer.trials, strict=True)):
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")  # warnings of one trial among many
                    model: Any = models.make(self.spec.name, **parameters)
                    model.fit(training, rng=np.random.default_rng(self.seeds[fold]))
                    runs.append(test.run(model))
            except Exception as error:  # a plugin may fail in any way; the other trials continue
                return None, described(error).splitlines()[0]
            part = Scorer(self.scorer.system, self.scorer.trials[: fold + 1], self.scorer.spread)
            found = min(part.errors(runs).mean, WORST)
            trial.report(found, fold)
            if fold + 1 < len(self.pairs) and trial.number > 0 and trial.should_prune():
                return None, ""
        return found, ""

    def _parameters(self, proposed: Mapping[str, Any]) -> dict[str, Any]:
        """Return all parameters of the model: the fixed ones, and those that a trial proposes."""
        chosen = {
            key: json.loads(value) if isinstance(value, str) else _short(value) for key, value in proposed.items()
        }
        return {**self.spec.parameters, **chosen}

    def _trial_of(self, trial: optuna.trial.FrozenTrial) -> TuningTrial:
        spec = Spec(self.spec.name, self._parameters(trial.params))
        reason = str(trial.user_attrs.get("reason", ""))
        complete = trial.state.name == "COMPLETE"
        return TuningTrial(
            spec,
            trial.value if complete else None,
            float(trial.user_attrs["seconds"]),
            reason or ("" if complete else "stopped early"),
        )

    def _distribution(self, key: str, where: SearchRange) -> Any:
        from optuna.distributions import CategoricalDistribution, FloatDistribution, IntDistribution

        if isinstance(where, OneOf):
            return CategoricalDistribution([json.dumps(value) for value in where.values])
        if whole(self.spec.name, key):
            return IntDistribution(int(np.ceil(where.low)), int(where.high), log=where.log)
        return FloatDistribution(where.low, where.high, log=where.log)

    def _defaults(self) -> dict[str, Any]:
        """Return the defaults of the family that are in the search space."""
        found: dict[str, Any] = {}
        for key, default in models.parameters(self.spec.name).items():
            where = None if key is None else self.space.get(key)
            if key is None or where is None:
                continue
            if isinstance(where, OneOf):
                found |= {key: json.dumps(default)} if default in where.values else {}
            elif isinstance(default, (int, float)) and where.low <= default <= where.high:
                found[key] = default
        return found


def tune(
    spec: str | Spec,
    dataset: Dataset,
    *,
    seconds: float | None = None,
    trials: int | None = None,
    progress: Progress | bool | None = None,
    **settings: Any,
) -> Tuning:
    """Return a search of the parameters of a family over ``seconds`` or ``trials``; see `Tuning` for ``settings``.

    ``tune(...).best.spec`` is the best spec, ready for `make_model`.
    """
    found = Tuning(spec, dataset, **settings)
    with reporting(progress, f"tune {found.spec.name}") as report:
        for _ in found.run(seconds=seconds, trials=trials, progress=report):
            pass
    return found


NOT_SEARCHED = frozenset(
    {"fitted", "stochastic", "dead_band", "max_steps", "folds", "lag_search", "state_lags", "control_lags"}
)
"""Parameters that hardly affect the error, or that have their own ranges."""
LAGS = {"state_lags": Within(0, 2), "control_lags": Within(0, 6)}
FACTOR = 8.0
"""Positive numbers are searched from default / FACTOR to default * FACTOR."""
SMALLEST, LARGEST = 1e-6, 1.0
"""Search range of numbers whose default is 0."""


def search_space(
    name: str, *, fixed: Collection[str] = (), parameters: Collection[str] | None = None
) -> dict[str, SearchRange]:
    """Return the search range of each parameter of the registered family ``name``, except for ``fixed`` ones.

    Ranges in ``search_ranges`` of the family have priority. Otherwise lags are searched from 0 to 2 earlier states and
    6 earlier controls, positive numbers within a factor of 8 of the default and within their limits, and all options of
    a `Literal` or bool. Names, lists, numbers without a default, and parameters that a preset changes, because they
    determine the time of a fit, are left out. ``parameters`` names those to search. Raises `InvalidArgument` if nothing
    remains.
    """
    family: Any = models.get(name)
    check_names(family, parameters or ())
    found: dict[str, SearchRange] = dict(declared(family))
    annotations, limits = typing.get_type_hints(family.__init__), limits_of(family)
    budgets = {key for preset in family.presets.values() for key in preset}
    for key, default in models.parameters(name).items():
        if key is None or key in found:
            continue
        if key in LAGS:
            found[key] = LAGS[key]
        elif key not in NOT_SEARCHED and (key not in budgets or key in (parameters or ())):
            derived = _derived(annotations.get(key, Any), default, limits.get(key))
            found |= {} if derived is None else {key: derived}
    chosen = {key: one for key, one in found.items() if key not in fixed and (parameters is None or key in parameters)}
    if not chosen:
        wanted = "" if parameters is None else f" among {', '.join(parameters)}"
        raise InvalidArgument(
            f"model {name!r} has no parameter to search{wanted}; it declares some in ``search_ranges``"
        )
    return chosen


def declared(family: type) -> Mapping[str, SearchRange]:
    """Return the ``search_ranges`` of a class and its bases; those of a subclass replace those of its base."""
    merged: dict[str, SearchRange] = {}
    for base in reversed(family.__mro__):
        merged.update(base.__dict__.get("search_ranges", {}))
    return merged


def _derived(kind: Any, default: Any, limit: Any) -> SearchRange | None:
    """Return the search range of a parameter with this type, default and `Limit`, or None if it has no obvious one."""
    options = [one for one in _options(kind) if one is not types.NoneType]
    if typing.get_origin(kind) is Literal:
        return OneOf(typing.get_args(kind))
    if options == [bool]:
        return OneOf((False, True))
    if not options or not {*options} <= {int, float} or isinstance(default, bool) or default is None:
        return None
    low, high = (-np.inf, np.inf) if limit is None else (limit.low, limit.high)
    if default > 0:
        return Within(max(low, default / FACTOR), min(high, default * FACTOR), log=True)
    return Within(max(low, SMALLEST), min(high, LARGEST), log=True) if default == 0 and float in options else None


def _options(kind: Any) -> tuple[Any, ...]:
    """Return the types of a union, or the one type."""
    return typing.get_args(kind) if typing.get_origin(kind) in (Union, types.UnionType) else (kind,)


def whole(name: str, key: str) -> bool:
    """Whether the parameter ``key`` of a family is a whole number."""
    family: Any = models.get(name)
    options = _options(typing.get_type_hints(family.__init__).get(key, Any))
    return int in options and float not in options


def _short(value: Any) -> Any:
    """Return a number rounded to four digits, as it is stored and used."""
    return float(f"{value:.4g}") if isinstance(value, float) else value
