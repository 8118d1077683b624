"""Models show, tune, adapt: families and fitted models."""

from __future__ import annotations

import inspect
import re
import time
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.table import Table
from rich.text import Text

import evaluation
import sysid_evo
from sysid_evo.artefacts import is_stored_dataset, read_artefact
from sysid_evo.cli.console import INTERRUPTED, note, out, say, table_of, tell
from sysid_evo.cli.options import Columns, Json, Out, Plugins, Seed, column_map, listed, load_plugins
from sysid_evo.cli.progress import PlanProgress
from sysid_evo.errors import IncompatibleTask, InvalidArgument
from sysid_evo.registry.registry import models
from sysid_evo.tuning import Tuning


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
    load_plugins(plugin)
    stored = name not in models.names() and is_stored_dataset(name, "model")
    if speed and not stored:
        raise InvalidArgument(f"--speed: expected the file of a fitted model, got the family {name!r}")
    card = model_card(Path(name), measured=speed) if stored else family_card(name)
    if as_json:
        out.print_json(data=card)
        return
    for part in card_table(card):
        out.print(part)


SPEED_ROLLOUTS = 640
SPEED_STEPS = 100


def family_card(name: str) -> dict[str, Any]:
    """Return what there is to say of a family: what it assumes, its hyper-parameters and their presets."""
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


def model_card(path: Path, *, measured: bool = False) -> dict[str, Any]:
    """Return the card of a stored model: its family, size, lags, training, and, if ``measured``, its speed.

    Measuring compiles the model, and with it every member of one that is a mean of others.
    """
    manifest, tensors = read_artefact(path, "model")
    model = sysid_evo.load_model(path)
    state_lags, control_lags = model.lags
    return {
        "family": manifest.name,
        "knowledge": model.knowledge,
        "hyper_parameters": manifest.parameters,
        "numbers": int(sum(tensor.size for name, tensor in tensors.items() if name != "training_sample_")),
        "state_lags": state_lags,
        "control_lags": control_lags,
        "states": [f"{c.name} ({c.unit})" for c in model.system.states],
        "controls": [f"{c.name} ({c.unit})" if c.unit else c.name for c in model.system.controls],
        "dt": model.system.dt,
        "seed": manifest.seed,
        "data": manifest.data,
        **({"note": model.fit_note} if model.fit_note else {}),
        "versions": manifest.versions,
        "equations": model.equations(),
        "candidates": model.candidate_ranking(),
        **({"parameters": rows} if (rows := model.parameters_table()) else {}),
        "timings": {**manifest.timings, **(speed(model) if measured else {})},
        **({} if measured else {"speed": "not measured, --speed does"}),
    }


def speed(model: sysid_evo.DynamicsModel) -> dict[str, Any]:
    """Return million steps a second under random controllers, and the form of the engine that ran them."""
    task, controller = sysid_evo.PointToPoint(horizon=SPEED_STEPS), sysid_evo.RecurrentNetwork()
    try:
        bound = task.bind(model.system)
    except IncompatibleTask:
        return {}
    n = controller.bind_to(bound).n_parameters
    candidates = np.random.default_rng(0).standard_normal((SPEED_ROLLOUTS // 10, n))
    seeds = sysid_evo.trial_seeds(0, 10)
    sysid_evo.rollout(model, controller, candidates, task, seeds, threads=1)
    began = time.perf_counter()
    run = sysid_evo.rollout(model, controller, candidates, task, seeds, threads=1)
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
            shown = [f"{item:.3g}" if isinstance(item, float) else str(item) for item in value.values()]
            value = ", ".join(f"{name} {item}" for name, item in zip(value, shown, strict=True))
        elif isinstance(value, list):
            value = ", ".join(map(str, value))
        elif key == "dt":
            value = f"{value:g} s"
        table.add_row(key, Text(str(value)))
    parts.append(table)
    if card.get("description"):  # the lines of a paragraph are joined, for the terminal to wrap; not of equations
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
    """Return what a model was chosen from, a row for each candidate."""
    table = table_of(*rows[0], whole=("error", "weight"))
    for row in rows:
        table.add_row(*map(Text, row.values()))
    return table


def _parameters(rows: list[dict[str, Any]]) -> Table:
    """Return the physical parameters as a table: value, standard error and unit, and what is not determined."""
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


JOURNAL = "tune.journal"

TRIALS_SHOWN = 8
"""Trials of a search that are printed, the best ones."""

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
    parameters: Annotated[str | None, typer.Option(help="The parameters to search, separated by commas.")] = None,
    seed: Seed = None,
    folder: Out = None,
    columns: Columns = None,
    plugin: Plugins = None,
    as_json: Json = False,
) -> None:
    """Search for the parameters with which a family runs free best on recordings held out.

    Every trial is kept in the run folder; the same command with the same --out goes on.
    """
    load_plugins(plugin)
    seconds = None if trials is not None else seconds_of(budget)
    dataset = sysid_evo.Dataset.read(data, columns=column_map(columns))
    path = folder if folder is not None and (folder / JOURNAL).is_file() else evaluation.check_run_folder(folder)
    search = Tuning(
        family,
        dataset,
        horizons=horizon,
        parameters=listed("--parameters", parameters),
        seed=seed or 0,
        file=path / JOURNAL,
    )
    interrupted = False
    with PlanProgress() as bars:
        bars.begin(f"tune {search.spec.name}")
        try:
            for _ in search.run(seconds=seconds, trials=trials, progress=bars.advance):
                pass
        except KeyboardInterrupt:
            interrupted = True
    if interrupted:
        tell(f"interrupted: the trials that had ended are kept; go on with --out {path}")
    if as_json:
        out.print_json(data=search_to_json(search))
    else:
        print_search(search)
    if interrupted:
        raise typer.Exit(INTERRUPTED)


def seconds_of(text: str) -> float:
    """Return a time such as ``5m`` in seconds. Raises `InvalidArgument`."""
    found = re.fullmatch(r"(\d+(?:\.\d+)?)\s*([smh]?)", text.strip())
    if found is None or float(found[1]) <= 0.0:
        raise InvalidArgument(f"--budget: expected a time such as 90s, 5m or 1h, got {text!r}")
    return float(found[1]) * UNITS[found[2]]


def search_to_json(search: Tuning) -> dict[str, Any]:
    """Return what was found as strict JSON."""
    return {
        "best": search.best.spec.text,
        "error": search.best.error,
        "horizons": list(search.horizons),
        "importance": search.importance,
        "trials": [
            {"spec": one.spec.text, "error": one.error, "seconds": one.seconds, "reason": one.reason}
            for one in search.trials
        ],
    }


def print_search(search: Tuning) -> None:
    """Print the best trials, what decides, and the line to use."""
    best, tried = search.best, search.trials
    table = table_of("error", "seconds", "parameters", numbers=("error", "seconds"))
    for one in tried[:TRIALS_SHOWN]:
        if one.error is not None:
            settings = ", ".join(f"{key}={value}" for key, value in one.spec.parameters.items())
            table.add_row(f"{one.error:.4f}", f"{one.seconds:.1f}", Text(settings))
    out.print(table)
    steps = ", ".join(map(str, search.horizons))
    out.print(Text(f"{len(tried)} trials; error of free runs after {steps} steps on what was held out"))
    if search.importance:
        shares = ", ".join(f"{key} {100.0 * share:.0f} %" for key, share in search.importance.items())
        out.print(Text(f"What decides: {shares}"))
    for reason in dict.fromkeys(one.reason for one in tried if one.error is None and one.reason != "stopped early"):
        note(f"a trial failed: {reason}")
    say(best.spec.text)


WAYS_SHOWN = 12
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
    as_json: Json = False,
) -> None:
    """Correct a model for another day, floor or battery, if a gate finds that the correction helps.

    Prints what the gate saw and decided: errors of free runs over blocks that were not learned from.
    """
    load_plugins(plugin)
    stem = str(file).removesuffix(".json").removesuffix(".safetensors")
    for standing in (Path(f"{stem}{suffix}") for suffix in (".json", ".safetensors")):
        if standing.exists():
            raise InvalidArgument(f"--out: {standing} exists already; remove it, or name another file")
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
    rows = tried_ways(adapted)
    if as_json:
        found = {"decision": adapted.decision_, "candidates": rows, "corrected": adapted.corrects, "file": str(path)}
        out.print_json(data=found)
        return
    print_gate(new, rows, adapted.decision_)
    say(f"stored as {path}")
    if not adapted.corrects and adapted.chosen_ == "none":
        note("the stored model predicts what its base predicts")


def tried_ways(adapted: Any) -> list[dict[str, Any]]:
    """Return what was tried: its error as a share of that without a correction, over all blocks and in each.

    They are fewer blocks where it was given up after one that showed it to be no good.
    """
    return [
        {"correction": name, "error": round(shares[0], 4), "blocks": [round(share, 4) for share in shares[1:]]}
        for name, shares in zip(adapted.candidates_, adapted.test_errors_, strict=True)
    ]


def print_gate(new: sysid_evo.Dataset, rows: list[dict[str, Any]], decision: str) -> None:
    """Print the table of what was tried, the best first, and the decision."""
    table = table_of("way", "all", "in each block", numbers=("all", "in each block"), whole=("way",))
    count = max((len(row["blocks"]) for row in rows), default=0)
    for row in sorted(rows, key=lambda row: float(row["error"]))[:WAYS_SHOWN]:
        shares = [f"{share:.2f}" for share in row["blocks"]] + ["   -"] * (count - len(row["blocks"]))
        table.add_row(row["correction"], f"{row['error']:.2f}", "  ".join(shares))
    if rows:
        out.print(
            f"Free runs over {count} blocks, {new.duration:.0f} s in all, each by what was learned from the others; "
            "errors as a share of that of the model as it was (-: given up before):",
            highlight=False,
        )
        out.print(table)
        if len(rows) > WAYS_SHOWN:
            out.print(f"and {len(rows) - WAYS_SHOWN} that were worse (--json has them)", highlight=False, style="dim")
    out.print(decision, highlight=False, markup=False)
