"""Export: a controller as one file. The other commands on controllers do not load what writes it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from evaluation.run_folder import CHOSEN
from sysid_evo.cli.console import say
from sysid_evo.cli.options import Plugins, load_plugins
from sysid_evo.errors import InvalidArgument
from sysid_evo.evolution.champion import load_champion
from sysid_evo.export.c_file import c_text
from sysid_evo.export.exported_controller import ExportedController, Real, exported_controller
from sysid_evo.export.onnx_file import onnx_bytes
from sysid_evo.export.python_file import python_text
from sysid_evo.files import write_atomically

SUFFIXES = {"python": ".py", "c": ".c", "onnx": ".onnx"}
REALS = ("double", "float")


def export(
    controller: Annotated[Path, typer.Argument(help="File of an evolved controller, as RUN/controllers/NAME.")],
    to: Annotated[str, typer.Option(help="python (NumPy only), c (C99 without allocation) or onnx.")],
    file: Annotated[Path | None, typer.Option("--out", help="New file (default: NAME with its suffix, here).")] = None,
    name: Annotated[str | None, typer.Option(help="What it is called in the file (default: its own name).")] = None,
    real: Annotated[str, typer.Option(help="Precision of C and ONNX: double or float.")] = "double",
    plugin: Plugins = None,
) -> None:
    """Write an evolved controller as one file: from its observations, in order, to legal controls.

    The file says what it expects, in which units, how often it is to be called, and how to use and check it.
    """
    load_plugins(plugin)
    if to not in SUFFIXES:
        raise InvalidArgument(f"--to: expected {', '.join(SUFFIXES)}, got {to!r}")
    if real not in REALS:
        raise InvalidArgument(f"--real: expected {' or '.join(REALS)}, got {real!r}")
    chosen = CHOSEN if controller.stem == CHOSEN else ""  # a copy of another file, to be used under this name
    law = replace(exported_controller(load_champion(controller)), called=name or chosen)
    path = file or Path(f"{law.name}{SUFFIXES[to]}")
    if path.exists():
        raise InvalidArgument(f"--out: {path} exists already; remove it, or name another file")
    precision: Real = "float" if real == "float" else "double"
    if to == "onnx":
        content = onnx_bytes(law, precision)
    else:
        content = (python_text(law) if to == "python" else c_text(law, precision, path.name)).encode()
    write_atomically(path, lambda temporary: temporary.write_bytes(content))
    for line in (f"{law.champion.name} written to {path}", *how_to_use(law, to, path)):
        say(line)


def how_to_use(law: ExportedController, to: str, path: Path) -> tuple[str, ...]:
    """Return in a few lines what the file takes and gives, and how to call it."""
    seen = ", ".join(f"{c.name} ({c.unit})" if c.unit else c.name for c in law.observations)
    every = f"every {law.system.dt:g} s, from {seen} to {', '.join(law.system.control_names)}"
    if to == "python":
        return (
            f"use:   from {path.stem} import Controller; control = Controller().step(observation), {every}",
            f"check: python {path}",
        )
    if to == "c":
        return (
            f"use:   {law.name}_reset(&memory), then {law.name}_step(&memory, observation, control) {every}",
            f"check: cc -std=c99 -DTEST_{law.name.upper()} {path} -lm -o check && ./check",
        )
    names = ", ".join(f"memory_{name}" for name in law.program.remembered) or "none"
    return (
        f"use:   inputs observation and memory ({names}; zeros at first), outputs control and the next memory, {every}",
    )
