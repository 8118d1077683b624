"""Models and ensembles of an experiment: their specs, with the values of the preset, checked without computing."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

from evaluation.experiment import Experiment
from sysid_evo.errors import IncompatibleSystem, InvalidArgument, MissingExtra, SysidEvoError, described
from sysid_evo.models import DynamicsModel
from sysid_evo.registry import Registry, Spec, check_labels, models
from sysid_evo.system import System

ALL = "all"

PAPER_FAMILIES = ("backprop27", "evolved3", "nearest_neighbour", "parametrised")
OTHER_FAMILIES = (*PAPER_FAMILIES, "sindy", "narx", "mlp_ensemble")
"""Families that are compared by default; with the preset ``paper`` only those of the paper."""
TURNING_FAMILIES = ("backprop27", "nearest_neighbour", "sindy", "narx", "mlp_ensemble")
"""Default families if a state is periodic: those that predict well on the emulated pendulum and cart-pole."""
SCORING_FAMILIES = ("gaussian_process", "nonlinear_state_space")
"""Families that score controllers by default without one of their own: their errors are not those of the others."""
DEFAULT_ENSEMBLES = (("evolved3", "nearest_neighbour"), ("backprop27", "nearest_neighbour", "parametrised"))
"""The two multi-model controllers of the paper, mm1c and, as far as its text describes it, mm2c."""


def requested_models(experiment: Experiment) -> tuple[Spec, ...] | None:
    """Return the specs of the models that are named, None if the choice is left open."""
    if experiment.models is None or experiment.models == (ALL,):
        return None
    if not experiment.models:
        raise InvalidArgument("models: expected at least one family, got none; leave --models out for the default ones")
    return check_labels(tuple(Spec.parse(text) for text in experiment.models))


def models_of(experiment: Experiment, system: System, remarks: list[str]) -> tuple[Spec, ...]:
    """Return the specs of the models, complete with the preset; default families that cannot run give remarks."""
    requested = requested_models(experiment)
    if requested is not None:
        return tuple(_usable(spec, experiment.preset, system) for spec in requested)
    usual: tuple[str, ...] = PAPER_FAMILIES if experiment.preset == "paper" else OTHER_FAMILIES
    if system.periods and usual is OTHER_FAMILIES and experiment.models is None:
        usual = TURNING_FAMILIES
        turning = ", ".join(channel.name for channel in system.states if channel.period)
        remarks.append(f"evolved3 is left out: it predicts badly where {turning} wraps around. Name it to include it")
    found = []
    for name in models.names() if experiment.models == (ALL,) else usual:
        try:
            found.append(_usable(Spec(name), experiment.preset, system))
        except (MissingExtra, IncompatibleSystem) as error:
            remarks.append(f"{name} is left out: {error}")
    if not found:
        raise InvalidArgument(f"none of the default families can be compared here: {'; '.join(remarks)}")
    return tuple(found)


def scoring_models_of(experiment: Experiment, system: System) -> tuple[Spec, ...]:
    """Return the specs of models that only score controllers, none if the models are named.

    A state space with hidden states predicts badly where rates are states, as those of bodies and of angles are.
    """
    if experiment.models is not None or experiment.stop_after is not None or experiment.preset == "paper":
        return ()
    found = []
    for name in SCORING_FAMILIES[:1] if system.motion is not None or system.periods else SCORING_FAMILIES:
        with suppress(MissingExtra, IncompatibleSystem):
            found.append(_usable(Spec(name), experiment.preset, system))
    return tuple(found)


def searched_of(experiment: Experiment, labels: tuple[str, ...]) -> tuple[str, ...]:
    """Return which models of these ``labels`` controllers are evolved in; the others only score.

    Raises `InvalidArgument` if the experiment names others, or none.
    """
    searched = labels if experiment.searched is None else experiment.searched
    if not searched or not set(searched) <= set(labels):
        got = ", ".join(searched) or "none"
        raise InvalidArgument(f"searched: expected some of the models {', '.join(labels)}, got {got}")
    return tuple(label for label in labels if label in searched)


def _usable(spec: Spec, preset: str, system: System) -> Spec:
    """Return ``spec`` with its preset. Raises if it cannot be made, or cannot describe ``system``."""
    whole, model = made_model(spec, preset)
    model.check_system(system)
    return whole


def made_model(spec: Spec, preset: str) -> tuple[Spec, DynamicsModel]:
    """Return ``spec`` with its preset, and the model that it makes. Raises if it cannot be made here."""
    models.check(spec)
    lacking = models.missing_package(spec.name)
    if lacking is not None:
        raise lacking
    whole = with_preset(spec, preset)
    model: DynamicsModel = made(models, whole)
    return whole, model


def ensembles_of(experiment: Experiment, labels: tuple[str, ...]) -> tuple[tuple[str, ...], ...]:
    """Return the members of each ensemble; ensembles that differ only in order are one."""
    if experiment.stop_after is not None:
        return ()
    if experiment.ensembles is None:
        chosen = tuple(members for members in DEFAULT_ENSEMBLES if set(members) <= set(labels))
        return chosen or ((labels,) if len(labels) > 1 else ())
    requested = [_ensemble(text, labels) for text in experiment.ensembles]
    return tuple({frozenset(members): members for members in reversed(requested)}.values())[::-1]


def _ensemble(text: str, labels: tuple[str, ...]) -> tuple[str, ...]:
    members = tuple(member.strip() for member in text.split("+"))
    if len(members) < 2:
        raise InvalidArgument(
            f"ensemble {text!r}: expected two or more models joined by +, such as {'+'.join(labels[:2])}; "
            "every single model is compared anyway"
        )
    unknown = [member for member in members if member not in labels]
    if unknown:
        raise InvalidArgument(f"ensemble {text!r} names {', '.join(unknown)}, but the models are {', '.join(labels)}")
    if len(set(members)) < len(members):
        raise InvalidArgument(f"ensemble {text!r} names a model twice")
    return members


def made(registry: Registry[Any], spec: Spec) -> Any:
    try:
        return registry.make(spec)
    except SysidEvoError:
        raise
    except Exception as error:  # a constructor may fail in any way when its values are wrong
        raise InvalidArgument(f"{registry.kind} {spec}: {described(error)}") from error


def with_preset(spec: Spec, preset: str) -> Spec:
    """Return the spec of a model with the values of its family's preset; its own parameters take precedence."""
    family: Any = models.get(spec.name)
    return spec.with_parameters(**family.presets.get(preset, {}))


def without_preset(spec: Spec, preset: str) -> Spec:
    """Return the spec of a model without the values that its family has from ``preset``."""
    family: Any = models.get(spec.name)
    brought = family.presets.get(preset, {})
    own = {key: value for key, value in spec.parameters.items() if key not in brought or value != brought[key]}
    return Spec(spec.name, own, spec.label)
