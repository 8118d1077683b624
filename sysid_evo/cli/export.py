"""Export: a controller as one file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import evaluation
import sysid_evo.export
from sysid_evo.cli.console import print_line
from sysid_evo.cli.options import Plugins, argument, load_plugins, option
from sysid_evo.errors import InvalidArgument
from sysid_evo.files import write_atomically

SUFFIXES = {"python": ".py", "c": ".c"}
REALS = ("double", "float")


def export(
    controller: Annotated[Path, argument("File of an evolved controller: RUN/controllers/NAME", "CONTROLLER")],
    to: Annotated[str, option("python (NumPy only) or c (C99 without allocation)", "NAME", panel="File",
        values=lambda: SUFFIXES)],
    file: Annotated[Path | None, option("File to write", "FILE", "--out", panel="File",
        shown="NAME with its suffix")] = None,
    name: Annotated[str | None, option("Name of the controller in the file", "NAME", panel="File",
        shown="its own name")] = None,
    real: Annotated[str, option("Precision of C: double or float", "NAME", panel="File", shown="double",
        values=lambda: REALS)] = "double",
    plugin: Plugins = None,
) -> None:  # fmt: skip
    """Write a controller as a Python or C file.

    The file computes controls from observations. Its head states inputs, outputs, units and sampling time, and how to
    use and check it.
    """
    load_plugins(plugin)
    if to not in SUFFIXES:
        raise InvalidArgument(f"--to: expected {', '.join(SUFFIXES)}, got {to!r}")
    if real not in REALS:
        raise InvalidArgument(f"--real: expected {' or '.join(REALS)}, got {real!r}")
    # a copy of another file, to be used under this name
    chosen = evaluation.CHOSEN if controller.stem == evaluation.CHOSEN else ""
    law = replace(sysid_evo.export.exported_controller(sysid_evo.load_champion(controller)), called=name or chosen)
    path = file or Path(f"{law.name}{SUFFIXES[to]}")
    if path.exists():
        raise InvalidArgument(f"--out: {path} exists already; remove it, or name another file")
    precision: sysid_evo.export.Real = "float" if real == "float" else "double"
    text = sysid_evo.export.python_text(law) if to == "python" else sysid_evo.export.c_text(law, precision, path.name)
    write_atomically(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))
    for line in (f"{law.champion.name} written to {path}", *how_to_use(law, to, path)):
        print_line(line)


def how_to_use(law: sysid_evo.export.ExportedController, to: str, path: Path) -> tuple[str, ...]:
    """Return the inputs and outputs of the file and how to call it, in a few lines."""
    seen = ", ".join(f"{c.name} ({c.unit})" if c.unit else c.name for c in law.observations)
    every = f"every {law.system.dt:g} s, from {seen} to {', '.join(law.system.control_names)}"
    if to == "python" and law.raw is not None:
        return (
            f"use:   from {path.stem} import Controller; controller = Controller(); env.step(controller(observation)), "
            "from the raw observation of the environment to its raw action",
            f"check: python {path}",
        )
    if to == "python":
        return (
            f"use:   from {path.stem} import Controller; control = Controller().step(observation), {every}",
            f"check: python {path}",
        )
    return (
        f"use:   {law.name}_reset(&memory), then {law.name}_step(&memory, observation, control) {every}",
        f"check: cc -std=c99 -DTEST_{law.name.upper()} {path} -lm -o check && ./check",
    )
