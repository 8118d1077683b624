"""Registries that find things by name: the class, the twelve registries, robots by name or file."""

from __future__ import annotations

import importlib.util
import inspect
import math
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from functools import cache
from importlib.metadata import Distribution, EntryPoint, entry_points
from pathlib import Path
from types import MappingProxyType
from typing import Any, Generic, TypeVar

from sysid_evo.errors import (
    InvalidArgument,
    MissingExtra,
    PluginError,
    PluginWarning,
    RegistrationError,
    UnknownName,
    did_you_mean,
)
from sysid_evo.extras import DISTRIBUTION, extra_of, missing_extra
from sysid_evo.files import file_digest, parsed_toml
from sysid_evo.registry.grammar import Spec
from sysid_evo.registry.objects import is_object_text
from sysid_evo.registry.plugins import SHIPPED, declared, named_in_plugin, source_digest

T = TypeVar("T")
V = TypeVar("V")
F = TypeVar("F", bound=Callable[..., Any])


class Registry(Generic[T]):
    """Registered classes and factories of one kind, from decorators and from the entry points of one group.

    An entry point names a module; importing it runs the decorator. Modules are imported only when
    one of their names is needed. ``given`` are parameters that the caller passes to the constructor, so that they
    never appear in a spec.
    """

    def __init__(self, kind: str, group: str, *, given: frozenset[str] = frozenset()) -> None:
        self.kind = kind
        self.group = group
        self.given = given
        self._entries: dict[str, Callable[..., T]] = {}

    def register(self, name: str) -> Callable[[F], F]:
        """Return a decorator that registers a class or a factory as ``name``.

        Raises `RegistrationError`, with both modules, if the name is in use.
        """

        def decorate(factory: F) -> F:
            lacking = sorted(getattr(factory, "__abstractmethods__", ()))
            if lacking:
                raise RegistrationError(
                    f"{self.kind} {name!r}: {_identity(factory)} does not define {', '.join(lacking)}, required of "
                    f"every {self.kind}"
                )
            known = self._entries.get(name)
            if known is not None and _identity(known) != _identity(factory):
                raise RegistrationError(
                    f"{self.kind} {name!r} is registered twice: by {_identity(known)} and by {_identity(factory)}. "
                    "Give one of them another name"
                )
            owners = [point.value for point in self._points(name) if point.value != factory.__module__]
            if owners:
                raise RegistrationError(
                    f"{self.kind} {name!r} is registered twice: by {owners[0]} and by {_identity(factory)}. "
                    "Give the second another name"
                )
            self._entries[name] = factory
            return factory

        return decorate

    def forget(self, name: str) -> None:
        """Undo `register` for ``name``; names from entry points, and imported modules, remain."""
        self._entries.pop(name, None)

    def names(self) -> tuple[str, ...]:
        """Return all names, sorted; nothing is imported."""
        return tuple(sorted({*self._entries, *(point.name for point in self._points())}))

    @property
    def loaded(self) -> Mapping[str, Callable[..., T]]:
        """The classes and factories of all imported modules, by name."""
        return MappingProxyType(self._entries)

    def module(self, name: str) -> str:
        """Return the module that registers ``name``; nothing is imported. Raises `UnknownName`."""
        if name in self._entries:
            return self._entries[name].__module__
        return self._point(name).value

    def get(self, name: str) -> Callable[..., T]:
        """Return the class or factory registered as ``name``, importing its module if necessary.

        Raises `UnknownName`, `PluginError` (its module is broken), `MissingExtra` (an optional
        package is not installed) or `RegistrationError` (the module registers another name).
        """
        if name not in self._entries:
            point = self._point(name)
            _load(point, self.kind)
            if name not in self._entries:
                found = sorted(entry for entry, thing in self._entries.items() if thing.__module__ == point.module)
                raise RegistrationError(
                    f"entry point {self.group}: {name} = {point.value!r} should register {name!r}, "
                    f"but the module registers {', '.join(map(repr, found)) or 'nothing'}. "
                    "Use the same name in the decorator and in the entry point."
                )
        return self._entries[name]

    def make(self, spec: str | Spec, /, **parameters: Any) -> T:
        """Return a new instance of the class that ``spec`` names, with its parameters and ``parameters``.

        Raises the errors of `get`, `check` and the constructor.
        """
        found = self.check(spec, **parameters)
        return self.get(found.name)(**found.parameters)

    def check(self, spec: str | Spec, /, **parameters: Any) -> Spec:
        """Return the spec with ``parameters`` added, if its name is known and the constructor has all parameters.

        Raises `UnknownName`, or `InvalidArgument` that lists the valid parameters.
        """
        found = Spec.parse(spec) if isinstance(spec, str) else spec
        found = Spec(found.name, {**found.parameters, **parameters}, found.label)
        factory = self.get(found.name)
        known = self.parameters(found.name)
        for name in found.parameters:
            if name not in known and None not in known:
                raise InvalidArgument(self._no_parameter(found.name, name, known))
        signature = _signature(factory)
        needed = [
            name
            for name, parameter in signature.items()
            if parameter.default is parameter.empty and parameter.kind not in _VARIABLE
        ]
        lacking = [name for name in needed if name not in found.parameters and name not in self.given]
        if lacking:
            raise InvalidArgument(
                f"{self.kind} {found.name!r} needs {', '.join(lacking)}: {found.name}({lacking[0]}=...)"
            )
        return found

    def parameters(self, name: str) -> Mapping[str | None, Any]:
        """Return the parameters that a spec of ``name`` may set, with their defaults (key None: any name)."""
        found: dict[str | None, Any] = {}
        for parameter in _signature(self.get(name)).values():
            if parameter.kind is parameter.VAR_KEYWORD:
                found[None] = None
            elif parameter.kind is not parameter.VAR_POSITIONAL:
                found[parameter.name] = parameter.default
        return found

    def identity(self, spec: str | Spec) -> dict[str, Any]:
        """Return name, all parameters and source digest of ``spec`` as strict JSON; they determine what it makes."""
        found = self.check(spec)
        defaults = {key: value for key, value in self.parameters(found.name).items() if key not in self.given}
        parameters: dict[str | None, Any] = defaults
        parameters.update(found.parameters.items())
        return {
            "name": found.name,
            "parameters": {str(key): _plain(value) for key, value in parameters.items() if key is not None},
            "source": source_digest(self.get(found.name)),
            **self._files(found.name, parameters),
            **self._named_in_plugins(found.name, parameters),
        }

    def _files(self, name: str, parameters: Mapping[str | None, Any]) -> dict[str, Any]:
        """Return the digests of the files that parameters name, which a class lists in ``file_parameters``."""
        named = getattr(self.get(name), "file_parameters", ())
        return {"files": {key: file_digest(str(parameters[key])) for key in named}} if named else {}

    def _named_in_plugins(self, name: str, parameters: Mapping[str | None, Any]) -> dict[str, Any]:
        """Return the digests of the plugins whose definitions parameters name, see ``plugin_parameters`` of a class."""
        texts = {key: parameters[key] for key in getattr(self.get(name), "plugin_parameters", ())}
        found = {}
        for key, text in texts.items():
            if isinstance(text, str) and not is_object_text(text):
                with suppress(InvalidArgument):  # the name of something else, or refused by the class
                    found[key] = source_digest(named_in_plugin(text, object))
        return {"plugins": found} if found else {}

    def missing_package(self, name: str) -> MissingExtra | None:
        """Return the error for an optional package that ``name`` needs and that is not installed; None without one.

        Classes list lazily imported packages in ``requires``. Raises the other errors of `get`.
        """
        try:
            requires = self.glance(name, "requires") or ()
        except MissingExtra as error:
            return error
        for module in requires:
            if importlib.util.find_spec(module) is None:
                points = self._points(name)
                distribution = _distribution(points[0]) if points else DISTRIBUTION
                return missing_extra(f"{self.kind} {name!r}", module, distribution)
        return None

    def load_all(self) -> Iterator[tuple[str, Callable[..., T]]]:
        """Yield every name that can be loaded, with its class; each broken plugin gives one `PluginWarning`."""
        return self.each(self.get)

    def each(self, look: Callable[[str], V]) -> Iterator[tuple[str, V]]:
        """Yield every name with ``look(name)``; each broken plugin gives one `PluginWarning`."""
        for name in self.names():
            try:
                yield name, look(name)
            except (PluginError, RegistrationError) as error:
                warnings.warn(f"{self.kind} {name!r} left out: {error}", PluginWarning, stacklevel=2)

    def glance(self, name: str, attribute: str = "__doc__") -> Any:
        """Return an attribute of the class or factory ``name``, None if it has none. Raises the errors of `get`.

        Shipped classes are not imported for this, so the attribute must be defined in the class body itself.
        """
        if name not in self._entries and (module := self._point(name).value).split(".")[0] in SHIPPED:
            found = declared(module, name)
            if found is not None:
                return found.get(attribute)
        return getattr(self.get(name), attribute, None)

    def summary(self, name: str) -> str:
        """Return the first line of the docstring of the class or factory ``name``, as plain text."""
        return str(self.glance(name) or "").strip().partition("\n")[0].replace("`", "")

    def _points(self, name: str | None = None) -> list[EntryPoint]:
        found = _installed(tuple(sys.path)).select(group=self.group)
        return [point for point in found if name in (None, point.name)]

    def _point(self, name: str) -> EntryPoint:
        found = {point.value: point for point in self._points(name)}
        if not found:
            raise UnknownName(self._unknown(name))
        if len(found) > 1:
            raise RegistrationError(
                f"{self.kind} {name!r} is registered twice: by {' and by '.join(sorted(found))}; uninstall one"
            )
        return next(iter(found.values()))

    def _unknown(self, name: str) -> str:
        known = ", ".join(self.names()) or "none"
        return (
            f"no {self.kind} is called {name!r}.{did_you_mean(name, self.names())} Known: {known}. "
            "If it is defined in your own file, add --plugin FILE (in Python load_plugin)."
        )

    def _no_parameter(self, name: str, wrong: str, known: Mapping[str | None, Any]) -> str:
        usable = {str(key): value for key, value in known.items() if key not in self.given}
        takes = ", ".join(
            key if value is inspect.Parameter.empty else f"{key} ({value!r})" for key, value in usable.items()
        )
        return (
            f"{self.kind} {name!r} has no parameter {wrong!r}.{did_you_mean(wrong, usable)} It takes {takes or 'none'}."
        )


_VARIABLE = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)


@cache
def _installed(
    _path: tuple[str, ...],
) -> Any:  # EntryPoints; in Python 3.11 SelectableGroups, which has the same select()
    """Return all entry points along ``sys.path``; cached, because this takes 10 ms or more."""
    return entry_points()


@cache
def _signature(factory: Callable[..., Any]) -> Mapping[str, inspect.Parameter]:
    return inspect.signature(factory).parameters


def _plain(value: Any) -> Any:
    """Return ``value`` as strict JSON; values that JSON cannot hold become text."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if value is None or isinstance(value, (bool, int, str)) or (isinstance(value, float) and math.isfinite(value)):
        return value
    return repr(value)


def _identity(thing: Any) -> str:
    return f"{getattr(thing, '__module__', '?')}.{getattr(thing, '__qualname__', repr(thing))}"


def _load(point: EntryPoint, kind: str) -> None:
    try:
        point.load()
    except ModuleNotFoundError as error:
        if extra_of(error.name or "", _distribution(point)) is None:
            raise PluginError(f"{kind} {point.name!r} ({point.value}) cannot be imported: {error}") from error
        raise missing_extra(f"{kind} {point.name!r}", error.name, _distribution(point)) from error
    except RegistrationError:
        raise
    except Exception as error:  # a plugin may fail in any way while it is imported
        raise PluginError(
            f"{kind} {point.name!r} ({point.value}) cannot be imported: {type(error).__name__}: {error}"
        ) from error


def _distribution(point: EntryPoint) -> str | Distribution:
    return DISTRIBUTION if point.dist is None else point.dist


# The registry knows no classes, because the modules of base classes import it. Functions that return an instance of a
# certain type, such as `sysid_evo.models.base.make_model`, are therefore defined next to the base classes.

models: Registry[Any] = Registry("model", "sysid_evo.models")
tasks: Registry[Any] = Registry("task", "sysid_evo.tasks")
controllers: Registry[Any] = Registry("controller", "sysid_evo.controllers")
strategies: Registry[Any] = Registry("strategy", "sysid_evo.strategies", given=frozenset({"n_parameters", "seed"}))
aggregates: Registry[Any] = Registry("aggregate", "sysid_evo.aggregates", given=frozenset({"fitness"}))
robots: Registry[Any] = Registry("robot", "sysid_evo.robots")
trackers: Registry[Any] = Registry("tracker", "sysid_evo.trackers")
readers: Registry[Any] = Registry("reader", "sysid_evo.readers")
probes: Registry[Any] = Registry("probe", "sysid_evo.probes")
motions: Registry[Any] = Registry("motion", "sysid_evo.motions")
noises: Registry[Any] = Registry("noise", "sysid_evo.noises")
"""Names for ``--noise``."""
adapters: Registry[Any] = Registry("adapter", "sysid_evo.adapters")
"""Types of objects that are models, see `sysid_evo.models.adapters`."""

KINDS: dict[str, Registry[Any]] = {
    registry.kind: registry
    for registry in (
        models, tasks, controllers, strategies, aggregates, robots, trackers, readers, probes, motions, noises,
        adapters,
    )
}  # fmt: skip
"""The kinds that ``sysid-evo names`` lists."""

register_model = models.register
register_task = tasks.register
register_controller = controllers.register
register_strategy = strategies.register
register_aggregate = aggregates.register
register_robot = robots.register
register_tracker = trackers.register
register_reader = readers.register
register_probe = probes.register
register_motion = motions.register
register_adapter = adapters.register

SUFFIX = ".toml"


def robot_spec(text: str) -> Spec:
    """Return the spec of ``NAME(parameter=value, ...)``, ``NAME:SEED``, or of a TOML file.

    The file names the registered robot as ``driver``; its other keys are that robot's parameters. The label is the
    name of the file. Raises `InvalidArgument`.
    """
    if text.endswith(SUFFIX):
        return _of_file(Path(text))
    return Spec.parse(text)


def make_robot(spec: str | Spec) -> Any:
    """Return the robot that ``spec`` names, see `robot_spec`; it is not connected yet.

    Raises `InvalidArgument`, also if dynamics are registered instead of a robot.
    """
    found = robot_spec(spec) if isinstance(spec, str) else spec
    try:
        made = robots.make(found)
    except InvalidArgument as error:
        if isinstance(spec, str) and spec.endswith(SUFFIX):
            raise InvalidArgument(f"robot file {spec}: {error}") from error
        raise
    if hasattr(made, "step") and not hasattr(made, "connect"):
        kind = type(made).__name__
        raise InvalidArgument(
            f"robot {found.name!r}: expected a robot, got the dynamics {kind}. Register a function that returns "
            f"SensedRobot({found.name!r}, {kind}()) of hardware.emulation.sensed_robot, or with a pose "
            f"ModelRobot({found.name!r}, {kind}()) of hardware.emulation.tracked_robots"
        )
    return made


def _of_file(path: Path) -> Spec:
    try:
        arguments = parsed_toml(path.read_text(encoding="utf-8-sig"))
    except FileNotFoundError:
        raise InvalidArgument(f"robot file {path}: no such file") from None
    except ValueError as error:
        raise InvalidArgument(f"robot file {path} is not TOML: {error}") from error
    driver = arguments.pop("driver", None)
    if not isinstance(driver, str):
        raise InvalidArgument(f'robot file {path}: expected driver = "NAME", one of {", ".join(robots.names())}')
    return Spec(driver, arguments, path.stem)
