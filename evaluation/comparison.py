"""The main job: fit families, evolve controllers, and compare both, in the cells of a run folder."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

from evaluation.exploitability import assess_exploitability
from evaluation.prediction import assess_prediction
from evaluation.report import DataSummary, Failure, ModelSummary, Report
from evaluation.transfer import NOT_RUN, Cell, TransferMatrix, load_measured, transfer_seeds, with_measured
from evaluation.transfer import run_cell as run_on
from sysid_evo.arrays import Seeds
from sysid_evo.data import Dataset
from sysid_evo.engine import DynamicsRunner, Runner
from sysid_evo.errors import ArtefactError, InvalidArgument, InvalidData
from sysid_evo.evolution import Champion, ControllerEvolution
from sysid_evo.experiment import Observer, Outcome, evolve_champions, fit_models, run_cell
from sysid_evo.files import write_atomically
from sysid_evo.progress import Progress
from sysid_evo.store import RunFolder, versions


@dataclass(frozen=True)
class ComparisonSettings:
    """What is compared.

    Every model is an ensemble of one; ``ensembles`` lists the members of further ones. Each cell of
    the matrix has ``transfer_trials`` fresh trials, of which ``traces`` are kept for the plots and
    for the exploitability section. Without ``controllers`` only prediction is compared. With
    ``yardstick`` a controller is also evolved on the emulated robot itself, by its name: what can be
    achieved there at all.
    """

    models: tuple[str, ...]
    ensembles: tuple[tuple[str, ...], ...] = ()
    preset: str = "quick"
    seed: int = 0
    evolution: ControllerEvolution = field(default_factory=ControllerEvolution)
    transfer_trials: int = 100
    traces: int = 10
    controllers: bool = True
    yardstick: bool = False

    def __post_init__(self) -> None:
        if not self.models:
            raise InvalidArgument("compare: expected at least one model family, got none")
        unknown = sorted({member for ensemble in self.ensembles for member in ensemble} - set(self.models))
        if unknown:
            raise InvalidArgument(
                f"compare: an ensemble names {', '.join(unknown)}, but the models are {', '.join(self.models)}"
            )
        if self.yardstick and not self.controllers:
            raise InvalidArgument("compare: a yardstick is a controller, but only prediction is to be compared")

    @property
    def all_ensembles(self) -> tuple[tuple[str, ...], ...]:
        """Every model alone, then the ensembles."""
        singles = tuple((model,) for model in self.models)
        return singles + tuple(ensemble for ensemble in self.ensembles if ensemble not in singles)

    def to_dict(self) -> dict[str, Any]:
        """Return the settings as they stand in ``experiment.toml``."""
        return asdict(self)

    @classmethod
    def from_dict(cls, value: Mapping[str, Any]) -> ComparisonSettings:
        """Undo `to_dict`; other keys are left out. Raises `ArtefactError`."""
        known = {item.name: value[item.name] for item in fields(cls) if item.name in value}
        try:
            known["models"] = tuple(known["models"])
            known["ensembles"] = tuple(tuple(members) for members in known["ensembles"])
            known["evolution"] = ControllerEvolution(**known["evolution"])
            return cls(**known)
        except (KeyError, TypeError) as error:
            raise ArtefactError(f"these are not the settings of a comparison: {error}") from error


def compare(
    run: RunFolder,
    training: Dataset,
    test: Dataset,
    settings: ComparisonSettings,
    *,
    observer: Observer,
    robot: tuple[str, Runner] | None = None,
    title: str = "",
) -> Report:
    """Fit, evolve, transfer and assess; what ``run`` has done already is read from it.

    ``robot`` names the last column of the transfer matrix and says how controllers are run on it. A
    cell that fails is a row with its reason. Cells that were measured since the run was made stand in the
    matrix too, see `evaluation.transfer.save_measured`. Raises `InvalidData` if no model at all could be fitted,
    `InvalidArgument` if there is no robot to evolve the yardstick on.
    """
    if settings.yardstick and robot is None:
        raise InvalidArgument("compare: a yardstick is evolved on an emulated robot, but none is given")
    fits = fit_models(run, settings.models, training, seed=settings.seed, preset=settings.preset, observer=observer)
    models = {name: outcome.value for name, outcome in fits.items() if outcome.value is not None}
    if not models:
        reasons = "; ".join(f"{name}: {outcome.reason}" for name, outcome in fits.items())
        raise InvalidData(f"no model could be fitted: {reasons}")
    families = {name: name for name in models}
    outcomes: dict[str, Outcome[Any]] = {f"fit {name}": outcome for name, outcome in fits.items()}

    predicted = run_cell(
        run,
        "prediction",
        load=None,
        work=lambda progress: assess_prediction(models, training, test, families=families, progress=progress),
        save=lambda _: None,
        observer=observer,
    )
    outcomes["prediction"] = predicted
    matrix = None
    if settings.controllers:
        runners: dict[str, Runner] = {name: DynamicsRunner(model) for name, model in models.items()}
        columns = {**runners, robot[0]: robot[1]} if robot is not None else runners
        yardstick = ((robot[0],),) if robot is not None and settings.yardstick else ()
        champions = evolve_champions(
            run,
            settings.all_ensembles + yardstick,
            columns,
            training.system,
            settings.evolution,
            seed=settings.seed,
            observer=observer,
        )
        outcomes.update({f"evolve {name}": outcome for name, outcome in champions.items()})
        evolved = [outcome.value for outcome in champions.values() if outcome.value is not None]
        matrix = _transfer(run, evolved, columns, settings, observer, robot[0] if robot else None, families, outcomes)
    matrix = with_measured(matrix, load_measured(run))
    failures = [Failure(cell, outcome.reason) for cell, outcome in outcomes.items() if outcome.reason]
    return Report(
        title=title,
        data=DataSummary.of(training, test),
        models=tuple(ModelSummary.of(name, model, family=name) for name, model in models.items()),
        prediction=predicted.value,
        matrix=matrix,
        exploitability=assess_exploitability(matrix, training, test) if matrix is not None else (),
        failures=tuple(failures),
        settings=settings.to_dict(),
        versions=versions(),
        timings={cell: outcome.seconds for cell, outcome in outcomes.items()},
    )


def _transfer(
    run: RunFolder,
    champions: list[Champion],
    columns: Mapping[str, Runner],
    settings: ComparisonSettings,
    observer: Observer,
    robot: str | None,
    families: Mapping[str, str],
    outcomes: dict[str, Outcome[Any]],
) -> TransferMatrix:
    seeds = transfer_seeds(settings.seed, settings.transfer_trials)
    cells: list[Cell] = []
    for champion in champions:
        for column, runner in columns.items():
            traces = settings.traces if column == robot or column in champion.against else 0
            name = f"run {champion.name} on {column}"
            outcome = _run(run, name, champion, column, runner, seeds, traces, observer)
            if outcome.value is not None:
                cells.append(outcome.value)
            else:
                cells.append(Cell(champion.name, column, reason=outcome.reason or NOT_RUN))
            outcomes[name] = Outcome(outcome.value, None, outcome.seconds)
    return TransferMatrix.of(champions, tuple(columns), cells, families=families, robot=robot)


def _run(
    run: RunFolder,
    name: str,
    champion: Champion,
    column: str,
    runner: Runner,
    seeds: Seeds,
    traces: int,
    observer: Observer,
) -> Outcome[Cell]:
    path = run.path / "results" / f"{champion.name}@{column}.json".replace(":", "-")

    def work(_: Progress) -> Cell:
        cell = run_on(champion, column, runner, seeds, traces=traces)
        if cell.failed:
            raise InvalidData(cell.reason)
        return cell

    return run_cell(
        run, name, load=lambda: _load(path), work=work, save=lambda cell: _save(cell, path), observer=observer
    )


def _save(cell: Cell, path: Path) -> None:
    text = json.dumps(cell.to_dict(), allow_nan=False)
    write_atomically(path, lambda file: file.write_text(text))


def _load(path: Path) -> Cell:
    try:
        return Cell.from_dict(json.loads(path.read_text()))
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ArtefactError(f"{path}: not a stored cell of the transfer matrix: {error}") from error
