"""A result on disk: any data class of numbers, texts and arrays, as JSON beside safetensors."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError
from safetensors.numpy import load_file, save

from evaluation.behaviour import BehaviourDifference
from evaluation.exploitability.optimism import Optimism
from evaluation.exploitability.results import Denial, ModelExploitability, ProbeResult, Share
from evaluation.exploitability.slopes import Fact
from evaluation.prediction.regions import Region, RegionError
from evaluation.prediction.residuals import Residuals
from evaluation.prediction.scores import Coverage, Divergence, EpisodeError, ErrorScore, ModelPrediction
from evaluation.transfer.matrix import Cell
from evaluation.transfer.uncertainty import Estimate
from sysid_evo.errors import ArtefactError
from sysid_evo.files import write_atomically
from sysid_evo.validation.bootstrap import Interval

ESTIMATES = ("claimed", "others", "achieved", "gap", "best_here")

LISTED: Mapping[str, type] = {
    "probes": ProbeResult,
    "facts": Fact,
    "behaviours": BehaviourDifference,
    "denied": Denial,
}

SINGLE: Mapping[str, type] = {"kept": Share, "optimism": Optimism}


def exploitability_to_json(model: ModelExploitability) -> dict[str, Any]:
    """Return every field as strict JSON; what is not a number is null."""
    plain: dict[str, Any] = _plain(asdict(model))
    return plain


def exploitability_from_json(value: Mapping[str, Any]) -> ModelExploitability:
    """Undo `exploitability_to_json`."""
    fields = dict(value)
    fields["controllers"] = tuple(fields["controllers"])
    fields["seed_fitness"] = tuple(fields["seed_fitness"])
    fields["on_each"] = tuple((name, value) for name, value in fields["on_each"])
    for name, kind in LISTED.items():
        fields[name] = tuple(kind(**item) for item in fields[name])
    for name, kind in SINGLE.items():
        fields[name] = None if fields[name] is None else kind(**fields[name])
    for name in ESTIMATES:
        fields[name] = (
            None if fields[name] is None else Estimate(**{key: _number(v) for key, v in fields[name].items()})
        )
    return ModelExploitability(**fields)


def _number(value: float | None) -> float:
    return math.nan if value is None else value


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


ARRAYS = ("rmse", "error_std", "relative_percent", "nrmse", "resampled_n")

RESIDUALS = ("autocorrelation", "band", "white_p", "cross", "cross_band", "cross_p")

FORM = 4
"""Raised whenever stored scores hold something else than before."""


def save_prediction(prediction: ModelPrediction, path: Path) -> list[Path]:
    """Write the scores of a model to ``path`` with two suffixes; return the files."""
    tensors = {"curve": prediction.curve, "curve_interval": prediction.curve_interval}
    residuals = prediction.residuals
    if residuals is not None:
        tensors.update({f"residuals.{name}": getattr(residuals, name) for name in RESIDUALS})
    for i, episode in enumerate(prediction.episodes):
        tensors.update({f"episode.{i}.n": episode.n, f"episode.{i}.fit": episode.fit})
    tensors.update({f"free_states.{i}": states for i, states in enumerate(prediction.free_states)})
    scores = []
    for i, score in enumerate(_all_scores(prediction)):
        tensors.update({f"score.{i}.{name}": getattr(score, name) for name in ARRAYS})
        scores.append({"horizon": score.horizon, "samples": score.samples, "interval": _storage_plain(score.interval)})
    tensors.update({f"coverage.{i}": held.inside for i, held in enumerate(prediction.coverage)})
    divergence = prediction.divergence
    value = {
        "name": prediction.name,
        "family": prediction.family,
        "scores": scores,
        "free_runs": len(prediction.free_states),
        "divergence": None
        if divergence is None
        else {
            "share": divergence.share,
            "median_time": divergence.median_time,
            "free_run_times": list(divergence.free_run_times),
        },
        "residuals": None if residuals is None else residuals.samples,
        "regions": [_region_to_json(region) for region in prediction.regions],
        "episodes": [episode.name for episode in prediction.episodes],
        "coverage": [
            {"horizon": held.horizon, "samples": held.samples, "share": held.share} for held in prediction.coverage
        ],
        "notes": list(prediction.notes),
    }
    payload = save({name: np.ascontiguousarray(tensor) for name, tensor in tensors.items()})
    text = json.dumps(value, allow_nan=False)
    return [
        write_atomically(_with(path, ".safetensors"), lambda file: file.write_bytes(payload)),
        write_atomically(_with(path, ".json"), lambda file: file.write_text(text, encoding="utf-8")),
    ]


def load_prediction(path: Path) -> ModelPrediction:
    """Read what `save_prediction` wrote. Raises `ArtefactError`."""
    try:
        value = json.loads(_with(path, ".json").read_text(encoding="utf-8"))
        tensors = load_file(_with(path, ".safetensors"))
        scores = [_score(i, found, tensors) for i, found in enumerate(value["scores"])]
        divergence = value["divergence"]
        return ModelPrediction(
            name=value["name"],
            family=value["family"],
            at=tuple(score for score in scores if score.horizon is not None),
            free_run=next((score for score in scores if score.horizon is None), None),
            curve=tensors["curve"],
            curve_interval=tensors["curve_interval"],
            divergence=None
            if divergence is None
            else Divergence(divergence["share"], divergence["median_time"], tuple(divergence["free_run_times"])),
            residuals=None
            if value["residuals"] is None
            else Residuals(value["residuals"], **{name: tensors[f"residuals.{name}"] for name in RESIDUALS}),
            regions=tuple(_region_of(region) for region in value["regions"]),
            episodes=tuple(
                EpisodeError(name, tensors[f"episode.{i}.n"], tensors[f"episode.{i}.fit"])
                for i, name in enumerate(value["episodes"])
            ),
            coverage=tuple(
                Coverage(**held, inside=tensors[f"coverage.{i}"]) for i, held in enumerate(value["coverage"])
            ),
            free_states=tuple(tensors[f"free_states.{i}"] for i in range(value["free_runs"])),
            notes=tuple(value["notes"]),
        )
    except (OSError, ValueError, KeyError, TypeError, SafetensorError) as error:
        raise ArtefactError(f"{path}: not stored scores of a prediction: {type(error).__name__}: {error}") from error


def _all_scores(prediction: ModelPrediction) -> tuple[ErrorScore, ...]:
    return prediction.at if prediction.free_run is None else (*prediction.at, prediction.free_run)


def _score(number: int, value: dict[str, Any], tensors: dict[str, Any]) -> ErrorScore:
    arrays = {name: tensors[f"score.{number}.{name}"] for name in ARRAYS}
    return ErrorScore(value["horizon"], value["samples"], interval=_interval(value["interval"]), **arrays)


def _region_to_json(found: RegionError) -> dict[str, Any]:
    return {**asdict(found), "interval": _storage_plain(found.interval)}


def _region_of(value: dict[str, Any]) -> RegionError:
    fields = {**value, "region": Region(**value["region"]), "interval": _interval(value["interval"])}
    return RegionError(**fields)


def _interval(limits: list[float | None]) -> Interval:
    return Interval(*(float("nan") if limit is None else limit for limit in limits))


def _storage_plain(interval: Interval) -> list[float | None]:
    return [limit if math.isfinite(limit) else None for limit in interval]


def _with(path: Path, suffix: str) -> Path:
    return path.with_name(path.name + suffix)


LONG = ("states", "controls", "pose")
"""What there is of each trace at every step: as text it would take fifty times as long."""


def save_cell(cell: Cell, path: Path) -> list[Path]:
    """Write a cell to ``path`` with two suffixes; return the files."""
    value = cell.to_dict()
    tensors = {}
    for i, trace in enumerate(value["traces"]):
        for name in LONG:
            numbers = trace.pop(name)
            if numbers is not None:
                tensors[f"trace.{i}.{name}"] = np.asarray(numbers)
    payload, text = save(tensors), json.dumps(value, allow_nan=False)
    return [
        write_atomically(_with(path, ".safetensors"), lambda file: file.write_bytes(payload)),
        write_atomically(_with(path, ".json"), lambda file: file.write_text(text, encoding="utf-8")),
    ]


def load_cell(path: Path) -> Cell:
    """Read what `save_cell` wrote. Raises `ArtefactError`."""
    try:
        value = json.loads(_with(path, ".json").read_text(encoding="utf-8"))
        tensors = load_file(_with(path, ".safetensors"))
        for i, trace in enumerate(value["traces"]):
            trace.update({name: tensors.get(f"trace.{i}.{name}") for name in LONG})
        return Cell.from_dict(value)
    except (OSError, SafetensorError, KeyError, TypeError, ValueError) as error:
        raise ArtefactError(f"{path}: not a cell of a transfer matrix: {error}") from error


def write_json(value: Any, path: Path) -> list[Path]:
    """Write strict JSON to ``path`` with the suffix; return the file."""
    text = json.dumps(value, allow_nan=False)
    file = path.with_name(path.name + ".json")
    return [write_atomically(file, lambda temporary: temporary.write_text(text, encoding="utf-8"))]


def read_json(path: Path) -> Any:
    """Read what `write_json` wrote."""
    return json.loads(path.with_name(path.name + ".json").read_text(encoding="utf-8"))
