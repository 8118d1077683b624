"""The result of an evolution: Champion, Finalist, and their files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from sysid_evo.artefacts import read_artefact, stored_file, write_artefact
from sysid_evo.controllers.controller import make_controller
from sysid_evo.display import Displayed, listed
from sysid_evo.errors import ArtefactError, IncompatibleSystem, InvalidArgument, ShapeError
from sysid_evo.registry.grammar import Spec, spec_of
from sysid_evo.system import System
from sysid_evo.tasks.task import make_task
from sysid_evo.types import Array, Converted, check_shape


@dataclass(frozen=True)
class Finalist:
    """The best candidate (n,) of one behaviour class of one run; the champion is chosen among the finalists.

    ``fitness`` is its claim, measured on fresh trials in the models of its evolution. ``forecast`` is its score on the
    scoring models (`FinalistScore`), None without such models. ``behaviour_class`` is empty for a strategy without
    behaviour classes.
    """

    behaviour_class: str
    repeat: int
    fitness: float
    parameters: Array
    forecast: float | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return all fields but the parameters, as strict JSON."""
        return {name: value for name, value in vars(self).items() if name != "parameters"}


PLAIN = ("name", "aggregate", "seed", "estimator_delay", "noise", "polished")
LISTS = ("against", "seed_fitness", "scoring_models")
"""Fields of a champion that are stored as they are, and as lists."""


@dataclass(frozen=True, repr=False)
class Champion(Displayed):
    """One evolved parameter vector (n,) of a registered ``controller`` for a registered ``task``.

    - ``against``: labels of the models of its evolution; ``aggregate``: the rule that combined their fitness.
    - ``history`` (G, 3): best, mean and worst fitness of each generation, with ``estimator_delay`` (s) and
      ``noise`` (a spec, empty for none); ``population`` (P, n): the last candidates, best first.
    - ``finalists``: the candidates among which it was chosen, by their score on the ``scoring_models`` or by fitness.
    - ``seed_fitness``: fitness of the best finalist of each run (one evolution seed each), on the same fresh trials.
    - ``system``: None for a human driver; ``polished``: True if it was refined on several models, see `polish`.
    """

    name: str
    parameters: Array
    against: tuple[str, ...]
    aggregate: str
    seed: int
    history: Array
    controller: Converted[Spec | str, Spec] = Converted(spec_of, "recurrent")
    task: Converted[Spec | str, Spec] = Converted(spec_of, "point_to_point")
    estimator_delay: float = 0.0
    noise: str = ""
    seed_fitness: tuple[float, ...] = ()
    system: System | None = None
    scoring_models: tuple[str, ...] = ()
    polished: bool = False
    finalists: tuple[Finalist, ...] = ()
    population: Array = field(default_factory=lambda: np.empty((0, 0)))

    def __post_init__(self) -> None:
        object.__setattr__(self, "parameters", check_shape("parameters", self.parameters, (None,)))
        object.__setattr__(self, "history", check_shape("history", self.history, (None, 3)))

    def facts(self) -> Mapping[str, str]:
        reached = f"{self.history[-1, 0]:.4g} after {len(self.history)} generations" if len(self.history) else ""
        return {
            "name": self.name,
            "controller": self.controller.text,
            "parameters": str(len(self.parameters)),
            "task": self.task.shown,
            **({"evolved against": f"{listed(self.against)} ({self.aggregate})"} if self.against else {}),
            **({"chosen by": listed(self.scoring_models)} if self.scoring_models else {}),
            **({"best fitness in evolution": reached} if reached else {}),
        }

    @classmethod
    def baseline(cls, controller: Spec | str, task: Spec | str, system: System) -> Champion:
        """Return a controller that needs no evolution, with zeros as parameters, for ``task`` on ``system``.

        Raises `InvalidArgument` for a controller that must be evolved.
        """
        spec = spec_of(controller)
        law = make_controller(spec).bind_to(make_task(task).bind(system))
        if not law.is_baseline:
            raise InvalidArgument(f"controller {spec.name!r} must be evolved before it can drive: give its file")
        zeros = np.zeros(law.n_parameters)
        return cls(spec.label, zeros, (), "min", 0, np.empty((0, 3)), controller=spec, task=task, system=system)

    def check_system(self, system: System) -> None:
        """Raise `IncompatibleSystem` unless ``system`` matches the system that it was evolved for."""
        differences = () if self.system is None else self.system.differences(system)
        if differences:
            raise IncompatibleSystem(
                f"controller {self.name!r} was evolved for another system: {'; '.join(differences)}. "
                "Evolve a controller for this system, or run this one on its own robot"
            )

    def to_dict(self) -> dict[str, Any]:
        """Return all fields but the arrays (see `tensors`), as strict JSON."""
        return {
            **{name: getattr(self, name) for name in PLAIN},
            **{name: list(getattr(self, name)) for name in LISTS},
            "controller": self.controller.text,
            "task": self.task.text,
            "system": None if self.system is None else self.system.to_dict(),
            "finalists": [finalist.to_dict() for finalist in self.finalists],
        }

    @property
    def tensors(self) -> dict[str, Array]:
        """The arrays that `to_dict` leaves out, by name."""
        n = len(self.parameters)
        return {
            "parameters": self.parameters,
            "history": self.history,
            "finalists": np.array([finalist.parameters for finalist in self.finalists]).reshape(len(self.finalists), n),
            "population": self.population.reshape(len(self.population), n),
        }

    @classmethod
    def from_dict(cls, value: Mapping[str, Any], tensors: Mapping[str, Array]) -> Champion:
        """Return the champion of `to_dict` and `tensors`. Raises `KeyError`, `TypeError` or `ValueError`."""
        system = value["system"]
        parameters, history, found, population = (
            np.asarray(tensors[name], dtype=np.float64) for name in ("parameters", "history", "finalists", "population")
        )  # an empty array loses its number of columns in JSON
        for name, rows in (("parameters", parameters[None]), ("finalists", found), ("population", population)):
            if rows.size and not np.isfinite(check_shape(name, rows, (None, parameters.size))).all():
                raise InvalidArgument(f"{name}: expected finite numbers, some are not")
        plain: dict[str, Any] = {name: value[name] for name in PLAIN}
        plain |= {name: tuple(value[name]) for name in LISTS}
        return cls(
            **plain,
            parameters=parameters,
            history=history.reshape(-1, 3),
            controller=Spec.parse(value["controller"]),
            task=Spec.parse(value["task"]),
            system=None if system is None else System.from_dict(system),
            finalists=tuple(
                Finalist(**finalist, parameters=row) for finalist, row in zip(value["finalists"], found, strict=True)
            ),
            population=population,
        )


def save_champion(champion: Champion, path: str | Path) -> Path:
    """Write ``<path>.safetensors`` and ``<path>.json``; return the path of the manifest."""
    learned = champion.to_dict()
    fields = {
        "kind": "controller",
        "name": champion.controller.name,
        "module": Champion.__module__,
        "parameters": dict(champion.controller.parameters),
        "system": learned.pop("system"),
        "learned": learned,
        "seed": champion.seed,
        "data": None,
    }
    return write_artefact(Path(path), champion.tensors, fields)


def load_champion(path: str | Path) -> Champion:
    """Return the controller that `save_champion` stored at ``path``, see `stored_file`. Raises `ArtefactError`."""
    path = stored_file(path, "controller")
    manifest, tensors = read_artefact(path, "controller")
    try:
        found = {**manifest.learned, "system": manifest.system}
        return Champion.from_dict(found, tensors)
    except (KeyError, TypeError, ValueError, ShapeError, InvalidArgument) as error:
        missing = isinstance(error, KeyError)
        older = "; it was written by another version of this library: evolve again" if missing else ""
        raise ArtefactError(f"{path}: not a stored controller: {type(error).__name__}: {error}{older}") from error
