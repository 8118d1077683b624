"""Files that the parameters of a spec name: what is made of them depends on what stands in them."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path

from evaluation.comparison.experiment import Experiment
from sysid_evo.registry import Spec


def files_beside(experiment: Experiment) -> dict[str, tuple[str, ...]]:
    """Return the texts of an experiment that name plugins and robots in files, with their files."""
    found = (*experiment.plugins, *((experiment.robot,) if experiment.robot else ()))
    return {text: (text,) for text in found if Path(text).is_file()}


def file_digests(spec: Spec) -> list[str]:
    """Return the SHA-256 of every file, with its other half, that a parameter of ``spec`` names."""
    return [hashlib.sha256(file.read_bytes()).hexdigest() for file in named_files(spec)]


def named_files(spec: Spec) -> Iterator[Path]:
    """Yield the files, with their halves, that the parameters of ``spec`` name."""
    for value in spec.parameters.values():
        for text in value if isinstance(value, (list, tuple)) else [value]:
            if isinstance(text, str):
                stem = text.removesuffix(".safetensors").removesuffix(".json")
                yield from (file for file in map(Path, (f"{stem}.json", f"{stem}.safetensors")) if file.is_file())
