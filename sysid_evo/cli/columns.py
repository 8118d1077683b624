"""What members of a run are called on the command line: fitted models by name or file, and robots."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from evaluation.comparison import Column
    from sysid_evo.dynamics import Dynamics
    from sysid_evo.evolution import ControllerEvolution
    from sysid_evo.plan import Record, Store
    from sysid_evo.system import System


def split_members(text: str) -> tuple[str, ...]:
    """Split ``a,b,c`` at the commas outside brackets. Raises `InvalidArgument`."""
    from sysid_evo.cli.options import listed
    from sysid_evo.errors import InvalidArgument

    members = listed("--against", text) or ()
    repeated = sorted({member for member in members if members.count(member) > 1})
    if repeated:
        raise InvalidArgument(f"--against: {', '.join(repeated)} is named twice")
    return members


def check_evolution(store: Store, columns: tuple[Column, ...], evolution: ControllerEvolution) -> tuple[str, ...]:
    """Check that all members have one system, and that task and controller fit it. Raises what does not.

    Returns why the task cannot be done well by the first of them whose equations are known, in sentences.
    """
    from sysid_evo.errors import IncompatibleSystem
    from sysid_evo.evolution.feasibility import farthest_driven

    systems = {column.label: system_of(store, column) for column in columns}
    (first, system), *others = systems.items()
    for label, other in others:
        differences = system.differences(other)
        if differences:
            raise IncompatibleSystem(f"--against: {first} and {label} have different systems: {'; '.join(differences)}")
    task = evolution.make_task(system)
    evolution.stages(task, tuple(systems))
    evolution.make_strategy(evolution.make_controller(task).n_parameters, 0)
    known = next((column for column in columns if has_dynamics(column)), None)
    farthest = None if known is None else farthest_driven(dynamics_of(store, known))
    return () if farthest is None else task.doubts(farthest)


def other_models(store: Store, columns: tuple[Column, ...]) -> tuple[Column, ...]:
    """Return the models of the run that are of one system with ``columns`` and not among them."""
    system = system_of(store, columns[0])
    taken = {column.model.digest for column in columns if column.model is not None}
    found = []
    for record in store.records():
        if record.kind == "fit" and record.status == "done" and record.digest not in taken:
            column = column_of(store, record)
            if not system.differences(dynamics_of(store, column).system):
                found.append(column)
    return tuple(found)


def is_file(name: str) -> bool:
    """Whether ``name`` is the path of a stored model."""
    from sysid_evo.store import is_stored

    return is_stored(name, "model")


def is_robot(name: str) -> bool:
    """Whether ``name`` is a spec of a registered robot, or a file that describes one."""
    from sysid_evo.errors import InvalidArgument
    from sysid_evo.registry import robot_spec, robots

    if name.endswith(".toml"):
        return True
    try:
        return robot_spec(name).name in robots.names()
    except InvalidArgument:
        return False


def is_model_of_a_run(name: str) -> bool:
    """Whether ``name`` can only be a model in a run folder."""
    return not is_file(name) and not is_robot(name)


def find_column(store: Store, name: str) -> Column:
    """Return the model or emulated robot that ``name`` stands for. Raises `InvalidArgument`, `ArtefactError`."""
    from evaluation.comparison import Column, StoredModel, runner_of
    from sysid_evo.registry import robot_spec
    from sysid_evo.store import stored_file

    if is_file(name):
        file = stored_file(name, "model")
        own = record_of_file(store, file)
        if own is not None:
            return column_of(store, own)
        model = StoredModel(file)
        return Column(model.name, model.family, model=model)
    if is_robot(name):
        spec = robot_spec(name)
        runner_of(spec)
        return Column(spec.label, spec.label, robot=spec)
    return column_of(store, find_model(store, name))


def column_of(store: Store, record: Record) -> Column:
    """Return the model of a run as a column, with the cell of how well it predicts what was held back of its data."""
    from evaluation.comparison import Column, FitCell, GivenData, PredictCell
    from sysid_evo.plan import StoredCell

    model, family = StoredCell(record, FitCell), record.inputs["model"]["name"]
    data = next((one for one in store.records() if one.digest in record.needs and one.status == "done"), None)
    if data is None or not (data.inputs["split"]["test"] or data.inputs["split"]["share"]):
        return Column(record.name, family, model=model)
    prediction = PredictCell(record.name, family, StoredCell(data, GivenData), model)
    return Column(record.name, family, model=model, prediction=prediction)


def record_of_file(store: Store, file: Path) -> Record | None:
    """Return the record of the run's model that stands in ``file``, None if it is no model of the run."""
    stem = file.with_suffix("").resolve()
    for record in store.records():
        if record.kind == "fit" and record.status == "done" and (store.path / record.artefact).resolve() == stem:
            return record
    return None


def find_model(store: Store, name: str) -> Record:
    """Return the record of the model called ``name`` in a run. Raises `InvalidArgument` that names those there are."""
    from sysid_evo.errors import InvalidArgument

    stored = [record for record in store.records() if record.kind == "fit" and record.status == "done"]
    files = {Path(record.artefact).name: record for record in stored}
    if name in files:
        return files[name]
    fitting = [record for record in stored if record.name == name]
    if len(fitting) == 1:
        return fitting[0]
    if fitting:
        several = ", ".join(Path(record.artefact).name for record in fitting)
        raise InvalidArgument(f"{name!r} stands for several models of {store.path}: {several}; name one of these")
    known = ", ".join(dict.fromkeys(record.name for record in stored)) or "none"
    raise InvalidArgument(f"{name!r} is not among the models of {store.path}: {known}")


def has_dynamics(column: Column) -> bool:
    """Whether the equations behind a column can be stepped: a model's and an emulated robot's, no environment's."""
    from sysid_evo.registry import make_robot

    return column.robot is None or make_robot(column.robot).dynamics is not None


def system_of(store: Store, column: Column) -> System:
    """Return the system of the model or robot behind a column."""
    from sysid_evo.registry import make_robot

    if column.robot is None:
        return dynamics_of(store, column).system
    system: System = make_robot(column.robot).system
    return system


def dynamics_of(store: Store, column: Column) -> Dynamics:
    """Return the model or the emulated robot behind a column."""
    from evaluation.comparison import StoredModel, emulated

    if column.robot is not None:
        return emulated(column.robot)
    assert column.model is not None
    model: Dynamics = (
        column.model.load(column.model.path) if isinstance(column.model, StoredModel) else store.load(column.model)
    )
    return model
