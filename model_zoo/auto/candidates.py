"""Candidates of `auto` (rows of ``candidates.toml``): families with settings, in a fixed order, and expected fit
times."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from sysid_evo.errors import IncompatibleSystem, InvalidArgument, MissingExtra, PluginError
from sysid_evo.files import parsed_toml
from sysid_evo.models import DynamicsModel
from sysid_evo.models.adapters import as_spec
from sysid_evo.registry import Spec, models
from sysid_evo.system import System

STEPS = 7200.0
NUMBERS = 5.0
"""Steps of six minutes at 20 Hz, and states and controls of a car: the data for which `Candidate.seconds` holds."""
FIXED_TIME_SHARE = 0.25
"""Fixed share of the training time of a four-network ensemble, independent of its size."""
PLUGIN_SECONDS = 5.0
"""Expected fit time in s of a family that is not listed."""


@dataclass(frozen=True)
class Candidate:
    """A family with its settings.

    ``seconds`` is the time of a fit on one processor to `STEPS` steps of a car. The share ``by_steps`` of it is
    proportional to the number of steps, ``by_channels`` to that of states and controls. ``selection_settings`` are the
    settings of the fits to folds. A ``successor_of`` another candidate, given by name, is the same with more training;
    it is tried only if the other is good. ``keep_fold_models``: keep the models fitted without each fold and average
    them with the one fitted to all data, unless one is much worse; they differ most where data are few (Krogh and
    Vedelsby 1995). Without ``for_family_name`` the name of the family does not select this candidate.
    """

    spec: Spec
    seconds: float = PLUGIN_SECONDS
    by_steps: float = 1.0
    selection_settings: dict[str, Any] = field(default_factory=dict)
    successor_of: str = ""
    keep_fold_models: bool = False
    by_channels: float = 0.3
    for_family_name: bool = True

    @property
    def name(self) -> str:
        """Its label, if it has one, else the whole spec."""
        return self.spec.text if self.spec.label == self.spec.name else self.spec.label

    def model(self, **changed: Any) -> DynamicsModel:
        """Return the unfitted model. Raises the errors of the registry if it cannot be made."""
        found: DynamicsModel = models.make(self.spec.name, **{**self.spec.parameters, **changed})
        return found

    def seconds_for(self, system: System, steps: int, *, rough: bool) -> float:
        """Return the expected time in s on one processor of a fit to this many steps."""
        size = 1.0 - self.by_channels + self.by_channels * (system.nx + system.nu) / NUMBERS
        most = self.spec.parameters.get("members", 1)
        members = self.selection_settings.get("members", most) if rough else most
        share = FIXED_TIME_SHARE + (1.0 - FIXED_TIME_SHARE) * members / most
        return self.seconds * share * size * (1.0 - self.by_steps + self.by_steps * steps / STEPS)

    def cost(self, system: System, steps: int, folds: int) -> float:
        """Return the expected time in s of all its fits: one for each fold, and one to all data."""
        learned = round(steps * (1.0 - 1.0 / max(2, folds)))
        return folds * self.seconds_for(system, learned, rough=True) + self.seconds_for(system, steps, rough=False)


def _shipped() -> tuple[Candidate, ...]:
    """Return the rows of the table: ``model`` is a spec, ``name`` a label, the rest are fields of `Candidate`."""
    table = parsed_toml(Path(__file__).with_name("candidates.toml").read_text(encoding="utf-8"))
    found = []
    for row in table["candidates"]:
        spec = Spec.parse(row.pop("model"))
        settings = {**spec.parameters, **table["settings"].get(spec.name, {})}
        whole = Spec(spec.name, settings, row.pop("name", spec.text))
        found.append(Candidate(whole, selection_settings=table["selection_settings"].get(spec.name, {}), **row))
    return tuple(found)


SHIPPED = _shipped()
"""Candidates by default, in the order of expected benefit for their time."""


def fit_seconds(family: str) -> float | None:
    """Return the shortest fit time of a family in s, see `Candidate.seconds`; None if `auto` does not try it."""
    found = (one.seconds for one in SHIPPED if one.spec.name == family and one.for_family_name)
    return min(found, default=None)


def candidates_for(system: System) -> tuple[list[Candidate], list[str]]:
    """Return the candidates for ``system``, plugins with a ``model_class`` first, and the reasons against others."""
    reasons = [(candidate, unusable(candidate, system)) for candidate in (*plugins(), *SHIPPED)]
    return [candidate for candidate, reason in reasons if not reason], [
        f"{candidate.name}: {reason}" for candidate, reason in reasons if reason
    ]


def candidates_named(given: Sequence[object]) -> list[Candidate]:
    """Return the candidates of ``given``, see `as_spec`; a family alone selects its listed candidates, or its defaults.

    Raises `InvalidArgument` for `auto` itself, and the errors of the registry for wrong names.
    """
    found: list[Candidate] = []
    for spec in map(as_spec, given):
        if spec.name == "auto":
            raise InvalidArgument("candidates: expected other families, got auto, which would contain itself")
        if spec.parameters.get("fitted"):
            raise InvalidArgument(
                f"candidates: auto compares models on data to which they were not fitted; {spec.label} is fitted: pass "
                "sklearn.base.clone(it)"
            )
        models.check(spec)
        listed = [one for one in SHIPPED if one.spec.name == spec.name and one.for_family_name]
        found += (
            [Candidate(spec)] if spec.parameters or not listed else [replace(one, successor_of="") for one in listed]
        )
    return found


def unusable(candidate: Candidate, system: System) -> str:
    """Return why a candidate cannot describe ``system`` or cannot run on this computer; empty if it can."""
    try:
        lacking = models.missing_package(candidate.spec.name)
        if lacking is not None:
            return str(lacking)
        model = candidate.model()
        model.check_system(system)
    except (IncompatibleSystem, MissingExtra, PluginError) as error:
        return str(error)
    if system.periods and not model.periodic:
        turning = ", ".join(channel.name for channel in system.states if channel.period)
        return f"it does not support periodic states ({turning})"
    return ""


def plugins() -> list[Candidate]:
    """Return the registered plugin families that declare a model class, by name."""
    found = []
    for name in models.names():
        if models.module(name).partition(".")[0] == __name__.partition(".")[0]:
            continue
        try:
            family: Any = models.get(name)
        except PluginError:  # reported when the families are listed
            continue
        if getattr(family, "model_class", ""):
            found.append(Candidate(Spec(name), getattr(family, "typical_fit_seconds", PLUGIN_SECONDS)))
    return found
