"""A comparison or a study in one call: plan, compute, gather, write the report."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, Unpack

from evaluation.cells.models import Fit, Predict
from evaluation.chosen_models import models_of
from evaluation.experiment import FILE, Experiment, Settings
from evaluation.planning import Comparison, check_experiment, plan_comparison
from evaluation.prediction.cases import PredictionProtocol, measured_cases
from evaluation.prediction.scores import ModelPrediction, Prediction
from evaluation.report.report import PrintedReport, save_report
from evaluation.report.study import save_study
from evaluation.results import ComparisonResults, DataSummary, Failure, ModelSummary
from evaluation.run_folder import CHOSEN, check_run_folder
from evaluation.study.planning import PlannedStudy, plan_study
from evaluation.study.results import StudyResults, gather_study, save_parquet
from evaluation.study.study import STUDY_FILE, Study
from evaluation.sufficiency import beats_mean, tells_apart
from evaluation.transfer.matrix import load_measured
from sysid_evo.data import Dataset
from sysid_evo.errors import IncompatibleSystem, InvalidArgument, InvalidData, MissingExtra
from sysid_evo.evolution.champion import load_champion, save_champion
from sysid_evo.models.adapters import model_texts
from sysid_evo.plan import Cell, Observer, Plan, Scheduler, Store, execute
from sysid_evo.plan.store import WAITING
from sysid_evo.progress import Progress, reporting
from sysid_evo.registry import load_plugin
from sysid_evo.version import versions


def compare(
    data: Dataset | str | Path | Iterable[str | Path] | None = None,
    *,
    out: str | Path | None = None,
    observer: Observer | None = None,
    jobs: int | None = None,
    scheduler: Scheduler | None = None,
    progress: Progress | bool | None = None,
    **settings: Unpack[Settings],
) -> ComparisonResults:
    """Fit models, evolve controllers in them, and compare both; return the results.

    ``data`` is a data set or the path of its logs; without it an emulated car is recorded. ``out`` is the run folder,
    in which results are stored and reused, and the report is written (default: a new ``runs/<time>``). Up to ``jobs``
    cells are computed in parallel, or as many as the workers of a ``scheduler`` have room for, see `execute`.
    ``progress`` is called with the state of the cells, True shows a bar. ``settings`` are those of `Experiment`.
    ``models`` may hold objects that an `Adapter` recognises, also in a dict by name::

        from evaluation import compare

        report = compare(
            "logs/",
            test=["last_drive"],
            models=["linear", "near2=nearest_neighbour(state_lags=2)", "parametrised"],
            ensembles=["near2+parametrised"],
            task="point_to_point(arena_radius=1.0)",
            seed=1,
            progress=True,
        )
        print(report)

    Raises the errors of `plan_comparison`, before any work.
    """
    folder = check_run_folder(out)
    dataset, given = data if isinstance(data, Dataset) else None, dict(settings)
    if data is not None and not isinstance(data, Dataset):
        listed = [data] if isinstance(data, (str, Path)) else list(data)
        odd = next((one for one in listed if not isinstance(one, (str, Path))), None)
        if odd is not None:
            raise InvalidArgument(
                f"data: expected a Dataset or paths of recordings, got {type(odd).__name__}: Dataset(system, runs), "
                "Dataset.from_arrays and Dataset.from_pandas make a Dataset"
            )
        given["data"] = tuple(str(Path(path).resolve()) for path in listed)
    models = settings.get("models")
    if models is not None and not isinstance(models, str):
        given["models"] = model_texts(models)
    experiment = Experiment.of({name: _storable(value) for name, value in given.items()})
    for plugin in experiment.plugins:
        load_plugin(plugin)
    comparison, _ = plan_run(experiment, folder, dataset)
    store = Store(folder)
    with _observed(observer, progress, "compare") as observer:

        def compute(plan: Plan) -> None:
            execute(plan, store, observer=observer, jobs=jobs, scheduler=scheduler)

        if experiment.chooses_families:
            comparison = with_further_families(comparison, store, compute, dataset)
        comparison.experiment.write(folder / FILE)
        compute(comparison.plan)
    return report_of(comparison, store)


FURTHER_FAMILIES = ("linear", "k_neighbours", "gaussian_process", "nonlinear_state_space", "auto")
"""Families that are tried where no default family predicts, those with the shortest fit first."""


def with_further_families(
    comparison: Comparison, store: Store, compute: Callable[[Plan], object], dataset: Dataset | None = None
) -> Comparison:
    """Return ``comparison`` with a further family, if none in which it evolves is better than predicting the mean.

    Fits and predictions of ``comparison`` are computed by ``compute``, then those of `FURTHER_FAMILIES` until one
    predicts; ``tried_models`` of its experiment names them. A model that only scored may be one. Nothing is added if
    the test data do not suffice for a decision, nor in rounds, which record and fit again. ``dataset`` is that of
    `plan_run`.
    """
    experiment = comparison.experiment
    if (experiment.rounds or 1) > 1:
        return comparison
    searched = tuple(comparison.fits) if experiment.searched is None else experiment.searched
    known = [comparison.fits[label].settings.spec.name for label in searched]
    further = [name for name in FURTHER_FAMILIES if name not in known]
    found, tried = comparison, list[str]()
    compute(_predictions_only(found))
    while further and _none_predicts(found, store, (*searched, *tried)):
        name = further.pop(0)
        system = store.outcome(found.data).value.training.system
        try:
            (spec,) = models_of(experiment.model_copy(update={"models": (name,)}), system, [])
        except (MissingExtra, IncompatibleSystem):
            continue
        fit = Fit(spec, found.data, experiment.seed, experiment.preset).cell()
        predict = Predict(name, spec.name, found.data, fit).cell()
        found = replace(found, fits={**found.fits, name: fit}, predictions={**found.predictions, name: predict})
        tried.append(name)
        compute(_predictions_only(found))
    if not tried:
        return comparison
    added = [] if _none_predicts(found, store, (*searched, *tried)) else tried[-1:]
    new = (name for name in added if name not in comparison.fits)
    update = {"models": (*(experiment.models or ()), *new), "tried_models": tuple(tried)}
    if experiment.searched is not None:
        update["searched"] = (*searched, *added)
    return plan_run(experiment.model_copy(update=update), store.path, dataset)[0]


def _predictions_only(comparison: Comparison) -> Plan:
    return Plan.of([comparison.data, *comparison.fits.values(), *comparison.predictions.values()])


def _none_predicts(comparison: Comparison, store: Store, labels: Collection[str]) -> bool:
    """Whether all models of these ``labels`` are known to be no better than the mean, at the headline's horizon."""
    prediction = None if store.outcome(comparison.data).value is None else _prediction(comparison, store)
    if prediction is None or not prediction.horizons:
        return False
    horizon = prediction.cases.main_horizon
    models = [model for model in prediction.ranking(horizon) if model.name in labels]
    return tells_apart(prediction, horizon) and not any(beats_mean(model.score(horizon)) for model in models)


def plan_run(
    experiment: Experiment, folder: Path, dataset: Dataset | None = None
) -> tuple[Comparison, tuple[str, ...]]:
    """Return the plan of a run folder, and remarks on recordings, plan and damaged files.

    Without a ``dataset`` the recordings named by the experiment are read.
    """
    check_experiment(experiment)
    if dataset is None and experiment.data is not None:
        dataset = Dataset.read(experiment.data, columns=experiment.columns)
    measured, damaged = load_measured(folder)
    if (folder / FILE).is_file():  # so that the plan of a run that was interrupted is the same
        times = {**Experiment.read(folder).get("step_seconds", {}), **experiment.step_seconds}
        experiment = experiment.model_copy(update={"step_seconds": times})
    comparison = plan_comparison(experiment, dataset=dataset, measured=measured)
    return comparison, (*(dataset.notes if dataset else ()), *comparison.plan.remarks, *damaged)


@contextmanager
def _observed(observer: Observer | None, progress: Progress | bool | None, title: str) -> Iterator[Observer | None]:
    """Yield the ``observer`` of an execution, or one that reports the number of finished cells to ``progress``."""
    if observer is not None and progress:
        raise InvalidArgument(f"{title}: expected progress or an observer, got both")
    with reporting(progress, title) as report:
        yield observer if report is None else _CellCounter(report)


class _CellCounter(Observer):
    """Reports to a `Progress` the number of finished cells of a plan, and the progress of the present one."""

    def __init__(self, report: Progress) -> None:
        self._report, self._done, self._cells = report, 0, 0

    def plan(self, cells: int, kept: int, seconds: float) -> None:
        self._cells = cells

    def progress(self, cell: Cell, done: int, total: int, note: str = "") -> None:
        self._report(self._done, self._cells, f"{cell.title} {done}/{total}")

    def finish(self, cell: Cell, *, cached: bool, reason: str | None) -> None:
        self._done += 1
        self._report(self._done, self._cells, cell.title)


def _storable(value: Any) -> Any:
    """Return lists as tuples and paths as text, so that the experiment can be stored."""
    if isinstance(value, (list, tuple)):
        return tuple(_storable(item) for item in value)
    return str(value) if isinstance(value, Path) else value


def report_of(comparison: Comparison, store: Store, *, afresh: bool = False) -> ComparisonResults:
    """Return the results in ``store``, and write their report into the run folder.

    A page that shows these results already is drawn again only if ``afresh``.
    """
    report = gather_results(comparison, store)
    results = [(cell.digest, None if record is None else (record.status, record.files))
               for cell in comparison.plan for record in [store.find(cell.digest)]]  # fmt: skip
    _copy_chosen(report, store)
    save_report(report, store.path, of=hashlib.sha256(json.dumps(results).encode()).hexdigest(), afresh=afresh)
    return report


def _copy_chosen(report: ComparisonResults, store: Store) -> None:
    """Copy the chosen controller to ``controllers/recommended``, and remove an earlier copy if none is chosen.

    A controller of the run with this name is not changed.
    """
    copy = store.path / "controllers" / CHOSEN
    if f"controllers/{CHOSEN}.json" in {name for record in store.records() for name in record.files}:
        return
    pick = None if report.transfer is None else report.transfer.pick
    file = None if pick is None else report.controllers.get(pick)
    if pick is not None and file is not None:
        save_champion(replace(load_champion(store.path / file), name=pick), copy)
    else:
        for suffix in (".json", ".safetensors"):
            copy.with_suffix(suffix).unlink(missing_ok=True)


def report_again(comparison: Comparison, store: Store, *, written: bool = True) -> ComparisonResults | None:
    """Write and return the report of a run with the cells measured since; None if the run has no model yet.

    With ``written`` False it is made from the stored results and no file is changed.
    """
    if not any(store.done(fit) for fit in comparison.fits.values()):
        return None
    if not written:
        return gather_results(comparison, store)
    for assess in (*comparison.predictions.values(), comparison.exploitability, comparison.advice):
        if assess is not None:
            tried = {cell.digest for cell in comparison.plan if store.outcome(cell).reason != WAITING}
            if all(needed.digest in tried for needed in assess.needs):
                execute(Plan.of([assess]), store, only=[assess])
    return report_of(comparison, store, afresh=True)


def gather_results(comparison: Comparison, store: Store) -> ComparisonResults:
    """Return the results of ``comparison`` in ``store``; cells that were not computed are listed as failures.

    Raises `InvalidData` if there are no data, or no model was fitted.
    """
    parts = store.outcome(comparison.data)
    if parts.value is None:
        raise InvalidData(f"{comparison.data.title}: {parts.reason}")
    training, test = parts.value.training, parts.value.test
    fitted = {label: store.outcome(fit) for label, fit in comparison.fits.items()}
    models = {label: outcome.value for label, outcome in fitted.items() if outcome.value is not None}
    if not models:
        reasons = "; ".join(f"{label}: {outcome.reason}" for label, outcome in fitted.items())
        raise InvalidData(f"no model could be fitted: {reasons}")
    matrix = None if comparison.matrix is None else comparison.matrix.of(store.outcome)
    found = None if comparison.exploitability is None else store.outcome(comparison.exploitability).value
    computed = store.last_computed(comparison.plan)
    learned = None if comparison.learned is None else store.outcome(comparison.learned).value
    rounds = None if comparison.last_round is None else store.outcome(comparison.last_round).value
    data = DataSummary.of(training, training if test is None else test)
    return PrintedReport(
        title=comparison.title,
        data=data,
        models=tuple(
            ModelSummary.of(label, model, family=comparison.fits[label].settings.spec.name, point=data.point)
            for label, model in models.items()
        ),
        prediction=_prediction(comparison, store),
        matrix=matrix,
        exploitability=() if found is None or matrix is None else found,
        advice=store.outcome(comparison.advice).value,
        failures=tuple(_failures(comparison, store)),
        settings=comparison.experiment.model_dump(mode="json", exclude_none=True),
        versions=versions(),
        controllers=_controllers(comparison, store),
        conditions={
            label: outcome.value
            for label, cell in comparison.conditions.items()
            if (outcome := store.outcome(cell)).value is not None
        },
        task_notes=() if learned is None else learned.sentences,
        task_warning="" if learned is None else learned.warning,
        rounds=None if rounds is None else rounds.summary,
        timings={cell.title: store.outcome(cell).seconds for cell in comparison.plan},
        day=None if computed is None else computed.date(),
    )


def _controllers(comparison: Comparison, store: Store) -> dict[str, str]:
    """Return the path of the file of each controller, relative to the run folder."""
    if comparison.matrix is None:
        return {}
    return {
        cell.name: f"{store.result_path(cell).relative_to(store.path).as_posix()}.json"
        for cell in comparison.matrix.controllers
        if store.find(cell.digest) is not None
    }


def _prediction(comparison: Comparison, store: Store) -> Prediction | None:
    """Return the prediction errors of all models; failed ones have a reason."""
    if not comparison.predictions:
        return None
    parts = store.outcome(comparison.data).value
    rows = []
    for label, cell in comparison.predictions.items():
        outcome = store.outcome(cell)
        if outcome.value is not None:
            rows.append(outcome.value)
        elif label not in comparison.fits or store.outcome(comparison.fits[label]).value is not None:
            rows.append(ModelPrediction(label, cell.settings.family, reason=outcome.reason or ""))
    return Prediction(measured_cases(parts.training, parts.test, PredictionProtocol()), tuple(rows))


def _failures(comparison: Comparison, store: Store) -> list[Failure]:
    """Return the cells that failed themselves, without those that only needed one of them.

    Failures of runs and predictions are listed in the matrix and the prediction.
    """
    found = []
    for cell in comparison.plan:
        record = store.find(cell.digest)
        could = all(store.outcome(needed).value is not None for needed in cell.needs) if record is None else True
        failed = could if record is None else record.status == "failed"
        if failed and cell.kind not in ("run", "predict"):
            found.append(Failure(cell.title, store.outcome(cell).reason or ""))
    return found


def run_study(
    study: Study | str | Path | Mapping[str, Any],
    *,
    out: str | Path | None = None,
    observer: Observer | None = None,
    jobs: int | None = None,
    scheduler: Scheduler | None = None,
    progress: Progress | bool | None = None,
) -> StudyResults:
    """Compute the missing cells of a study and return its results, which are also written into the folder ``out``.

    ``study`` is a `Study`, its file, or its settings. ``out`` is ``runs/<name of the file>`` if it is left out.
    Up to ``jobs`` cells are computed in parallel, or as many as the workers of a ``scheduler`` have room for.
    ``progress`` is called with the state of the cells, True shows a bar::

        from evaluation import run_study

        found = run_study({
            "title": "Two families on two cars",
            "experiment": {"models": ["linear", "nearest_neighbour"], "minutes": 1.0, "generations": 20},
            "grid": {"robot": ["emulated_car", "emulated_car(seed=1)"], "seed": "0..1"},
        }, out="runs/two_families")
        print([(row.point, row.controller, row.achieved) for row in found.controllers])

    Raises the errors of `plan_study`, before any work.
    """
    found = study if isinstance(study, Study) else Study.of(study) if isinstance(study, Mapping) else Study.read(study)
    if out is None and not isinstance(study, (str, Path)):
        raise InvalidArgument("out: expected a folder for a study that is not in a file")
    folder = study_folder(out, Path(str(study)))
    planned = plan_study(found)
    planned.study.write(folder / STUDY_FILE)
    with _observed(observer, progress, "study") as observer:
        execute(planned.plan, Store(folder), observer=observer, jobs=jobs, scheduler=scheduler)
    return write_study(planned, folder)


def study_folder(out: str | Path | None, file: Path) -> Path:
    """Return ``out``, else ``runs/<name of the file>``, if it is new, empty or a run. Raises `InvalidArgument`."""
    return check_run_folder(Path("runs") / file.stem if out is None else out)


def write_study(planned: PlannedStudy, folder: Path) -> StudyResults:
    """Return the results in ``folder``, and write tables, document and page there."""
    results = gather_study(planned, folder)
    save_parquet(results, folder)
    save_study(results, folder)
    return results
