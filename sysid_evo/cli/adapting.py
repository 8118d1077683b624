"""`sysid-evo adapt`: a stored model and some seconds of another condition become a model of that."""

from __future__ import annotations

import json as json_format
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sysid_evo.cli.console import out, tell
from sysid_evo.cli.options import Columns, Json, Plugins, Seed, load_plugins

if TYPE_CHECKING:
    from sysid_evo.data import Dataset


SHOWN = 12
"""Ways to adapt that are printed, the best ones."""


def adapt(
    model: Annotated[Path, typer.Argument(help="File of a fitted model, as RUN/models/NAME.", show_default=False)],
    data: Annotated[
        list[Path], typer.Option(help="Recordings of the new condition, 10 to 30 s of driving; repeatable.")
    ],
    file: Annotated[Path, typer.Option("--out", help="File for the adapted model.", show_default=False)],
    train: Annotated[
        list[Path] | None,
        typer.Option(help="Recordings that the model learned from: a refit with both is tried as well; repeatable."),
    ] = None,
    seconds: Annotated[
        float | None, typer.Option(min=1.0, help="Learn from the first so many seconds of each episode only.")
    ] = None,
    seed: Seed = None,
    columns: Columns = None,
    plugin: Plugins = None,
    json: Json = False,
) -> None:
    """Correct a model for another day, floor or battery, if a gate finds that the correction helps.

    Prints what the gate saw and decided: errors of free runs over blocks that were not learned from.
    """
    from sysid_evo.cli.progress import Bars
    from sysid_evo.data import Dataset
    from sysid_evo.errors import InvalidArgument
    from sysid_evo.store import load_model, save_model

    load_plugins(plugin)
    for suffix in (".json", ".safetensors"):
        if Path(f"{str(file).removesuffix(suffix)}.json").exists():
            raise InvalidArgument(f"--out: {file} exists already; remove it, or name another file")
    base = load_model(model)
    new = Dataset.read(data, columns=columns)
    if seconds is not None:
        new = new.with_episodes([episode[: max(1, round(seconds / new.system.dt))] for episode in new])
    training = None if train is None else Dataset.read(train, columns=columns)
    with Bars() as bars:
        bars.begin("adapt")
        adapted: Any = base.adapt(new, training=training, rng=seed, progress=bars.advance)
        bars.end("adapt", None)
    path = save_model(adapted, file, seed=seed, data=new.fingerprint)
    rows = seen(adapted)
    if json:
        found = {"decision": adapted.verdict_, "tried": rows, "corrected": adapted.corrects, "file": str(path)}
        out.print_json(json_format.dumps(found))
        return
    print_gate(new, rows, adapted.verdict_)
    out.print(f"stored as {path}", highlight=False, markup=False, soft_wrap=True)
    if not adapted.corrects and adapted.chosen_ == "none":
        tell("the stored model predicts what its base predicts", label="note: ", style="dim")


def seen(adapted: Any) -> list[dict[str, Any]]:
    """Return what was tried: its error as a share of that without a correction, over all blocks and in each.

    They are fewer blocks where it was given up after one that showed it to be no good.
    """
    return [
        {"correction": name, "error": round(shares[0], 4), "blocks": [round(share, 4) for share in shares[1:]]}
        for name, shares in zip(adapted.tried_, adapted.gate_, strict=True)
    ]


def print_gate(new: Dataset, rows: list[dict[str, Any]], decision: str) -> None:
    """Print the table of what was tried, the best first, and the decision."""
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    table.add_column("way", no_wrap=True)
    table.add_column("all", justify="right")
    table.add_column("in each block", justify="right")
    count = max((len(row["blocks"]) for row in rows), default=0)
    for row in sorted(rows, key=lambda row: float(row["error"]))[:SHOWN]:
        shares = [f"{share:.2f}" for share in row["blocks"]] + ["   -"] * (count - len(row["blocks"]))
        table.add_row(row["correction"], f"{row['error']:.2f}", "  ".join(shares))
    if rows:
        out.print(
            f"Free runs over {count} blocks, {new.duration:.0f} s in all, each by what was learned from the others; "
            "errors as a share of that of the model as it was (-: given up before):",
            highlight=False,
        )
        out.print(table)
        if len(rows) > SHOWN:
            out.print(f"and {len(rows) - SHOWN} that were worse (--json has them)", highlight=False, style="dim")
    out.print(decision, highlight=False, markup=False)
