"""One small class that finds things by name, whether this repository or a plugin brings them."""

from __future__ import annotations

import difflib
import importlib
import importlib.util
import re
import sys
import tomllib
import warnings
from collections.abc import Callable, Iterator, Mapping
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import MappingProxyType
from typing import Any, Generic, TypeVar

from packaging.requirements import Requirement

from sysid_evo.errors import InvalidArgument, MissingExtra, PluginError, PluginWarning, RegistrationError, UnknownName

T = TypeVar("T")


class Registry(Generic[T]):
    """Names of one kind of thing, from decorators and from the entry points of one group.

    An entry point names a module; importing it runs the decorator. Modules are imported only when
    one of their names is asked for.
    """

    def __init__(self, kind: str, group: str) -> None:
        self.kind = kind
        self.group = group
        self._entries: dict[str, Callable[..., T]] = {}

    def register(self, name: str) -> Callable[[Callable[..., T]], Callable[..., T]]:
        """Return a decorator that files a class or a factory under ``name``."""

        def decorate(factory: Callable[..., T]) -> Callable[..., T]:
            known = self._entries.get(name)
            if known is not None and _identity(known) != _identity(factory):
                raise RegistrationError(
                    f"{self.kind} {name!r} is registered twice: by {_identity(known)} and by {_identity(factory)}"
                )
            self._entries[name] = factory
            return factory

        return decorate

    def names(self) -> tuple[str, ...]:
        """Return every known name, sorted; nothing is imported."""
        return tuple(sorted({*self._entries, *self._points()}))

    @property
    def loaded(self) -> Mapping[str, Callable[..., T]]:
        """The names whose module has been imported, with their classes or factories."""
        return MappingProxyType(self._entries)

    def get(self, name: str) -> Callable[..., T]:
        """Return the class or factory called ``name``, importing its module if need be.

        Raises `UnknownName`, `PluginError` (its module is broken), `MissingExtra` (an optional
        package is not installed) or `RegistrationError` (the module registers another name).
        """
        if name not in self._entries:
            point = self._point(name)
            _load(point, self.kind)
            if name not in self._entries:
                came = sorted(entry for entry, thing in self._entries.items() if thing.__module__ == point.module)
                raise RegistrationError(
                    f"entry point {self.group}: {name} = {point.value!r} should register {name!r}, "
                    f"but the module registers {', '.join(map(repr, came)) or 'nothing'}. "
                    "Use the same name in the decorator and in the entry point."
                )
        return self._entries[name]

    def make(self, name: str, /, **parameters: Any) -> T:
        """Return a new instance of ``name`` built with these parameters."""
        return self.get(name)(**parameters)

    def load_all(self) -> Iterator[tuple[str, Callable[..., T]]]:
        """Yield every name that can be loaded; each broken plugin gives one `PluginWarning`."""
        for name in self.names():
            try:
                yield name, self.get(name)
            except (PluginError, RegistrationError) as error:
                warnings.warn(f"{self.kind} {name!r} left out: {error}", PluginWarning, stacklevel=2)

    def _points(self) -> dict[str, EntryPoint]:
        return {point.name: point for point in entry_points(group=self.group)}

    def _point(self, name: str) -> EntryPoint:
        found = {point.value: point for point in entry_points(group=self.group, name=name)}
        if not found:
            raise UnknownName(self._unknown(name))
        if len(found) > 1:
            raise RegistrationError(
                f"{self.kind} {name!r} is registered twice: by {' and by '.join(sorted(found))}; uninstall one"
            )
        return next(iter(found.values()))

    def _unknown(self, name: str) -> str:
        close = difflib.get_close_matches(name, self.names(), n=1)
        hint = f" Did you mean {close[0]!r}?" if close else ""
        known = ", ".join(self.names()) or "none"
        return f"no {self.kind} is called {name!r}.{hint} Known: {known}."


def _identity(thing: Any) -> str:
    return f"{getattr(thing, '__module__', '?')}.{getattr(thing, '__qualname__', repr(thing))}"


def _load(point: EntryPoint, kind: str) -> None:
    try:
        point.load()
    except ModuleNotFoundError as error:
        extra = _extra_of(point, error.name or "")
        if extra is None:
            raise PluginError(f"{kind} {point.name!r} ({point.value}) cannot be imported: {error}") from error
        raise MissingExtra(
            f"{kind} {point.name!r} needs the package {error.name!r}, which is not installed. "
            f'Install it with: pip install "{extra}"'
        ) from error
    except Exception as error:  # a plugin may fail in any way while it is imported
        raise PluginError(
            f"{kind} {point.name!r} ({point.value}) cannot be imported: {type(error).__name__}: {error}"
        ) from error


def _extra_of(point: EntryPoint, module: str) -> str | None:
    """Return ``distribution[extra]`` for the extra that brings ``module``, if there is one."""
    if point.dist is None:
        return None
    for text in point.dist.requires or []:
        requirement = Requirement(text)
        found = re.search(r"extra == ['\"]([^'\"]+)['\"]", str(requirement.marker or ""))
        if found and requirement.name.replace("-", "_").lower() == module.split(".")[0].lower():
            return f"{point.dist.name}[{found.group(1)}]"
    return None


def load_plugin(path: str | Path) -> None:
    """Import a plugin file that is not installed, so that its decorators run.

    Raises `PluginError` if the file is missing or fails while it is imported.
    """
    path = Path(path).resolve()
    name = f"sysid_evo_plugin_{path.stem}"
    loaded = sys.modules.get(name)
    if loaded is not None:
        if loaded.__file__ != str(path):
            raise PluginError(
                f"plugin {path}: {loaded.__file__}, a file of the same name, is loaded already; rename one"
            )
        return
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None or not path.is_file():
        raise PluginError(f"plugin {path}: expected a Python file, found none")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except Exception as error:  # a plugin may fail in any way while it is imported
        del sys.modules[name]
        raise PluginError(f"plugin {path} cannot be imported: {type(error).__name__}: {error}") from error


models: Registry[Any] = Registry("model", "sysid_evo.models")
tasks: Registry[Any] = Registry("task", "sysid_evo.tasks")
controllers: Registry[Any] = Registry("controller", "sysid_evo.controllers")
strategies: Registry[Any] = Registry("strategy", "sysid_evo.strategies")
robots: Registry[Any] = Registry("robot", "sysid_evo.robots")
trackers: Registry[Any] = Registry("tracker", "sysid_evo.trackers")
readers: Registry[Any] = Registry("reader", "sysid_evo.readers")
motions: Registry[Any] = Registry("motion", "sysid_evo.motions")

register_model = models.register
register_task = tasks.register
register_controller = controllers.register
register_strategy = strategies.register
register_robot = robots.register
register_tracker = trackers.register
register_reader = readers.register
register_motion = motions.register

make_model = models.make
make_task = tasks.make
make_controller = controllers.make
make_strategy = strategies.make


def make_robot(spec: str) -> Any:
    """Return the robot that ``spec`` names: ``name``, ``name:SEED`` for one with drawn parameters, or a TOML file.

    The file names the registered robot as ``driver``; its other keys are that robot's arguments.
    """
    if spec.endswith(".toml"):
        return _robot_of_file(Path(spec))
    name, separator, seed = spec.partition(":")
    if not separator:
        return robots.make(name)
    if not seed.isdecimal():
        raise UnknownName(f"robot {spec!r}: expected name or name:SEED with a whole number, got {seed!r}")
    return robots.make(name, seed=int(seed))


def _robot_of_file(path: Path) -> Any:
    try:
        arguments = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InvalidArgument(f"robot file {path}: no such file") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InvalidArgument(f"robot file {path} is not TOML: {error}") from error
    driver = arguments.pop("driver", None)
    if not isinstance(driver, str):
        raise InvalidArgument(f'robot file {path}: expected driver = "NAME", one of {", ".join(robots.names())}')
    try:
        return robots.make(driver, **arguments)
    except TypeError as error:
        raise InvalidArgument(f"robot file {path}: {error}") from error
