"""Settings of a comparison: the content of ``experiment.toml``, validated."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias, TypedDict

import tomli_w
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from sysid_evo.errors import InvalidArgument, Meaningless, did_you_mean, meaningless, refuse_meaningless
from sysid_evo.files import parsed_toml, write_atomically
from sysid_evo.registry import Spec, make_robot
from sysid_evo.settings import Seconds, setting

if TYPE_CHECKING:
    from sysid_evo.system import System

FILE = "experiment.toml"
DEFAULT_ROBOT = "emulated_car"
DEFAULT_TASK = "point_to_point"
"""The task if neither the user nor the robot names one."""
NONE = "none"
"""As noise: none, even if the task has a default."""

Positive = Annotated[int, Field(ge=1)]


Procedure: TypeAlias = Literal["recommended", "plain"]
"""How controllers are evolved: on each model, then selected on others and polished on all; or on all at once."""


class Budget(BaseModel):
    """Controller, strategy and length of evolution; see `ControllerEvolution`.

    The ``procedure`` "recommended" selects controllers on models of other families and evolves the best one further
    on all models, for ``polish_generations`` generations.
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
"""Budgets of controller evolution by preset; families state their own as `DynamicsModel.presets`."""


class Experiment(BaseModel):
    """Settings of a comparison: models, data, controllers, robot, budget and seed; each field describes itself.

    Names are texts in the grammar of `Spec`. None leaves a choice to `plan_comparison`; for the settings of `Budget` it
    means that of the ``preset``, for ``noise`` `Task.default_noise`, which applies to models only. Noise does not
    count in claimed fitness. The search on the robot that ``reference`` adds is no longer than those on models: it
    is a reference, no upper limit. Settings without a panel are set in ``experiment.toml`` only.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    title: str | None = setting(None, "Title of the report")
    data: tuple[str, ...] | None = setting(
        None, "Log files, folders of logs or a data set; repeatable. Without it the robot is recorded",
        "Data and models", "PATH",
    )  # fmt: skip
    columns: str | None = setting(None, "TOML file: which log column is which channel", "Data and models", "FILE")
    test: tuple[str, ...] | None = setting(None, "Episode held out for testing; repeatable", "Data and models", "NAME")
    leave_out: Literal["condition"] | None = setting(
        None, "condition: also refit without each condition and test on the one left out", "Data and models", "NAME"
    )
    held_out: float = setting(0.25, "Share of each episode held out for testing, at its end", ge=0.0, lt=1.0)
    models: tuple[str, ...] | None = setting(
        None, "Model families, comma-separated [LABEL=]SPEC, or all", "Data and models", "LIST", kind="model"
    )
    ensembles: tuple[str, ...] | None = setting(
        None, "Ensembles of these models, such as a+b,a+c", "Data and models", "LIST"
    )
    robot: str | None = setting(
        None, "Robot to record and to test on", "Data and models", "SPEC", kind="robot", shown=DEFAULT_ROBOT
    )
    minutes: float = setting(6.0, "Minutes to record", "Data and models", "N", ge=0.1)
    task: str | None = setting(None, "Task of the controllers", "Controllers", "SPEC", kind="task", shown=DEFAULT_TASK)
    controller: str | None = setting(
        None, "Controller to evolve", "Controllers", "SPEC", kind="controller", shown="set by --preset"
    )
    strategy: str | None = setting(
        None, "Evolution strategy", "Controllers", "SPEC", kind="strategy", shown="set by --preset"
    )
    procedure: Procedure | None = setting(
        None, "recommended (search on each model, select on other models, polish on all) or plain (evolve on all)",
        "Controllers", "NAME",
    )  # fmt: skip
    aggregate: str = setting("min", "Combines the fitness on several models", "Controllers", "SPEC", kind="aggregate")
    starts: str | None = setting(
        None, "Several ways to begin the search: start(controller=SPEC, strategy=SPEC)", "Controllers",
        "LIST",
    )  # fmt: skip
    baselines: tuple[str, ...] = setting(
        (), "Baseline controllers, such as pursuit", "Controllers", "LIST", kind="controller"
    )
    reference: bool | None = setting(
        None, "Also evolve on the emulated robot itself, for the best known fitness", "Controllers", "yes|no"
    )
    noise: str | None = setting(
        None, "Disturbances during evolution, such as domain_randomisation(sensor=0.1), or none (those of the task)",
        "Robustness", "SPEC", kind="noise",
    )  # fmt: skip
    estimator_delay: Seconds = setting(
        0.0, "State-estimate latency, such as 50ms, simulated in evolution and scoring", "Robustness", "TIME", ge=0.0
    )
    rounds: Positive | None = setting(None, "Rounds of recording and evolving", "Budget", "N", shown="as needed")
    command_noise: float = setting(
        0.2, "Noise on the commands while a round is recorded, as a share of half their range", ge=0.0, lt=1.0
    )
    noisy_share: float | None = setting(
        None, "Share of the episodes of a round with this noise; the others alone are compared", ge=0.0, le=1.0
    )
    max_steps: Positive = setting(20_000, "Most steps recorded in all rounds")
    searched: tuple[str, ...] | None = setting(None, "Models in which controllers are evolved; the others only score")
    preset: Literal["quick", "standard", "paper"] = setting(
        "quick", "Budget: quick, standard or paper", "Budget", "NAME"
    )
    generations: Positive | None = setting(None, "Generations of each evolution", "Budget", "N")
    trials: Positive | None = setting(None, "Trials per candidate and generation", "Budget", "N")
    repeats: Positive | None = setting(None, "Independent evolutions; the best one is kept", "Budget", "N")
    search_minutes: float = setting(10.0, "Minutes of each search in a slow model", "Budget", "N", gt=0.0)
    polish_generations: Positive | None = setting(
        None, "Generations of the evolution on all models that ends the search"
    )
    selection_trials: Positive = setting(100, "Trials by which other models select controllers")
    transfer_trials: Positive = setting(100, "Trials of each controller on each model and robot")
    robot_trials: Positive | None = setting(
        None, "Trials of each controller on the robot; by default those on models, fewer on a slow robot"
    )
    traces: int = setting(10, "Trials whose trajectories are stored for the plots", ge=0)
    stop_after: Literal["fit", "prediction"] | None = setting(
        None, "fit or prediction: no controllers are evolved", "Budget", "NAME"
    )
    seed: int = setting(0, "Seed of all random numbers", "Run", "N", ge=0)
    plugins: tuple[str, ...] = setting((), "Python file with plugins; repeatable", "Run", "FILE", option="--plugin")
    tried_models: tuple[str, ...] = setting((), "Written by the program: families tried because no other predicted")
    step_seconds: dict[str, float] = setting({}, "Written by the program: seconds of a step of slow models")
    data_digest: str | None = setting(None, "Written by the program: identifies the data of a run")

    @classmethod
    def of(cls, settings: Mapping[str, Any], named: Callable[[str], str] = str) -> Experiment:
        """Return the experiment with these settings. Raises `InvalidArgument` that names the wrong one by ``named``."""
        try:
            return cls.model_validate(dict(settings))
        except ValidationError as error:
            raise InvalidArgument("; ".join(_sentence(one, named) for one in error.errors())) from error

    @classmethod
    def read(cls, path: str | Path) -> dict[str, Any]:
        """Return the settings in a TOML file (or in that of a run folder), checked. Raises `InvalidArgument`."""
        path = Path(path)
        file = path / FILE if path.is_dir() else path
        settings = read_toml(file, "an experiment")
        try:
            cls.of(settings)
            if "data_digest" not in settings:  # the program writes all settings, a user only those to change
                refuse_meaningless(MEANINGLESS, settings, settings)
        except InvalidArgument as error:
            raise InvalidArgument(f"{file}: {error}") from error
        return settings

    def write(self, path: str | Path) -> Path:
        """Write the experiment to a TOML file."""
        return write_toml(self.model_dump(mode="json", exclude_none=True), Path(path))

    @property
    def chooses_families(self) -> bool:
        """True if the families are left open, so that further ones may be tried."""
        return self.models is None and self.stop_after != "fit"

    @property
    def budget(self) -> Budget:
        """The budget of the preset with the settings that were given; a polish is no longer than the search."""
        given = {name: getattr(self, name) for name in Budget.model_fields if getattr(self, name) is not None}
        found = BUDGETS[self.preset].model_copy(update=given)
        if self.polish_generations is None:
            found = found.model_copy(update={"polish_generations": min(found.polish_generations, found.generations)})
        return found


Settings = TypedDict("Settings", {  # noqa: UP013  # several in a line
    "title": str | None, "columns": str | Path | None, "test": Sequence[str] | None,
    "leave_out": Literal["condition"] | None, "held_out": float, "robot": str | None, "minutes": float,
    "models": Sequence[object] | Mapping[str, object] | None, "ensembles": Sequence[str] | None,
    "preset": Literal["quick", "standard", "paper"],
    "stop_after": Literal["fit", "prediction"] | None, "task": str | None, "controller": str | None,
    "baselines": Sequence[str], "strategy": str | None, "procedure": Procedure | None, "aggregate": str,
    "noise": str | None, "starts": str | None, "generations": int | None,
    "search_minutes": float, "trials": int | None, "repeats": int | None, "polish_generations": int | None,
    "selection_trials": int, "estimator_delay": float, "transfer_trials": int, "robot_trials": int | None,
    "traces": int, "reference": bool | None, "seed": int, "rounds": int | None, "command_noise": float,
    "noisy_share": float | None, "max_steps": int, "searched": Sequence[str] | None, "plugins": Sequence[str | Path],
}, total=False)  # fmt: skip
"""The keywords of `evaluation.compare`, for type checkers; see `Experiment`."""

OF_CONTROLLERS = (
    "task", "controller", "baselines", "strategy", "procedure", "aggregate", "noise", "starts",
    "generations", "search_minutes", "trials", "repeats", "polish_generations", "selection_trials", "estimator_delay",
    "transfer_trials", "robot_trials", "traces", "reference", "ensembles", "rounds", "command_noise", "noisy_share",
    "max_steps", "searched",
)  # fmt: skip
NO_CONTROLLERS = {"stop_after": ("fit", "prediction")}

MEANINGLESS = (
    Meaningless(OF_CONTROLLERS, "no controller is evolved or run", NO_CONTROLLERS),
    Meaningless(("robot",), "nothing is run on a robot", {**NO_CONTROLLERS, "data": ()}),
    Meaningless(("leave_out", "held_out"), "nothing is tested", {"stop_after": ("fit",)}),
    Meaningless(("held_out",), "these episodes are held out instead", {"test": ()}),
    Meaningless(("minutes",), "no robot is recorded", {"data": ()}),
    Meaningless(("columns",), "no logs are read", unless=("data",)),
    Meaningless(("controller", "strategy"), "the starts name their own", {"starts": ()}),
    Meaningless(("polish_generations",), "nothing is polished", {"procedure": ("plain",)}),
)
"""Settings that others make meaningless: giving both is refused."""


IN_ROUNDS: Mapping[str, Any] = {
    "models": (
        "gaussian_process(state_lags=0, control_lags=0, inducing=200)",
        "mlp_ensemble(state_lags=0, control_lags=0, one_step_updates=3000, horizon=4)",
    ),
    "controller": "linear",
    "strategy": "cma_es(sigma=0.3)",
    "procedure": "plain",
    "generations": 80,
    "trials": 5,
    "repeats": 2,
    "reference": False,
    "noisy_share": 1.0,
}
"""Settings of a comparison in rounds on a robot whose trials end early, unless they are given.

Lags and long horizons would leave nothing of episodes of five steps: with them the networks learned next to nothing.
"""
IN_LONGER_ROUNDS: Mapping[str, Any] = {
    **IN_ROUNDS,
    "models": (IN_ROUNDS["models"][1], "narx(state_lags=0, control_lags=0)"),
    "controller": "feed_forward(hidden=16)",
    "generations": 250,
    "trials": 20,
    "repeats": 1,
    "noisy_share": 0.5,
}
"""Settings of a comparison in rounds on any other robot, unless they are given.

Noise on the commands costs more than controllers differ, so half of the episodes have none.
"""
IN_ROUNDS_OF_BODIES: Mapping[str, Any] = {
    **IN_LONGER_ROUNDS,
    "models": (
        "mlp_ensemble(state_lags=0, control_lags=0, one_step_updates=3000, updates=1000, horizon=20)",
        "wide=mlp_ensemble(state_lags=0, control_lags=0, hidden=[64, 64], one_step_updates=3000, updates=1000)",
    ),
    "searched": ("mlp_ensemble",),
    "generations": 160,
    "trials": 10,
    "noise": "domain_randomisation(sensor=0.05, process=0.02)",
}
"""Settings of a comparison in rounds on a robot that moves, unless they are given.

Without noise in the models its controllers drive at the limit of their errors, and fail on the robot. A second model
that underrates what the first knows would forbid it, so that it only scores.
"""
FIRST_STEPS = 1600
"""Steps of the first recording of a comparison in rounds, unless its length is given."""


def with_rounds(experiment: Experiment, system: System, *, early: bool) -> Experiment:
    """Return an experiment in rounds on ``system`` with the settings of rounds and a short first recording.

    They are `IN_ROUNDS` if trials end ``early``, else `IN_ROUNDS_OF_BODIES` if it moves, else `IN_LONGER_ROUNDS`.
    """
    moves = system.motion is not None
    settings = IN_ROUNDS if early else IN_ROUNDS_OF_BODIES if moves else IN_LONGER_ROUNDS
    usual = {name: value for name, value in settings.items() if getattr(experiment, name) is None}
    if experiment.models is not None:
        usual.pop("searched", None)
    if "minutes" not in experiment.model_fields_set:
        usual["minutes"] = max(0.1, FIRST_STEPS * system.dt / 60.0)
    return experiment.model_copy(update=usual)


def meaningful(settings: Mapping[str, Any], given: Mapping[str, Any]) -> dict[str, Any]:
    """Return ``settings`` updated with those ``given``, without any that have no effect next to these."""
    whole = {**settings, **given}
    idle = meaningless(MEANINGLESS, settings, whole)
    return {name: value for name, value in whole.items() if name in given or name not in idle}


def check_settings(experiment: Experiment, *, has_data: bool) -> None:
    """Raise `InvalidArgument` if a setting that was given has no effect; a stored experiment has all settings.

    ``has_data``: there are recordings, also ones that the experiment does not name.
    """
    if experiment.data_digest is None:
        set_by_user = {name: getattr(experiment, name) for name in experiment.model_fields_set}
        refuse_meaningless(MEANINGLESS, set_by_user, {**set_by_user, "data": has_data})


def default_task(robots: Iterable[Spec | None]) -> str:
    """Return the task of the first robot that has its own, else `DEFAULT_TASK`."""
    own = (str(getattr(make_robot(robot), "default_task", "")) for robot in robots if robot is not None)
    return next(filter(None, own), DEFAULT_TASK)


def with_task(experiment: Experiment, robots: Iterable[Spec | None]) -> Experiment:
    """Return the experiment with the task that it names, else the `default_task` of ``robots``."""
    return experiment.model_copy(update={"task": experiment.task or default_task(robots)})


EXPECTED = {
    **dict.fromkeys(("int_parsing", "int_type", "int_from_float"), "an integer"),
    **dict.fromkeys(("float_parsing", "float_type", "finite_number"), "a number"),
    **dict.fromkeys(("bool_parsing", "bool_type"), "yes or no"),
    "greater_than_equal": "a number >= {ge:g}", "less_than": "a number < {lt:g}",
    "string_type": "a text", "tuple_type": "a list",
}  # fmt: skip
"""The values that a setting accepts, by the type of pydantic's error."""


def _sentence(error: Any, named: Callable[[str], str] = str) -> str:
    """Return one error of pydantic as: name, accepted values, value."""
    first, *rest = map(str, error["loc"])
    where = ".".join((named(first), *rest))
    if error["type"] == "extra_forbidden":
        return f"{where} {no_setting(first)}"
    message = str(error["msg"]).replace("Input should be", "expected").removeprefix("Value error, ")
    if error["type"] in EXPECTED:
        message = "expected " + EXPECTED[error["type"]].format(**error.get("ctx", {}))
    return f"{where}: {message}" + ("" if error["type"] == "value_error" else f", got {error['input']!r}")


def no_setting(name: str) -> str:
    """Return a message that ``name`` is no setting, with a hint if one is similar or has replaced it."""
    return f"is no setting of an experiment.{did_you_mean(name, Experiment.model_fields)}".rstrip(".")


def read_toml(file: Path, what: str) -> dict[str, Any]:
    """Return the content of a TOML file; ``what`` names it in messages. Raises `InvalidArgument`."""
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
