"""`sysid-evo drive`: a controller on a robot."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from sysid_evo.cli.options import Plugins, load_plugins


def drive(
    controller: Annotated[Path, typer.Option(help="File of an evolved controller.", show_default=False)],
    robot: Annotated[str, typer.Option(help="Registered robot, NAME:SEED, or a TOML file.", show_default=False)],
    trials: Annotated[int, typer.Option(min=1, help="Of the task that it was evolved for.")] = 10,
    run: Annotated[
        Path | None, typer.Option(help="Run folder whose matrix gets the result (default: the controller's own).")
    ] = None,
    tracker_origin: Annotated[
        bool, typer.Option("--tracker-origin", help="The arena lies around the tracker's origin, not around the start.")
    ] = False,
    seed: Annotated[int | None, typer.Option(min=0, help="Of the trials (default: the run's).")] = None,
    plugin: Plugins = None,
) -> None:
    """Run a controller on a robot, and append what it achieves to the transfer matrix of its run.

    The exit code says why the trials ended: 0 as they should; 10 link lost, 11 tracker lost, 12 the robot
    stopped itself, 13 the control was not a number, 14 a thread died, 15 the robot does not come to rest;
    129, 130, 143 for SIGHUP, SIGINT, SIGTERM.
    """
    from sysid_evo.cli.achieving import drive_controller

    load_plugins(plugin)
    code = drive_controller(controller, robot, trials=trials, folder=run, seed=seed, tracker_origin=tracker_origin)
    if code:
        raise typer.Exit(code)
