"""Recordings of outputs and controls in units of their deviation, whole and cut into windows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Self

import numpy as np

from model_zoo.scaling import deviation
from sysid_evo.data import Dataset, Trajectory
from sysid_evo.types import Array, IntArray


@dataclass(frozen=True)
class Scales:
    """Centre and deviation of outputs (ny,) and controls (nu,)."""

    output_centre: Array
    output_scale: Array
    control_centre: Array
    control_scale: Array

    @classmethod
    def of(cls, dataset: Dataset) -> Self:
        """Compute centre and deviation over all samples of ``dataset``."""
        outputs = np.concatenate([episode.states for episode in dataset.episodes])
        controls = np.concatenate([episode.controls for episode in dataset.episodes])
        return cls(outputs.mean(axis=0), deviation(outputs), controls.mean(axis=0), deviation(controls))

    def scaled(self, episode: Trajectory) -> ScaledEpisode:
        """Return one episode in these units."""
        outputs = (episode.states - self.output_centre) / self.output_scale
        return ScaledEpisode(outputs, (episode.controls - self.control_centre) / self.control_scale)


@dataclass(frozen=True)
class ScaledEpisode:
    """One episode in units of deviation: outputs (T + 1, ny) and controls (T, nu)."""

    outputs: Array
    controls: Array

    def __len__(self) -> int:
        return len(self.controls)


@dataclass(frozen=True)
class ShootingWindows:
    """B windows of at most H steps: outputs (B, H + 1, ny), controls (B, H, nu), and which outputs count (B, H + 1).

    A sample counts once: the last of a window is the first of the next.
    """

    outputs: Array
    controls: Array
    counts: Array

    @property
    def begins(self) -> IntArray:
        """Position of the first sample of each window (B,) among all samples that count."""
        return np.cumsum([0, *self.counts.sum(axis=1)[:-1]]).astype(np.int64)

    def rows(self, values: Array) -> Array:
        """Return the samples of ``values`` (B, H + 1, ...) that count, in sequence."""
        return values[self.counts > 0.0]

    @classmethod
    def of(cls, parts: list[ScaledEpisode], longest: int) -> Self:
        """Cut every record into windows of equal length, at most ``longest`` steps, and pad them to the longest."""
        windows: list[tuple[Array, Array, bool]] = []
        for record in parts:
            edges = np.linspace(0, len(record), -(-len(record) // longest) + 1).astype(np.int64)
            for begin, end in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
                last = end == len(record)
                windows.append((record.outputs[begin : end + 1], record.controls[begin:end], last))
        steps = max(len(controls) for _, controls, _ in windows)
        outputs = np.zeros((len(windows), steps + 1, parts[0].outputs.shape[1]))
        controls = np.zeros((len(windows), steps, parts[0].controls.shape[1]))
        counts = np.zeros((len(windows), steps + 1))
        for i, (own_outputs, own_controls, last) in enumerate(windows):
            outputs[i, : len(own_outputs)], controls[i, : len(own_controls)] = own_outputs, own_controls
            counts[i, : len(own_outputs) if last else len(own_controls)] = 1.0
        return cls(outputs, controls, counts)

    def __len__(self) -> int:
        return len(self.counts)
