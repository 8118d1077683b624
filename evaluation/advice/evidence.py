"""Input of the checks (recordings, a model and its errors) and their output (remarks)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from evaluation.coverage import MOST_STEPS
from evaluation.prediction.cases import PredictionProtocol, measured_cases, spread_of
from evaluation.prediction.residuals import OneStepErrors, Residuals, analyse_residuals, step_errors
from evaluation.steps import Steps
from sysid_evo.data import Dataset, RecordingQuality, recording_quality
from sysid_evo.data.response import Delay, acting_controls
from sysid_evo.data.support import Support, recorded_pairs, split_pairs
from sysid_evo.data.timing import ControlTiming, control_timing
from sysid_evo.data.trajectory import evenly_spaced, recording
from sysid_evo.models import DynamicsModel
from sysid_evo.system import System
from sysid_evo.types import Array, BoolArray, IntArray
from sysid_evo.validation.estimates import Draws, drawn_rms


@dataclass(frozen=True, kw_only=True)
class Recordings:
    """Recordings to fit to, ``training``, and held-out recordings, ``test``, if there are any.

    ``visited`` are the steps that controllers take in models and on robots, None if none were evolved. ``known`` is
    the quality of the recordings if it has been computed before.
    """

    training: Dataset
    test: Dataset | None = None
    visited: Steps | None = None
    known: RecordingQuality | None = None

    @property
    def system(self) -> System:
        return self.training.system

    @cached_property
    def quality(self) -> RecordingQuality:
        return recording_quality(self.training) if self.known is None else self.known

    @cached_property
    def timing(self) -> ControlTiming | None:
        return control_timing(self.training)

    @property
    def delays(self) -> list[Delay]:
        """The strongest clear delay of each control that has an effect."""
        clear = sorted((one for one in self.quality.delays if one.clear), key=lambda one: abs(one.strength))
        strongest = {one.control: one for one in clear}
        return [strongest[name] for name in self.system.control_names if name in strongest]

    @cached_property
    def seen(self) -> Steps:
        """Steps of the training data that start in motion, a subset of many; none if nothing moves."""
        moving = np.concatenate([rows[:-1] for rows in self.training.moving])
        return Steps.of(self.system, self.training.episodes)[moving].thinned(MOST_STEPS)

    @cached_property
    def support(self) -> Support:
        """The region that the training data cover, from as many of them as a fitted model keeps."""
        return Support.of(self.system, *split_pairs(self.system, recorded_pairs(self.training)))


@dataclass(frozen=True, kw_only=True)
class Evidence(Recordings):
    """A fitted ``model``, called ``name``, its training data and the data it is evaluated on.

    Without ``test`` it is evaluated on the training data, which shows nothing about its error on other data.
    """

    name: str
    model: DynamicsModel

    @property
    def evaluated(self) -> Dataset:
        """The test part, or the data used in its place."""
        return self.training if self.test is None else self.test

    @cached_property
    def horizon(self) -> int:
        """Main horizon of the report, in steps."""
        return measured_cases(self.training, self.evaluated, PredictionProtocol()).main_horizon or 1

    @cached_property
    def std(self) -> Array:
        """Standard deviation (nx,) of the evaluated samples in motion; 1 for a state that does not vary."""
        return np.where(self.varying, self._spread, 1.0)

    @property
    def varying(self) -> BoolArray:
        """Whether each state varies (nx,) in the evaluated samples in motion."""
        return self._spread > 0.0

    @cached_property
    def _spread(self) -> Array:
        moving = [e.states[rows] for e, rows in zip(self.evaluated, self.evaluated.moving, strict=True)]
        return spread_of(self.system, np.concatenate(moving))

    @cached_property
    def steps(self) -> OneStepErrors:
        """Errors one step ahead."""
        return step_errors(self.model, self.evaluated)

    @cached_property
    def residuals(self) -> Residuals:
        return analyse_residuals(self.steps)

    @cached_property
    def test_windows(self) -> WindowErrors:
        """Errors at the main horizon, on the evaluated data."""
        return window_errors(self.model, self.evaluated, self.horizon)

    @cached_property
    def training_windows(self) -> WindowErrors:
        """Errors at the main horizon, on the training data."""
        return self.test_windows if self.test is None else window_errors(self.model, self.training, self.horizon)


@dataclass(frozen=True)
class WindowErrors:
    """Errors (N, nx), predicted minus measured, at the end of windows that start in ``states`` (N, nx).

    ``mean_controls`` (N, m) are the mean acting controls of each window, ``recordings`` (N,) the name of its recording.
    ``blocks`` (N,) number bootstrap blocks of consecutive windows.
    """

    errors: Array
    states: Array
    mean_controls: Array
    recordings: np.ndarray
    blocks: IntArray

    def n(self, std: Array) -> float:
        """Return N, the mean over channels of RMSE in units of ``std`` (nx,)."""
        return float(np.mean(np.sqrt(np.mean(self.errors**2, axis=0)) / std))

    def drawn_n(self, std: Array, seed: int = 0) -> Draws:
        """Return N with bootstrap draws over blocks; the same windows give the same draws."""
        return Draws((drawn_rms(self.errors, self.blocks, seed=seed) / std).mean(axis=1), len(np.unique(self.blocks)))


MOST_WINDOWS = 1200
"""Maximum number of windows simulated per part: enough to resolve a tenth, and fast in every family."""
STRIDE, FIRST = 4, 5
BLOCK_WINDOWS = 15


def window_errors(model: DynamicsModel, dataset: Dataset, horizon: int) -> WindowErrors:
    """Simulate up to `MOST_WINDOWS` evenly spread windows and return the errors at their end."""
    system = dataset.system
    places = dataset.find_windows(horizon, stride=STRIDE, history=model.n_lags, first=FIRST, moving=True)
    count = len(places)
    windows = places[evenly_spaced(count, MOST_WINDOWS, nearest=True)]
    if not len(windows):
        none = np.empty((0, system.nx))
        return WindowErrors(none, none, np.empty((0, system.nu)), np.empty(0, dtype=object), np.empty(0, np.int64))
    predicted = model.simulate(windows.past_states, windows.past_controls, windows.controls)[:, -1]
    errors = system.difference(predicted, windows.states[:, -1])
    usable = np.isfinite(errors).all(axis=1)
    before = np.concatenate([windows.start_states[:, None], windows.states[:, :-1]], axis=1)
    mean_controls = [acting_controls(system, x, u).mean(axis=0) for x, u in zip(before, windows.controls, strict=True)]
    names = np.array([recording(name) for name in dataset.names], dtype=object)
    blocks = windows.episode * (count + 1) + (windows.start // (STRIDE * BLOCK_WINDOWS))
    return WindowErrors(
        errors[usable],
        system.wrap(windows.start_states)[usable],
        np.array(mean_controls)[usable],
        names[windows.episode][usable],
        blocks[usable],
    )


@dataclass(frozen=True)
class Remark:
    """A finding on what limits a model or a recording, with its ``topic``, what it means and what to do.

    ``weight`` orders remarks: approximately the share of the error, or of the time, that is concerned, 0 to 1.
    ``figures`` are the numbers in the sentence.
    """

    topic: str
    sentence: str
    weight: float
    figures: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class ModelAdvice:
    """Remarks on ``model``, the most important first; ``evaluated_on`` names the data it was evaluated on."""

    model: str
    evaluated_on: str = ""
    remarks: tuple[Remark, ...] = ()
