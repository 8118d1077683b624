"""`sysid-evo tune`: the search for the parameters of a family."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sysid_evo.cli import INTERRUPTED
from sysid_evo.cli.console import out, tell
from sysid_evo.cli.options import Columns, Json, Out, Plugins, Seed, listed, load_plugins

if TYPE_CHECKING:
    from sysid_evo.tuning import Tuning

FILE = "tune.journal"
SHOWN = 8
UNITS = {"": 1.0, "s": 1.0, "m": 60.0, "h": 3600.0}


def tune(
    family: Annotated[str, typer.Argument(help="NAME(parameter=value, ...); what stands there is kept as it is.")],
    data: Annotated[list[Path], typer.Option(help="Logs, folders of logs, or a folder written by import; repeatable.")],
    budget: Annotated[str, typer.Option(help="How long to search, such as 90s, 5m or 1h.")] = "5m",
    trials: Annotated[int | None, typer.Option(min=1, help="How many to try, instead of a budget of time.")] = None,
    horizon: Annotated[
        list[int] | None,
        typer.Option(min=1, help="Steps of a free run after which it counts (one second); repeatable."),
    ] = None,
    only: Annotated[str | None, typer.Option(help="The parameters to search, separated by commas.")] = None,
    seed: Seed = None,
    folder: Out = None,
    columns: Columns = None,
    plugin: Plugins = None,
    as_json: Json = False,
) -> None:
    """Search for the parameters with which a family runs free best on recordings held out.

    Every trial is kept in the run folder; the same command with the same --out goes on.
    """
    from evaluation.comparison import check_run_folder
    from sysid_evo.cli.comparing import existing
    from sysid_evo.cli.progress import Bars
    from sysid_evo.data import Dataset
    from sysid_evo.tuning import Tuning

    load_plugins(plugin)
    seconds = None if trials is not None else seconds_of(budget)
    dataset = Dataset.read(data, columns=None if columns is None else existing(columns))
    path = folder if folder is not None and (folder / FILE).is_file() else check_run_folder(folder)
    search = Tuning(family, dataset, horizons=horizon, only=listed("--only", only), seed=seed or 0, file=path / FILE)
    interrupted = False
    with Bars() as bars:
        bars.begin(f"tune {search.spec.name}")
        try:
            for _ in search.run(seconds=seconds, trials=trials, progress=bars.advance):
                pass
        except KeyboardInterrupt:
            interrupted = True
    if interrupted:
        tell(f"interrupted: the trials that had ended are kept; go on with --out {path}")
    if as_json:
        out.print_json(json.dumps(document(search)))
    else:
        print_search(search)
    if interrupted:
        raise typer.Exit(INTERRUPTED)


def seconds_of(text: str) -> float:
    """Return a time such as ``5m`` in seconds. Raises `InvalidArgument`."""
    from sysid_evo.errors import InvalidArgument

    found = re.fullmatch(r"(\d+(?:\.\d+)?)\s*([smh]?)", text.strip())
    if found is None or float(found[1]) <= 0.0:
        raise InvalidArgument(f"--budget: expected a time such as 90s, 5m or 1h, got {text!r}")
    return float(found[1]) * UNITS[found[2]]


def document(search: Tuning) -> dict[str, Any]:
    """Return what was found as strict JSON."""
    return {
        "best": search.best.spec.text,
        "error": search.best.error,
        "horizons": list(search.horizons),
        "importance": search.importance,
        "trials": [
            {"spec": one.spec.text, "error": one.error, "seconds": one.seconds, "reason": one.reason}
            for one in search.tried
        ],
    }


def print_search(search: Tuning) -> None:
    """Print the best trials, what decides, and the line to use."""
    from rich.table import Table
    from rich.text import Text

    best, tried = search.best, search.tried
    table = Table(box=None, pad_edge=False)
    for heading in ("error", "seconds", "parameters"):
        table.add_column(heading, justify="left" if heading == "parameters" else "right", overflow="fold")
    for one in tried[:SHOWN]:
        if one.error is not None:
            settings = ", ".join(f"{key}={value}" for key, value in one.spec.parameters.items())
            table.add_row(f"{one.error:.4f}", f"{one.seconds:.1f}", Text(settings))
    out.print(table)
    steps = ", ".join(map(str, search.horizons))
    out.print(Text(f"{len(tried)} trials; error of free runs after {steps} steps on what was held out"))
    if search.importance:
        shares = ", ".join(f"{key} {100.0 * share:.0f} %" for key, share in search.importance.items())
        out.print(Text(f"What decides: {shares}"))
    for reason in dict.fromkeys(one.reason for one in tried if one.error is None and one.reason != "broken off"):
        tell(f"a trial failed: {reason}", label="note: ", style="dim")
    out.print(best.spec.text, highlight=False, markup=False, soft_wrap=True)
