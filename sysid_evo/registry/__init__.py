"""Registries of named things, the grammar of their specifications, plugin files."""

from sysid_evo.registry.grammar import Spec, check_labels
from sysid_evo.registry.plugins import load_named_plugins, load_plugin, load_plugins_again, loaded_plugins
from sysid_evo.registry.registry import (
    Registry,
    aggregates,
    controllers,
    make_robot,
    models,
    probes,
    register_probe,
    register_reader,
    register_robot,
    register_task,
    register_tracker,
    robot_spec,
    robots,
    strategies,
    tasks,
    trackers,
)

__all__ = [
    "Registry",
    "Spec",
    "aggregates",
    "check_labels",
    "controllers",
    "load_named_plugins",
    "load_plugin",
    "load_plugins_again",
    "loaded_plugins",
    "make_robot",
    "models",
    "probes",
    "register_probe",
    "register_reader",
    "register_robot",
    "register_task",
    "register_tracker",
    "robot_spec",
    "robots",
    "strategies",
    "tasks",
    "trackers",
]
