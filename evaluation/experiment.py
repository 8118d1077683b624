"""Settings of a comparison: the content of ``experiment.toml``, validated."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias, TypedDict

import tomli_w
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from sysid_evo.errors import InvalidArgument, Meaningless, UnknownName, did_you_mean, meaningless, refuse_meaningless
from sysid_evo.files import parsed_toml, write_atomically
from sysid_evo.registry import Spec, make_robot

FILE = "experiment.toml"
DEFAULT_ROBOT = "emulated_car"
USUAL_TASK = "point_to_point"
"""The task if neither the user nor the robot names one."""
NONE = "none"
"""Value of ``noise`` for none, also if the task has a default."""

Positive = Annotated[int, Field(ge=1)]


Procedure: TypeAlias = Literal["recommended", "plain"]
"""Search procedure: searched in single models, scored by others and polished on all, or evolved on all at once."""


class Budget(BaseModel):
    """Settings and duration of controller evolution; see `ControllerEvolution`.

    With the ``procedure`` "recommended" controllers are chosen by models of other families, and the best of all are
    polished by ``polish_generations`` generations against all models at once.
    """

    model_config = ConfigDict(frozen=True)

    controller: str = "recurrent(hidden=10)"
    strategy: str = "niches"
    procedure: Procedure = "recommended"
    generations: Positive
    trials: Positive
    repeats: Positive
    polish_generations: Positive = 240


BUDGETS: dict[str, Budget] = {
    "quick": Budget(generations=900, trials=5, repeats=1, polish_generations=240),
    "standard": Budget(generations=1200, trials=5, repeats=1, polish_generations=400),
    "paper": Budget(
        generations=300, trials=10, repeats=2, controller="recurrent", strategy="mu_plus_lambda", procedure="plain"
    ),
}
"""Budgets of controller evolution by preset; families define their own as `DynamicsModel.presets`."""


class Experiment(BaseModel):
    """Settings of a comparison: models, data, controllers, robot, duration and seed.

    Names are texts in the grammar of `Spec`. None means that the value is derived from the other settings.

    - ``data``: logs, or a folder with a data set; without it the ``robot`` is recorded for ``minutes``.
    - ``test``: names of the held-out episodes; by default the last ``held_out`` share of each is held out.
    - ``leave_out``: also fit every family without each condition of the recordings (`Dataset.label_conditions`) in
      turn, and test it there.
    - ``models``, ``ensembles``: models to fit, and ensembles of them, labels joined by ``+``; every model is also an
      ensemble of one. None leaves the choice to `plan_comparison`.
    - ``stop_after``: stop after the models ("fit") or after their prediction errors ("prediction").
    - ``task``: None is the robot's own (`Robot.usual_task`), else `USUAL_TASK`.
    - ``controller``, ``strategy``, ``procedure``, ``generations``, ``trials``, ``repeats``, ``polish_generations``:
      None is the value of the ``preset``, see `Budget`.
    - ``schedule``: easier stages before the task, see `Stage`.
    - ``noise``, ``penalty``: `DomainRandomisation` and `UncertaintyPenalty` during evolution; neither counts in claimed
      fitness, and "none" switches one off. None is `Task.default_noise`, which applies to models only.
    - ``estimator_delay``: age of the state that controllers get, in s.
    - ``reference``: also evolve a controller on the robot itself, if it is simulated, by one search no longer than
      those in models. It is a reference, not an upper limit. None: only if this run records an emulated robot and
      follows the recommended procedure.
    - ``baselines``: controllers that need no evolution (`Champion.baseline`), each a row of the matrix.
    - ``data_digest``: written by the program: the cell of the data, by which a run finds its own data again.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    title: str | None = None
    data: tuple[str, ...] | None = None
    columns: str | None = None
    test: tuple[str, ...] | None = None
    leave_out: Literal["condition"] | None = None
    held_out: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.25
    robot: str | None = None
    minutes: Annotated[float, Field(ge=0.1)] = 6.0
    models: tuple[str, ...] | None = None
    ensembles: tuple[str, ...] | None = None
    preset: Literal["quick", "standard", "paper"] = "quick"
    stop_after: Literal["fit", "prediction"] | None = None
    task: str | None = None
    controller: str | None = None
    baselines: tuple[str, ...] = ()
    strategy: str | None = None
    procedure: Procedure | None = None
    aggregate: str = "min"
    noise: str | None = None
    penalty: str = ""
    schedule: str = ""
    generations: Positive | None = None
    trials: Positive | None = None
    repeats: Positive | None = None
    polish_generations: Positive | None = None
    selection_trials: Positive = 100
    estimator_delay: Annotated[float, Field(ge=0.0)] = 0.0
    transfer_trials: Positive = 100
    traces: Annotated[int, Field(ge=0)] = 10
    reference: bool | None = None
    seed: Annotated[int, Field(ge=0)] = 0
    plugins: tuple[str, ...] = ()
    data_digest: str | None = None

    @classmethod
    def of(cls, settings: Mapping[str, Any]) -> Experiment:
        """Return the experiment with these settings. Raises `InvalidArgument` that names the wrong one."""
        try:
            return cls.model_validate(dict(settings))
        except ValidationError as error:
            raise InvalidArgument("; ".join(map(_sentence, error.errors()))) from error

    @classmethod
    def read(cls, path: str | Path) -> dict[str, Any]:
        """Return the settings in a TOML file (or in that of a run folder), checked. Raises `InvalidArgument`."""
        path = Path(path)
        file = path / FILE if path.is_dir() else path
        settings = read_toml(file, "an experiment")
        try:
            cls.of(settings)
            if "data_digest" not in settings:  # the program writes all settings, a user only the relevant ones
                refuse_meaningless(MEANINGLESS, settings, settings)
        except InvalidArgument as error:
            raise InvalidArgument(f"{file}: {error}") from error
        return settings

    def write(self, path: str | Path) -> Path:
        """Write the experiment to a TOML file."""
        return write_toml(self.model_dump(mode="json", exclude_none=True), Path(path))

    @property
    def budget(self) -> Budget:
        """The budget of the preset with the given changes; a polish is no longer than the search before it."""
        if self.preset not in BUDGETS:
            raise UnknownName(f"no preset is called {self.preset!r}; there are {', '.join(BUDGETS)}")
        given = {name: getattr(self, name) for name in Budget.model_fields if getattr(self, name) is not None}
        found = BUDGETS[self.preset].model_copy(update=given)
        if self.polish_generations is None:
            found = found.model_copy(update={"polish_generations": min(found.polish_generations, found.generations)})
        return found


class Settings(TypedDict, total=False):
    """Settings of an `Experiment` as keyword arguments, for type checkers."""

    title: str | None
    columns: str | Path | None
    test: Sequence[str] | None
    leave_out: Literal["condition"] | None
    held_out: float
    robot: str | None
    minutes: float
    models: Sequence[str] | None
    ensembles: Sequence[str] | None
    preset: Literal["quick", "standard", "paper"]
    stop_after: Literal["fit", "prediction"] | None
    task: str | None
    controller: str | None
    baselines: Sequence[str]
    strategy: str | None
    procedure: Procedure | None
    aggregate: str
    noise: str | None
    penalty: str
    schedule: str
    generations: int | None
    trials: int | None
    repeats: int | None
    polish_generations: int | None
    selection_trials: int
    estimator_delay: float
    transfer_trials: int
    traces: int
    reference: bool | None
    seed: int
    plugins: Sequence[str | Path]


OF_CONTROLLERS = (
    "task", "controller", "baselines", "strategy", "procedure", "aggregate", "noise", "penalty", "schedule",
    "generations", "trials", "repeats", "polish_generations", "selection_trials", "estimator_delay", "transfer_trials",
    "traces", "reference",
    "ensembles",
)  # fmt: skip
NO_CONTROLLERS = {"stop_after": ("fit", "prediction")}

MEANINGLESS = (
    Meaningless(OF_CONTROLLERS, "no controller is evolved or run", NO_CONTROLLERS),
    Meaningless(("robot",), "nothing is run on a robot", {**NO_CONTROLLERS, "data": ()}),
    Meaningless(("leave_out", "held_out"), "nothing is tested", {"stop_after": ("fit",)}),
    Meaningless(("held_out",), "these episodes are held out instead", {"test": ()}),
    Meaningless(("minutes",), "no robot is recorded", {"data": ()}),
    Meaningless(("columns",), "no logs are read", unless=("data",)),
    Meaningless(("polish_generations",), "nothing is polished", {"procedure": ("plain",)}),
)
"""Settings that others make meaningless; giving both is an error."""


def meaningful(settings: Mapping[str, Any], given: Mapping[str, Any]) -> dict[str, Any]:
    """Return ``settings`` updated with those ``given``, without those that have no effect next to these."""
    whole = {**settings, **given}
    idle = meaningless(MEANINGLESS, settings, whole)
    return {name: value for name, value in whole.items() if name in given or name not in idle}


def check_settings(experiment: Experiment, *, has_data: bool) -> None:
    """Raise `InvalidArgument` if a given setting has no effect; an experiment written by the program has all settings.

    ``has_data`` is true if there are recordings, also those that the experiment does not name.
    """
    if experiment.data_digest is None:
        asked = {name: getattr(experiment, name) for name in experiment.model_fields_set}
        refuse_meaningless(MEANINGLESS, asked, {**asked, "data": has_data})


def usual_task(robots: Iterable[Spec | None]) -> str:
    """Return the task of the first of ``robots`` that has one of its own, else `USUAL_TASK`."""
    own = (str(getattr(make_robot(robot), "usual_task", "")) for robot in robots if robot is not None)
    return next(filter(None, own), USUAL_TASK)


def with_task(experiment: Experiment, robots: Iterable[Spec | None]) -> Experiment:
    """Return the experiment with the task that it names, else the `usual_task` of ``robots``."""
    return experiment.model_copy(update={"task": experiment.task or usual_task(robots)})


def _sentence(error: Any) -> str:
    """Return one finding of pydantic as a sentence: setting, expectation, value."""
    where = ".".join(map(str, error["loc"]))
    if error["type"] == "extra_forbidden":
        return f"{where} {no_setting(where)}"
    message = error["msg"].replace("Input should be", "expected").replace("Value error, ", "")
    return f"{where}: {message}, got {error['input']!r}"


def no_setting(name: str) -> str:
    """Return that ``name`` is no setting of an experiment, with a hint if one is similar or has replaced it."""
    return f"is no setting of an experiment.{did_you_mean(name, Experiment.model_fields)}".rstrip(".")


def read_toml(file: Path, what: str) -> dict[str, Any]:
    """Return the content of a TOML file; ``what`` is the expected content in words. Raises `InvalidArgument`."""
    try:
        return parsed_toml(file.read_text(encoding="utf-8-sig"))
    except FileNotFoundError:
        raise InvalidArgument(f"{file}: expected {what}, found no such file") from None
    except (OSError, ValueError) as error:
        raise InvalidArgument(f"{file}: expected {what} in TOML: {error}") from error


def write_toml(settings: Mapping[str, Any], path: Path) -> Path:
    """Write ``settings`` to a TOML file."""
    text = tomli_w.dumps(settings)
    return write_atomically(path, lambda file: file.write_text(text, encoding="utf-8"))
