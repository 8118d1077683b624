"""`sysid-evo robots`: which there are, and whether one is ready to drive."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import Annotated

import typer

from sysid_evo.cli.console import err, out
from sysid_evo.cli.exits import ROBOT, code_of_loop
from sysid_evo.cli.options import Json, Plugins, load_plugins

app = typer.Typer(help="Robots, physical and emulated.", no_args_is_help=True)


@app.command("list")
def list_robots(plugin: Plugins = None, as_json: Json = False) -> None:
    """List every robot driver that can be loaded; a TOML file with `driver = "NAME"` describes a robot of your own."""
    from rich.table import Table

    from sysid_evo.registry import robots

    load_plugins(plugin)
    rows = []
    for name, factory in robots.load_all():
        summary = (factory.__doc__ or "").strip().splitlines() or [""]
        rows.append({"name": name, "summary": summary[0]})
    if as_json:
        out.print_json(json.dumps(rows))
        return
    table = Table(box=None, pad_edge=False)
    table.add_column("robot", no_wrap=True)
    table.add_column("what it is")
    for row in rows:
        table.add_row(row["name"], row["summary"])
    out.print(table)


@app.command("check")
def check_robot(
    robot: Annotated[str, typer.Argument(help="Robot, NAME(parameter=value, ...), or a TOML file.")],
    seconds: Annotated[float, typer.Option(min=0.5, help="How long to look.")] = 3.0,
    plugin: Plugins = None,
    as_json: Json = False,
) -> None:
    """Connect to a robot and look at link, tracker and loop, without moving it.

    Of one that has no pose, such as equations of your own or an environment, sensors and answers are looked at.
    Exit code 4 if something is not as it should be.
    """
    from rich.text import Text

    from hardware.loop.stops import Stops
    from hardware.robot import find_robot

    load_plugins(plugin)
    machine = find_robot(robot)
    with Stops() as stops:
        findings = machine.look_at(seconds=seconds, stops=stops)
    if as_json:
        out.print_json(json.dumps([asdict(finding) for finding in findings]))
    else:
        for finding in findings:
            word = ("ok    ", "green") if finding.ok else ("wrong ", "red")
            out.print(Text.assemble(word, (f"{finding.what}: ", "bold"), finding.sentence))
    if stops.reason is not None:
        err.print(stops.reason.sentence)
        raise typer.Exit(code_of_loop(stops.reason))
    if not all(finding.ok for finding in findings):
        raise typer.Exit(ROBOT)
