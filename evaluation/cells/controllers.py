"""Cells whose result is a controller: evolved, chosen, polished or a baseline, and their order in a procedure."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, TypeAlias

from evaluation.cells.learned_task import LearnTask, learned_task, needed, with_learned_task
from evaluation.cells.models import file_digests, files_of, named_files
from evaluation.cells.plants import (
    ACCURATE,
    Plant,
    accurate_plants,
    fitted,
    labels_of,
    prediction_error,
    runners,
    steps_in,
)
from evaluation.cells.slow_models import limited
from evaluation.experiment import DEFAULT_TASK, NONE, Experiment
from evaluation.transfer.forecast import FORECAST_RULE, forecast_judgement
from sysid_evo.artefacts import CheckpointFile
from sysid_evo.errors import Blocked
from sysid_evo.evolution import Champion, ControllerEvolution, choose, evolve_controller, polish
from sysid_evo.evolution.champion import load_champion, save_champion
from sysid_evo.evolution.halving import Start
from sysid_evo.plan import CELL_KINDS, Cell, CellContext, CellKind, CellSettings, ResultType, blocked_reason, cell_seed
from sysid_evo.registry import Spec, aggregates, controllers, make_robot, strategies, tasks
from sysid_evo.registry.registry import noises
from sysid_evo.rigid_body import RigidBody
from sysid_evo.system import System

POLISHED = "polished"
"""Name of the controller that is polished on all models. The forecast decides which controller is recommended."""


def ensemble_name(members: tuple[str, ...], aggregate: str = "min") -> str:
    """Return the name of an ensemble and its champion: ``a+b``, or ``mean(a+b)`` for another aggregate."""
    name = "+".join(members)
    return name if aggregate == "min" or len(members) == 1 else f"{aggregate}({name})"


def identity_of(settings: ControllerEvolution) -> dict[str, Any]:
    """Return the settings of an evolution and the conditions of its trials, as strict JSON."""
    starts = [[controllers.identity(one.controller), strategies.identity(one.strategy)] for one in settings.starts]
    return {
        **({"starts": starts} if starts else {}),
        "controller": controllers.identity(settings.controller),
        "task": tasks.identity(settings.task),
        "strategy": strategies.identity(settings.strategy),
        "generations": settings.generations,
        "aggregate": aggregates.identity(settings.aggregate),
        "trials": settings.trials,
        "selection_trials": settings.selection_trials,
        "estimator_delay": settings.estimator_delay,
        "noise": noises.identity(settings.noise) if settings.noise else None,
    }


@dataclass(frozen=True)
class Evolve(CellSettings):
    """Evolution of one controller against all of ``members`` at once."""

    members: tuple[Plant, ...]
    evolution: ControllerEvolution
    seed: int
    learned: Cell[LearnTask] | None = None

    def cell(self) -> Cell[Evolve]:
        evolution = self.evolution
        rollouts = evolution.repeats * evolution.generations * evolution.trials * 100
        return Cell(
            kind="evolve",
            name=self.name,
            title=f"evolve {self.name}",
            settings=self,
            needs=(*(cell for member in self.members for cell in member.needs), *needed(self.learned)),
            labels={"name": self.name, "against": labels_of(self.members)},
            expected_seconds=rollouts
            * steps_in(self.evolution.task, self.members)
            * sum(member.step_seconds() for member in self.members),
            resumable=True,
            local_only=any(any(named_files(start.controller)) for start in evolution.all_starts),
        )

    @property
    def name(self) -> str:
        """Name of the controller."""
        return ensemble_name(labels_of(self.members), self.evolution.aggregate)

    def inputs(self) -> dict[str, Any]:
        evolution = self.evolution
        return {
            "members": [member.inputs() for member in self.members],
            **identity_of(evolution),
            "repeats": evolution.repeats,
            "seed": self.seed,
        }

    def compute(self, work: CellContext) -> Champion:
        names = "+".join(member.registered for member in self.members)
        return evolve_controller(
            self.name,
            runners(self.members, work),
            self.members[0].system(work),
            with_learned_task(self.evolution, self.learned, work),
            seed=cell_seed(self.seed, f"evolve {names}"),
            checkpoint=CheckpointFile(work.checkpoint),
            progress=work.progress,
        )


@dataclass(frozen=True)
class Choose(CellSettings):
    """Choice among the finalists of all ``searches`` by their forecasts, see `forecast_judgement`.

    ``scoring_models`` are the columns of models; a search is scored if one of them is of another family than the model
    it was evolved in. Searches and scoring models that failed are left out.
    """

    searches: tuple[Cell[Evolve], ...]
    scoring_models: tuple[Plant, ...]
    trials: int
    seed: int

    def cell(self) -> Cell[Choose]:
        only = self.searches[0] if len(self.searches) == 1 else None
        name = f"best of {'+'.join(labels_of(self.members))}" if only is None else only.name
        return Cell(
            kind="select",
            name=name,
            title=f"choose {name}",
            settings=self,
            needs=(*self.searches, *(cell for model in self.scoring_models for cell in model.needs_with_prediction)),
            labels={} if only is None else only.labels,
            expected_seconds=0.1 * len(self.scoring_models),
        )

    @property
    def members(self) -> tuple[Plant, ...]:
        """Everything that one of the searches was evolved against."""
        found = (member for search in self.searches for member in search.settings.members)
        return tuple({member.label: member for member in found}.values())

    def inputs(self) -> dict[str, Any]:
        return {
            "contenders": [sorted({member.registered for member in one.settings.members}) for one in self.searches],
            "scoring_models": [model.registered for model in self.scoring_models],
            "rule": [FORECAST_RULE.power, FORECAST_RULE.least_error, FORECAST_RULE.own],
            "trials": self.trials,
            "seed": self.seed,
        }

    def compute(self, work: CellContext) -> Champion:
        scoring_models = fitted(self.scoring_models, work)
        scoring_runners = runners(scoring_models, work)
        searches = []
        for search in self.searches:
            champion = work.result(search)
            if champion is not None:
                own = {member.registered for member in search.settings.members}
                of_other_families = any(model.registered not in own for model in scoring_models)
                searches.append((champion, scoring_runners if of_other_families else {}))
        if not searches:
            raise Blocked(blocked_reason(self.searches[0]))
        errors = {model.label: prediction_error(model, work) for model in scoring_models}
        families = {column.label: column.registered for column in (*self.members, *scoring_models)}
        return choose(
            searches,
            seed=cell_seed(self.seed, "choose"),
            trials=self.trials,
            judgement=forecast_judgement(errors, families),
        )


@dataclass(frozen=True)
class Polish(CellSettings):
    """Polish of the best finalists of ``chosen`` against all of ``members`` at once.

    Members that could not be fitted are left out; with ``accurate_only`` also those that predict badly, see
    `accurate_plants`.
    """

    chosen: Cell[Choose]
    members: tuple[Plant, ...]
    evolution: ControllerEvolution
    generations: int
    starts: int
    seed: int
    label: str = POLISHED
    accurate_only: bool = False
    learned: Cell[LearnTask] | None = None

    def cell(self) -> Cell[Polish]:
        rollouts = self.starts * self.generations * self.evolution.trials * 50
        return Cell(
            kind="polish",
            name=self.label,
            title="polish the best" if self.label == POLISHED else f"polish {self.label}",
            settings=self,
            needs=(
                self.chosen,
                *(cell for m in self.members for cell in (m.needs_with_prediction if self.accurate_only else m.needs)),
                *needed(self.learned),
            ),
            labels={"name": self.label, "against": labels_of(self.members)},
            expected_seconds=rollouts
            * steps_in(self.evolution.task, self.members)
            * sum(member.step_seconds() for member in self.members),
            resumable=True,
        )

    def inputs(self) -> dict[str, Any]:
        return {
            "members": [member.inputs() for member in self.members],
            "accurate": ACCURATE if self.accurate_only else None,
            **identity_of(self.evolution),
            "generations": self.generations,
            "starts": self.starts,
            "seed": self.seed,
        }

    def compute(self, work: CellContext) -> Champion:
        champion = work.result(self.chosen)
        if champion is None:
            raise Blocked(blocked_reason(self.chosen))
        members, evolution = fitted(self.members, work), with_learned_task(self.evolution, self.learned, work)
        return polish(
            self.label,
            champion,
            runners(accurate_plants(members, work) if self.accurate_only else members, work),
            evolution,
            seed=cell_seed(self.seed, "polish"),
            starts=self.starts,
            generations=round(self.generations * evolution.generations / self.evolution.generations),
            checkpoint=CheckpointFile(work.checkpoint),
            progress=work.progress,
        )


MODEL = "model"
"""The parameter by which a controller names the models inside it."""


@dataclass(frozen=True)
class Baseline(CellSettings):
    """A controller that runs on ``system`` without evolution; files that it names are identified by their content.

    ``models`` are the cells of the models of the comparison that its parameter ``model`` names by their labels.
    """

    members: ClassVar[tuple[Plant, ...]] = ()

    spec: Spec
    task: Spec
    system: System
    models: Mapping[str, Cell] = field(default_factory=dict)
    learned: Cell[LearnTask] | None = None

    def cell(self) -> Cell[Baseline]:
        return Cell(
            kind="baseline",
            name=self.spec.label,
            title=f"make {self.spec.label}",
            settings=self,
            needs=(*self.models.values(), *needed(self.learned)),
            labels={"name": self.spec.label},
            local_only=bool(self.models) or any(named_files(self.spec)),
        )

    def inputs(self) -> dict[str, Any]:
        spec = named_models(self.spec, {label: cell.digest for label, cell in self.models.items()})
        return {
            "controller": controllers.identity(spec),
            "files": file_digests(spec),
            "task": tasks.identity(self.task),
            "system": self.system.to_dict(),
        }

    def compute(self, work: CellContext) -> Champion:
        files = {label: f"{work.path_of(cell).resolve()}.json" for label, cell in self.models.items()}
        task = learned_task(self.task, self.learned, work)
        return Champion.baseline(named_models(self.spec, files), task, self.system)


class ControllerSettings(CellSettings):
    """Settings of another cell that gives a controller, evolved against ``members``."""

    members: tuple[Plant, ...]


ControllerCell: TypeAlias = Cell[Evolve | Choose | Polish | Baseline | ControllerSettings]
"""A cell that gives a controller; the ``members`` of its settings are the plants it was evolved against."""

CONTROLLERS = ResultType("controllers", lambda value, path, _: files_of(save_champion(value, path)), load_champion)
CELL_KINDS["evolve"] = CellKind(CONTROLLERS, version=4)
CELL_KINDS["baseline"] = CellKind(CONTROLLERS)
CELL_KINDS["select"] = CELL_KINDS["polish"] = CellKind(CONTROLLERS, version=4, tolerant=True)


def labels_inside(spec: Spec, labels: Collection[str]) -> tuple[str, ...]:
    """Return which of ``labels`` the parameter ``model`` of a controller names."""
    value = spec.parameters.get(MODEL, ())
    return tuple(name for name in ([value] if isinstance(value, str) else value) if name in labels)


def named_models(spec: Spec, names: Mapping[str, str]) -> Spec:
    """Return ``spec`` with other ``names`` for the models inside."""
    if not names:
        return spec
    value = spec.parameters[MODEL]
    one = isinstance(value, str)
    found = [names.get(name, name) for name in ([value] if one else value)]
    return Spec(spec.name, {**spec.parameters, MODEL: found[0] if one else found}, spec.label)


SINGLE_MODEL_AGGREGATE = "min"
"""Aggregate used (and stored) for a controller of a single model, where these aggregates are equivalent."""
EQUIVALENT_AGGREGATES = ("min", "mean", "median")
"""Aggregates that equal the mean over trials if there is a single model."""
MOST_POLISHED = 2
"""Number of finalists that the recommended procedure polishes."""


def evolution_settings(experiment: Experiment) -> ControllerEvolution:
    """Return the settings of evolution. Raises the errors of the registries for wrong names and parameters."""
    budget, noise, task = experiment.budget, experiment.noise, Spec.parse(experiment.task or DEFAULT_TASK)
    if noise is None:
        noise = str(getattr(tasks.get(task.name), "default_noise", ""))
    starts = experiment.starts
    if starts is None:
        starts = DEFAULT_STARTS if task.name == "environment" and _free_to_choose(experiment) else ""
    return ControllerEvolution(
        generations=budget.generations,
        trials=budget.trials,
        repeats=budget.repeats,
        aggregate=experiment.aggregate,
        selection_trials=experiment.selection_trials,
        estimator_delay=experiment.estimator_delay,
        controller=Spec.parse(budget.controller),
        task=task,
        strategy=Spec.parse(budget.strategy),
        noise="" if noise == NONE else noise,
        starts=Start.listed(starts),
    )


DEFAULT_STARTS = (
    "start(controller=linear, strategy=cma_es(sigma=0.3)), "
    "start(controller=feed_forward(hidden=16), strategy=cma_es(sigma=0.3)), "
    "start(controller=recurrent(hidden=10), strategy=niches)"
)
"""Starts for a task that is not known here: a law that suffices to balance, a small network from outputs near zero,
which does not begin with extreme commands that such a task may punish, and the usual search."""


FEW_GENERATIONS = 60
"""Number of generations below which a search is too short to compare starts."""


def _free_to_choose(experiment: Experiment) -> bool:
    """Return whether neither starts nor what they consist of is given, and the search is long enough for several."""
    budget = experiment.budget
    given = (experiment.controller, experiment.strategy, experiment.starts)
    return (
        budget.procedure == "recommended"
        and budget.generations >= FEW_GENERATIONS
        and all(one is None for one in given)
    )


def with_starts(experiment: Experiment, system: System, robot: Spec | None = None) -> Experiment:
    """Return the experiment with `DEFAULT_STARTS` for a body in space, or the simulator of another package.

    The network of the usual search has some 200 parameters there, and its large first outputs turn such bodies over.
    """
    made = None if robot is None else make_robot(robot)
    foreign = made is not None and made.stepped and made.dynamics is None
    several = foreign or isinstance(system.motion, RigidBody)
    if not several or not _free_to_choose(experiment):
        return experiment
    return experiment.model_copy(update={"starts": DEFAULT_STARTS})


def evolution_on(experiment: Experiment, members: tuple[Plant, ...]) -> ControllerEvolution:
    """Return the settings of evolution on ``members``; with robots among them noise is used only if it is asked for.

    Aggregates that are equivalent on a single model are replaced by one of them there. Searches in slow
    models have fewer generations (`limited`).
    """
    evolution = evolution_settings(limited(experiment, members))
    if len(members) == 1 and Spec.parse(evolution.aggregate).name in EQUIVALENT_AGGREGATES:
        evolution = replace(evolution, aggregate=SINGLE_MODEL_AGGREGATE)
    if experiment.noise is None and any(member.robot is not None for member in members):
        return replace(evolution, noise="")
    return evolution


def controller_cell(
    experiment: Experiment,
    members: tuple[Plant, ...],
    *,
    scoring_models: tuple[Plant, ...],
    label: str | None = None,
    accurate_only: bool = False,
    further: tuple[Cell[Evolve], ...] = (),
    learned: Cell[LearnTask] | None = None,
) -> ControllerCell:
    """Return the cell of one controller against all of ``members``, by the procedure of ``experiment``.

    The recommended procedure searches in each member alone, chooses the best by their median on those of
    ``scoring_models`` that are models of other families and predict well, and polishes them on all members at once;
    with ``accurate_only`` on those that predict well. Such a controller is called ``label``, by default after its
    members. The finalists of ``further`` evolutions, in several models at once, can be chosen, too. ``learned`` is the
    cell in which the task learns its reward, if it does.
    """
    evolution = evolution_on(experiment, members)
    if experiment.budget.procedure == "plain":
        return Evolve(members, evolution, experiment.seed, learned).cell()
    models = tuple(column for column in scoring_models if column.robot is None)
    singles = tuple(
        Evolve((one,), evolution_on(experiment, (one,)), experiment.seed, learned).cell() for one in members
    )
    if len(members) == 1:
        return chosen_cell(experiment, singles, models)
    chosen = Choose((*singles, *further), models, experiment.selection_trials, experiment.seed).cell()
    name = label or ensemble_name(labels_of(members), experiment.aggregate)
    polished = Polish(
        chosen,
        members,
        evolution,
        limited(experiment, members).budget.polish_generations,
        MOST_POLISHED,
        experiment.seed,
        name,
        accurate_only,
        learned,
    )
    return polished.cell()


def chosen_cell(
    experiment: Experiment, searches: tuple[Cell[Evolve], ...], scoring_models: tuple[Plant, ...]
) -> ControllerCell:
    """Return the choice among the finalists of ``searches``, if there are models of other families to score them.

    A controller evolved on a robot is scored by that robot.
    """
    members = [member for cell in searches for member in cell.settings.members]
    own = {member.registered for member in members}
    known = all(member.model is None for member in members) or all(
        scoring_model.registered in own for scoring_model in scoring_models
    )
    if len(searches) == 1 and known:
        return searches[0]
    return Choose(searches, scoring_models, experiment.selection_trials, experiment.seed).cell()
