"""What `sysid-evo models show` prints: the card of a family, or of a fitted model."""

from __future__ import annotations

import inspect
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.table import Table
from rich.text import Text

if TYPE_CHECKING:
    from sysid_evo.dynamics import DynamicsModel

SPEED_ROLLOUTS = 640
SPEED_STEPS = 100


def family_card(name: str) -> dict[str, Any]:
    """Return what there is to say of a family: what it assumes, its hyper-parameters and their presets."""
    from sysid_evo.registry import models

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
        "envelope_multiple": family.envelope_multiple,
        "module": family.__module__,
        "description": inspect.getdoc(family) or "",
        "hyper_parameters": hyper_parameters,
    }


def model_card(path: Path, *, measured: bool = False) -> dict[str, Any]:
    """Return the card of a stored model: its family, size, lags, training, and, if ``measured``, its speed.

    Measuring compiles the model, and with it every member of one that is a mean of others.
    """
    from sysid_evo.store import load_model
    from sysid_evo.store.manifest import read_artefact

    manifest, tensors = read_artefact(path, "model")
    model = load_model(path)
    state_lags, control_lags = model.lags
    return {
        "family": manifest.name,
        "knowledge": model.knowledge,
        "hyper_parameters": manifest.parameters,
        "numbers": int(sum(tensor.size for name, tensor in tensors.items() if name != "pairs_")),
        "state_lags": state_lags,
        "control_lags": control_lags,
        "states": [f"{c.name} ({c.unit})" for c in model.system.states],
        "controls": [f"{c.name} ({c.unit})" if c.unit else c.name for c in model.system.controls],
        "dt": model.system.dt,
        "seed": manifest.seed,
        "data": manifest.data,
        **({"note": model.fit_note} if model.fit_note else {}),
        "versions": manifest.versions,
        "equations": list(model.equations()) if hasattr(model, "equations") else [],
        "candidates": model.standing() if hasattr(model, "standing") else [],
        **({"parameters": model.parameters_table()} if hasattr(model, "parameters_table") else {}),
        "timings": {**manifest.timings, **(speed(model) if measured else {})},
        **({} if measured else {"speed": "not measured, --speed does"}),
    }


def speed(model: DynamicsModel) -> dict[str, Any]:
    """Return million steps a second under random controllers, and the form of the engine that ran them."""
    import numpy as np

    from sysid_evo.controllers import RecurrentNetwork
    from sysid_evo.engine import rollout
    from sysid_evo.errors import IncompatibleTask
    from sysid_evo.randomness import trial_seeds
    from sysid_evo.tasks import PointToPoint

    task, controller = PointToPoint(horizon=SPEED_STEPS), RecurrentNetwork()
    try:
        bound = task.bind(model.system)
    except IncompatibleTask:
        return {}
    n = controller.bind_to(bound).n_parameters
    candidates, seeds = np.random.default_rng(0).standard_normal((SPEED_ROLLOUTS // 10, n)), trial_seeds(0, 10)
    rollout(model, controller, candidates, task, seeds, threads=1)
    began = time.perf_counter()
    run = rollout(model, controller, candidates, task, seeds, threads=1)
    rate = SPEED_ROLLOUTS * SPEED_STEPS / (time.perf_counter() - began) / 1e6
    return {"million_steps_per_second": round(rate, 2), "engine": run.engine}


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
            value = ", ".join(f"{name} {_short(item)}" for name, item in value.items())
        elif isinstance(value, list):
            value = ", ".join(map(str, value))
        elif key == "dt":
            value = f"{value:g} s"
        table.add_row(key, Text(str(value)))
    parts.append(table)
    if card.get("description"):
        parts += [Text(""), Text(_reflowed(card["description"]))]
    parts += [Text(""), _hyper_parameters(card["hyper_parameters"])]
    if card.get("candidates"):
        parts += [Text(""), _candidates(card["candidates"])]
    if card.get("equations"):
        parts += [Text(""), *map(Text, card["equations"])]
    if card.get("parameters"):
        parts += [Text(""), _parameters(card["parameters"])]
    return parts


def _short(value: Any) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def _candidates(rows: list[dict[str, str]]) -> Table:
    """Return what a model was chosen from, a row for each candidate."""
    table = Table(box=None, pad_edge=False)
    for column in rows[0]:
        table.add_column(column, overflow="fold", no_wrap=column in ("error", "weight"))
    for row in rows:
        table.add_row(*map(Text, row.values()))
    return table


def _parameters(rows: list[dict[str, Any]]) -> Table:
    """Return the physical parameters as a table: value, standard error and unit, and what is not determined."""
    table = Table(box=None, pad_edge=False)
    for column in ("parameter", "value", "standard error", "unit", ""):
        table.add_column(column, justify="right" if column in ("value", "standard error") else "left")
    for row in rows:
        remark = "" if row["determined"] else "not determined"
        table.add_row(row["parameter"], f"{row['value']:.4g}", f"{row['standard error']:.2g}", row["unit"], remark)
    return table


def _reflowed(description: str) -> str:
    """Join the lines of every paragraph, so that the terminal can wrap it; indented ones are equations."""
    paragraphs = description.split("\n\n")
    return "\n\n".join(text if text.startswith(" ") else " ".join(text.split()) for text in paragraphs)


def _hyper_parameters(values: Any) -> Table:
    rows = values if isinstance(values, list) else [{"name": name, "value": value} for name, value in values.items()]
    columns = list(dict.fromkeys(key for row in rows for key in row))
    table = Table(box=None, pad_edge=False)
    for column in columns:
        table.add_column("hyper-parameter" if column == "name" else column, no_wrap=column == "name")
    for row in rows:
        table.add_row(*[Text(str(row.get(column, ""))) for column in columns])
    return table
