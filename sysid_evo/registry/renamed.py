"""Old names that plugins may still use: attributes of their classes, groups of entry points."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping
from importlib.metadata import EntryPoint
from typing import Any

from sysid_evo.errors import PluginWarning, RegistrationError
from sysid_evo.registry.plugins import SHIPPED

RENAMED_GROUPS = {"sysid_evo.penalties": "sysid_evo.cautions"}
"""Old groups of entry points by the new ones."""

RENAMED_ATTRIBUTES: Mapping[str, Mapping[str, str]] = {
    "Controller": {"hand_written": "is_baseline", "unwritten": "not_exportable"},
    "Dynamics": {"doubt_at": "penalty_at", "envelope": "state_bounds"},
    "DynamicsModel": {
        "cheap": "fast_fit",
        "chooses": "chooses_families",
        "envelope_multiple": "bounds_multiple",
        "held": "apply_limits",
        "lagged": "initial_carry",
        "most_steps": "max_steps",
        "offered_lags": "lag_options",
        "remember": "shift_lags",
        "rest_hold": "dead_band",
        "searched": "search_ranges",
        "spread_groups": "calibration_folds",
        "standing": "candidate_ranking",
        "structure": "model_class",
        "trained_further": "fine_tuned",
        "uses": "families_used",
        "usual_seconds": "typical_fit_seconds",
    },
    "GreyBox": {
        "declared": "law_parameters",
        "guesses_from": "initial_guesses",
        "hidden": "hidden_states",
        "history": "past_samples",
        "offsets": "random_effects",
        "places": "channel_indices",
        "speeds": "rate_of",
    },
    "Motion": {"seen_from": "relative_pose", "turning": "frame_rotation"},
    "Reader": {"labels": "texts"},
    "Robot": {"look_at": "self_test", "usual_task": "default_task"},
    "Task": {
        "doubts": "feasibility_warnings",
        "foreseen": "hide_future",
        "most": "max_fitness",
        "promise": "potential",
        "usual_noise": "default_noise",
    },
}
"""Old names of attributes and methods by the base class of the plugin; the library would ignore them."""


def refuse_renamed_attributes(what: str, plugin: type, instance: Any = None) -> None:
    """Raise `RegistrationError` if a class outside this library, or its ``instance``, uses an old attribute name.

    ``what`` names the plugin in the message.
    """
    foreign = [base for base in plugin.__mro__ if base.__module__.partition(".")[0] not in SHIPPED]
    if plugin not in foreign:
        return
    old = {name: new for base in plugin.__mro__ for name, new in RENAMED_ATTRIBUTES.get(base.__name__, {}).items()}
    defined = {name for base in foreign for name in (*vars(base), *vars(base).get("__annotations__", {}))}
    defined.update(getattr(instance, "__dict__", {}))
    for name in sorted(old.keys() & defined):
        raise RegistrationError(f"{what}: rename {name!r} of {plugin.__name__}, it is called {old[name]!r} now")


def warn_of_renamed_group(group: str, points: Iterable[EntryPoint]) -> None:
    """Warn of entry ``points`` that a package declares in the old group of ``group``, where they are ignored."""
    for point in points:
        warnings.warn(
            f"entry point {point.name} = {point.value!r} is ignored: its group {RENAMED_GROUPS[group]} is called "
            f"{group} now; rename it in the package that declares it",
            PluginWarning,
            stacklevel=3,
        )
