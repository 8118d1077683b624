"""`sysid-evo fit` and `sysid-evo models`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from sysid_evo.cli.console import err, out
from sysid_evo.cli.options import Columns, Json, Plugins, Preset, Seed, Test, load_plugins, new_run_folder, split_names

app = typer.Typer(help="The model families.", no_args_is_help=True)


@app.command("list")
def list_models(plugin: Plugins = None, as_json: Json = False) -> None:
    """List every model family that can be loaded, with what it assumes."""
    from rich.table import Table

    from sysid_evo.registry import models

    load_plugins(plugin)
    rows = []
    for name, family in models.load_all():
        summary = (family.__doc__ or "").strip().splitlines() or [""]
        rows.append({"name": name, "knowledge": getattr(family, "knowledge", ""), "summary": summary[0]})
    if as_json:
        out.print_json(json.dumps(rows))
        return
    table = Table(box=None, pad_edge=False)
    table.add_column("family", no_wrap=True)
    table.add_column("assumes", no_wrap=True)
    table.add_column("what it is")
    for row in rows:
        table.add_row(row["name"], row["knowledge"], row["summary"])
    out.print(table)


@app.command("show")
def show_model(
    name: Annotated[str, typer.Argument(help="A family, or the file of a fitted model.")],
    plugin: Plugins = None,
    as_json: Json = False,
) -> None:
    """Show the card of a model family, or of a fitted model with its size, lags, training time and speed."""
    from sysid_evo.cli.cards import card_table, family_card, model_card
    from sysid_evo.registry import models

    load_plugins(plugin)
    stored = Path(name).suffix in (".json", ".safetensors") or Path(f"{name}.json").is_file()
    card = model_card(Path(name)) if stored and name not in models.names() else family_card(name)
    if as_json:
        out.print_json(json.dumps(card))
        return
    for part in card_table(card):
        out.print(part)


def fit(
    data: Annotated[Path, typer.Argument(help="Folder of logs, one log, or a folder written by import.")],
    models: Annotated[str, typer.Option(help="Families, separated by commas.")],
    test: Test = None,
    preset: Preset = "standard",
    seed: Seed = 0,
    run: Annotated[Path | None, typer.Option("--out", help="Run folder (default runs/<time>).")] = None,
    columns: Columns = None,
    plugin: Plugins = None,
) -> None:
    """Fit model families to recordings and store them in a run folder."""
    from rich.table import Table

    from sysid_evo.cli.progress import Bars
    from sysid_evo.data import Dataset
    from sysid_evo.experiment import fit_models
    from sysid_evo.store import RunFolder

    load_plugins(plugin)
    families = split_names(models)
    dataset = Dataset.read(data, columns=columns)
    train = dataset.split(test)[0] if test else dataset
    settings = {"command": "fit", "models": families, "preset": preset, "seed": seed, "data": train.fingerprint}
    folder = RunFolder.open(new_run_folder(run), settings)
    with Bars(folder.path) as bars:
        outcomes = fit_models(folder, families, train, seed=seed, preset=preset, observer=bars)
    table = Table(box=None, pad_edge=False)
    for heading in ("family", "seconds", "stored as"):
        table.add_column(heading, justify="right" if heading == "seconds" else "left")
    for family, outcome in outcomes.items():
        where = str(folder.model(family, seed)) if outcome.value is not None else f"failed: {outcome.reason}"
        table.add_row(family, f"{outcome.seconds:.1f}", where)
    out.print(table)
    err.print(f"evolve against them with: sysid-evo evolve --run {folder.path} --against {','.join(families)}")
    if any(outcome.value is None for outcome in outcomes.values()):
        raise typer.Exit(1)
