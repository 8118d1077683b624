"""`sysid-evo fit` and `sysid-evo models`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from sysid_evo.cli.console import out
from sysid_evo.cli.options import (
    Columns,
    DryRun,
    Jobs,
    Json,
    Out,
    Plugins,
    Preset,
    Scheduler,
    Seed,
    Test,
    given,
    listed,
    load_plugins,
)

app = typer.Typer(help="The model families.", no_args_is_help=True)
DEFAULT = "auto"
"""What is fitted where no family is named: who knows none yet has a choice made by the data."""


@app.command("list")
def list_models(plugin: Plugins = None, as_json: Json = False) -> None:
    """List every model family that can be loaded, with what it assumes."""
    from rich.table import Table
    from rich.text import Text

    from sysid_evo.registry import models

    load_plugins(plugin)
    rows: list[dict[str, str | None]] = []
    for name, family in models.load_all():
        summary = (family.__doc__ or "").strip().splitlines() or [""]
        lacking = models.lacking(name)
        rows.append(
            {
                "name": name,
                "knowledge": getattr(family, "knowledge", ""),
                "summary": summary[0],
                "lacking": None if lacking is None else str(lacking),
            }
        )
    if as_json:
        out.print_json(json.dumps(rows))
        return
    table = Table(box=None, pad_edge=False)
    table.add_column("family", no_wrap=True)
    table.add_column("assumes", no_wrap=True)
    table.add_column("what it is")
    for row in rows:
        table.add_row(row["name"], row["knowledge"], Text(row["summary"] or ""))
        if row["lacking"]:
            table.add_row("", "", Text(f"cannot run here: {row['lacking']}", style="yellow"))
    out.print(table)


@app.command("show")
def show_model(
    name: Annotated[str, typer.Argument(help="A family, or the file of a fitted model.")],
    plugin: Plugins = None,
    speed: Annotated[
        bool,
        typer.Option("--speed", help="Measure how fast a fitted model steps; compiling it may take half a minute."),
    ] = False,
    as_json: Json = False,
) -> None:
    """Show the card of a model family, or of a fitted model with its size, lags, training time and perhaps speed."""
    from sysid_evo.cli.cards import card_table, family_card, model_card
    from sysid_evo.registry import models
    from sysid_evo.store import is_stored

    load_plugins(plugin)
    stored = name not in models.names() and is_stored(name, "model")
    card = model_card(Path(name), measured=speed) if stored else family_card(name)
    if as_json:
        out.print_json(json.dumps(card))
        return
    for part in card_table(card):
        out.print(part)


def fit(
    data: Annotated[list[Path], typer.Argument(help="Logs, folders of logs, or a folder written by import.")],
    models: Annotated[
        str,
        typer.Option(
            help="Families, LABEL=NAME(parameter=value, ...), separated by commas. 'auto' tries the zoo on recordings "
            "held out and becomes the mean of what runs free best there."
        ),
    ] = DEFAULT,
    test: Test = None,
    preset: Preset = "standard",
    seed: Seed = None,
    folder: Out = None,
    columns: Columns = None,
    plugin: Plugins = None,
    jobs: Jobs = None,
    scheduler: Scheduler = None,
    dry_run: DryRun = False,
    as_json: Json = False,
) -> None:
    """Fit model families to recordings and store them in a run folder; without --models the best of the zoo (auto)."""
    from evaluation.comparison import Experiment
    from sysid_evo.cli.comparing import existing, run_experiment

    settings = given(
        data=tuple(str(path.resolve()) for path in data),
        test=None if test is None else tuple(test),
        models=listed("--models", models),
        preset=preset,
        seed=seed,
        columns=None if columns is None else existing(columns),
        plugins=None if plugin is None else tuple(str(path.resolve()) for path in plugin),
    )
    experiment = Experiment.of({**settings, "only": "fit"})
    run_experiment(experiment, folder, jobs=jobs, scheduler=scheduler, dry_run=dry_run, json=as_json, verbose=False)
