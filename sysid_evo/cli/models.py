"""Models show, adapt: families and fitted models."""

from __future__ import annotations

import inspect
from pathlib import Path
from typing import Annotated, Any

from rich.table import Table
from rich.text import Text

import sysid_evo
from sysid_evo.cli import options
from sysid_evo.cli.console import note, out, print_line, table_of
from sysid_evo.cli.options import argument, load_plugins, names_of, number, option
from sysid_evo.cli.progress import PlanProgress
from sysid_evo.errors import InvalidArgument
from sysid_evo.registry.registry import models


def show_model(
    name: Annotated[str, argument("Model family, or file of a fitted model", "NAME", values=names_of("model"))],
    plugin: options.Plugins = None,
    as_json: options.Json = False,
) -> None:  # fmt: skip
    """Show a model family, or a fitted model.

    A family shows its assumptions and parameters; a fitted model its size, lags, equations and training time.
    """
    load_plugins(plugin)
    stored = name not in models.names() and sysid_evo.is_stored_artefact(name, "model")
    card = model_card(Path(name)) if stored else family_card(name)
    if as_json:
        out.print_json(data=card)
        return
    for part in card_table(card):
        out.print(part)
    if not stored:
        out.print(Text(f"\n{COMMON}"))


COMMON = (
    "Common parameters: stochastic adds calibrated noise; state_lags and control_lags are the numbers of "
    "earlier samples among the inputs (None: chosen in the fit); max_steps limits the steps used in a fit."
)


def family_card(name: str) -> dict[str, Any]:
    """Return the card of a family: assumptions, hyperparameters and their presets."""
    family: Any = models.get(name)
    signature = inspect.signature(family.__init__)
    hyper_parameters = [
        {
            "name": parameter.name,
            "default": parameter.default,
            **{preset: values[parameter.name] for preset, values in family.presets.items() if parameter.name in values},
        }
        for parameter in list(signature.parameters.values())[1:]
    ]
    return {
        "family": name,
        "knowledge": family.knowledge,
        "bounds_multiple": family.bounds_multiple,
        "module": family.__module__,
        "description": inspect.getdoc(family) or "",
        "hyper_parameters": hyper_parameters,
    }


def model_card(path: Path) -> dict[str, Any]:
    """Return the card of a stored model: family, size, lags, training."""
    manifest, tensors = sysid_evo.read_artefact(path, "model")
    model = sysid_evo.load_model(path)
    state_lags, control_lags = model.lags
    return {
        "family": manifest.name, "knowledge": model.knowledge, "hyper_parameters": manifest.parameters,
        "numbers": int(sum(tensor.size for name, tensor in tensors.items() if name != "training_sample_")),
        "state_lags": state_lags, "control_lags": control_lags,
        "states": [f"{c.name} ({c.unit})" for c in model.system.states],
        "controls": [f"{c.name} ({c.unit})" if c.unit else c.name for c in model.system.controls],
        **({"advance": "each step has the control that was logged after it"} if model.system.advance else {}),
        "dt": model.system.dt, "seed": manifest.seed, "data": manifest.data,
        **({"note": model.fit_note} if model.fit_note else {}),
        "versions": manifest.versions, "equations": model.equations(), "candidates": model.candidate_ranking(),
        **({"parameters": rows} if (rows := model.parameters_table()) else {}),
        "timings": manifest.timings,
    }  # fmt: skip


def card_table(card: dict[str, Any]) -> list[Any]:
    """Return a card as rich renderables that fit 80 columns."""
    parts: list[Any] = []
    table = Table(box=None, pad_edge=False, show_header=False)
    table.add_column(no_wrap=True, style="bold")
    table.add_column()
    for key, value in card.items():
        if key in ("description", "hyper_parameters", "equations", "candidates", "parameters"):
            continue
        if isinstance(value, dict):
            shown = [f"{item:.3g}" if isinstance(item, float) else str(item) for item in value.values()]
            value = ", ".join(f"{name} {item}" for name, item in zip(value, shown, strict=True))
        elif isinstance(value, list):
            value = ", ".join(map(str, value))
        elif key == "dt":
            value = f"{value:g} s"
        table.add_row(key, Text(str(value)))
    parts.append(table)
    if card.get("description"):  # lines of a paragraph are joined so that the terminal wraps them; equations are not
        paragraphs = card["description"].split("\n\n")
        texts = [text if text.startswith(" ") else " ".join(text.split()) for text in paragraphs]
        parts += [Text(""), Text("\n\n".join(texts))]
    parts += [Text(""), _hyper_parameters(card["hyper_parameters"])]
    if card.get("candidates"):
        parts += [Text(""), _candidates(card["candidates"])]
    if card.get("equations"):
        parts += [Text(""), *map(Text, card["equations"])]
    if card.get("parameters"):
        parts += [Text(""), _parameters(card["parameters"])]
    return parts


def _candidates(rows: list[dict[str, str]]) -> Table:
    """Return a table of the candidates that a model was selected from."""
    table = table_of(*rows[0], whole=("error", "weight"))
    for row in rows:
        table.add_row(*map(Text, row.values()))
    return table


def _parameters(rows: list[dict[str, Any]]) -> Table:
    """Return the physical parameters as a table: value, standard error, unit, and a mark if not determined."""
    table = table_of("parameter", "value", "standard error", "unit", "", numbers=("value", "standard error"))
    for row in rows:
        remark = "" if row["determined"] else "not determined"
        table.add_row(row["parameter"], f"{row['value']:.4g}", f"{row['standard error']:.2g}", row["unit"], remark)
    return table


def _hyper_parameters(values: Any) -> Table:
    rows = values if isinstance(values, list) else [{"name": name, "value": value} for name, value in values.items()]
    columns = list(dict.fromkeys(key for row in rows for key in row))
    first = "hyper-parameter"
    table = table_of(*(first if column == "name" else column for column in columns), whole=(first,))
    for row in rows:
        table.add_row(*[Text(str(row.get(column, ""))) for column in columns])
    return table


CORRECTIONS_SHOWN = 12
"""The number of best corrections that are printed."""


def adapt(
    model: Annotated[Path, argument("File of a fitted model: RUN/models/NAME", "MODEL")],
    data: Annotated[list[Path], option("Recordings of the new condition, 10 to 30 s of driving; repeatable", "PATH",
        panel="Data and models")],
    file: Annotated[Path, option("File for the adapted model", "FILE", "--out")],
    train: Annotated[list[Path] | None, option("Training data of the model: also try a refit to both; repeatable",
        "PATH", panel="Data and models")] = None,
    seconds: Annotated[float | None, option("Use only the first seconds of each episode", "N", panel="Data and models",
        parser=number(1.0, float))] = None,
    columns: options.Columns = None, seed: options.Seed = None, plugin: options.Plugins = None,
    as_json: options.Json = False,
) -> None:  # fmt: skip
    """Adapt a fitted model to a new operating condition.

    The condition may be another floor, battery or load. An acceptance test on blocks that were not fitted decides
    whether a correction, fine-tuning or a refit replaces the model; it is printed.
    """
    load_plugins(plugin)
    stem = str(file).removesuffix(".json").removesuffix(".safetensors")
    for existing in (Path(f"{stem}{suffix}") for suffix in (".json", ".safetensors")):
        if existing.exists():
            raise InvalidArgument(f"--out: {existing} exists already; remove it, or name another file")
    base = sysid_evo.load_model(model)
    new = sysid_evo.Dataset.read(data, columns=columns)
    if seconds is not None:
        new = new.with_episodes([episode[: max(1, round(seconds / new.system.dt))] for episode in new])
    training = None if train is None else sysid_evo.Dataset.read(train, columns=columns)
    with PlanProgress() as bars:
        bars.begin("adapt")
        adapted: Any = base.adapt(new, training=training, rng=seed, progress=bars.advance)
        bars.end("adapt", None)
    path = sysid_evo.save_model(adapted, file, seed=seed, data=new.fingerprint)
    rows = tried_corrections(adapted)
    if as_json:
        found = {"decision": adapted.decision_, "candidates": rows, "corrected": adapted.corrects, "file": str(path)}
        out.print_json(data=found)
        return
    print_acceptance_test(new, rows, adapted.decision_)
    print_line(f"stored as {path}")
    if not adapted.corrects and adapted.chosen_ == "none":
        note("the stored model makes the same predictions as its base")


def tried_corrections(adapted: Any) -> list[dict[str, Any]]:
    """Return each candidate with its error relative to no correction, over all blocks and in each block.

    A candidate that was dropped after a bad block has fewer blocks.
    """
    return [
        {"correction": name, "error": round(shares[0], 4), "blocks": [round(share, 4) for share in shares[1:]]}
        for name, shares in zip(adapted.candidates_, adapted.test_errors_, strict=True)
    ]


def print_acceptance_test(new: sysid_evo.Dataset, rows: list[dict[str, Any]], decision: str) -> None:
    """Print the table of the candidates, the best first, and the decision."""
    table = table_of("correction", "all", "in each block", numbers=("all", "in each block"), whole=("correction",))
    count = max((len(row["blocks"]) for row in rows), default=0)
    for row in sorted(rows, key=lambda row: float(row["error"]))[:CORRECTIONS_SHOWN]:
        shares = [f"{share:.2f}" for share in row["blocks"]] + ["   -"] * (count - len(row["blocks"]))
        table.add_row(row["correction"], f"{row['error']:.2f}", "  ".join(shares))
    if rows:
        out.print(
            f"Simulation over {count} blocks, {new.duration:.0f} s in all, each held out in turn; "
            "errors relative to the unchanged model (-: dropped before):",
            highlight=False,
        )
        out.print(table)
        if len(rows) > CORRECTIONS_SHOWN:
            out.print(
                f"and {len(rows) - CORRECTIONS_SHOWN} worse ones (listed by --json)", highlight=False, style="dim"
            )
    out.print(decision, highlight=False, markup=False)
