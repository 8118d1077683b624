"""Robots by name, or described by a TOML file."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from sysid_evo.errors import InvalidArgument
from sysid_evo.registry.kinds import robots
from sysid_evo.registry.spec import Spec

SUFFIX = ".toml"


def robot_spec(text: str) -> Spec:
    """Return the spec of ``NAME(parameter=value, ...)``, ``NAME:SEED``, or of a TOML file.

    The file names the registered robot as ``driver``; its other keys are that robot's parameters, and
    the robot is called as the file is. Raises `InvalidArgument`.
    """
    if text.endswith(SUFFIX):
        return _of_file(Path(text))
    return Spec.parse(text)


def make_robot(spec: str | Spec) -> Any:
    """Return the robot that ``spec`` names, see `robot_spec`; it is not connected yet.

    Raises `InvalidArgument`, also where somebody registered dynamics instead of a robot that has them.
    """
    from sysid_evo.dynamics import Dynamics

    found = robot_spec(spec) if isinstance(spec, str) else spec
    try:
        made = robots.make(found)
    except InvalidArgument as error:
        if isinstance(spec, str) and spec.endswith(SUFFIX):
            raise InvalidArgument(f"robot file {spec}: {error}") from error
        raise
    if isinstance(made, Dynamics):
        kind = type(made).__name__
        raise InvalidArgument(
            f"robot {found.name!r}: expected a robot, got the dynamics {kind}. Register a function that returns "
            f"SensedRobot({found.name!r}, {kind}()) of hardware.emulation.sensed_robot, or with a pose "
            f"ModelledRobot({found.name!r}, {kind}()) of hardware.emulation.modelled_robot"
        )
    return made


def _of_file(path: Path) -> Spec:
    try:
        arguments = tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InvalidArgument(f"robot file {path}: no such file") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InvalidArgument(f"robot file {path} is not TOML: {error}") from error
    driver = arguments.pop("driver", None)
    if not isinstance(driver, str):
        raise InvalidArgument(f'robot file {path}: expected driver = "NAME", one of {", ".join(robots.names())}')
    return Spec(driver, arguments, path.stem)
