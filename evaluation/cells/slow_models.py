"""Models whose step takes long: a plan times a step of each, and searches in them have fewer generations.

A family states that its models may have no compiled form, or a long one, by the class attribute ``timing_parameters``:
hyper-parameters of a fit that is short, used for the timing. Families that define neither `predictor` nor `kernel` are
timed, too.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np

from evaluation.cells.plants import STEPS, Plant
from evaluation.experiment import Experiment
from sysid_evo.data import Dataset, Trajectory
from sysid_evo.engine.compiled.open_loop import free_runs
from sysid_evo.models import DynamicsModel
from sysid_evo.models.dynamics import started
from sysid_evo.processors import resolve
from sysid_evo.registry import Spec, models
from sysid_evo.system import Channel, System
from sysid_evo.types import Array

SAMPLES = (250, 1000)
"""Numbers of steps to which a model is fitted for a timing, to see whether a step takes longer with more data.

That time is extrapolated, unless the attribute ``depth_only`` of the model is true: trees grow in depth only.
"""
GROWS = 1.4
"""Ratio of both times above which the time of a step is taken to grow with the data."""
ROLLOUTS, STEPS_TIMED = 512, 25
"""Number of rollouts that are stepped together, about those of a generation, and of steps that are compiled."""
QUICK = 2e-7
"""Seconds of a step up to which a compiled model is as quick as the others."""
IN_NUMPY = 1e-6
"""Approximate seconds of a step of controller and task, which run in NumPy with such a model."""
CANDIDATES = 100
"""Approximate number of candidates of a generation."""
FEWEST = 10
"""Generations of a search, however long they take."""


def may_be_slow(family: Any) -> bool:
    """Return whether models of ``family`` may have no compiled form, or a long one."""
    own = family.predictor is not DynamicsModel.predictor or family.kernel is not DynamicsModel.kernel
    return getattr(family, "timing_parameters", None) is not None or not own


def times_of_steps(
    specs: Collection[Spec], system: System, dataset: Dataset | None, steps: int, known: Mapping[str, float]
) -> dict[str, float]:
    """Return the seconds of a step of one rollout, by spec, of models whose step takes long.

    They are fitted to some steps of ``dataset``, of its longest episodes, or to random numbers without one, and will be
    fitted to ``steps``. ``known`` times are used again, so that a run is planned twice in the same way.
    """
    if resolve() == "reference":
        return {}
    times = {text: seconds for spec in specs if (seconds := known.get(text := str(spec)))}
    unknown = [spec for spec in specs if str(spec) not in times and may_be_slow(models.get(spec.name))]
    if unknown:
        data = random_steps(system, SAMPLES[-1]) if dataset is None else dataset
        parts = tuple(data.with_episodes(_longest(data, count)) for count in SAMPLES)
        for spec in unknown:
            most = min(steps, spec.parameters.get("max_steps") or steps)
            times[str(spec)] = _timed(models.get(spec.name), str(spec), _Sample(data.fingerprint, parts), most)
    return {text: seconds for text, seconds in times.items() if seconds > 0.0}


def _longest(data: Dataset, count: int) -> list[Trajectory]:
    """Return the longest episodes with ``count`` steps in all, or fewer; the last one may be cut."""
    found = list[Trajectory]()
    for episode in sorted(data.episodes, key=len, reverse=True):
        left = count - sum(map(len, found))
        if left > 0:
            found.append(episode[:left])
    return found


@dataclass(frozen=True)
class _Sample:
    """Data for a timing, equal if their ``fingerprint`` is."""

    fingerprint: str
    parts: tuple[Dataset, ...] = field(compare=False)


@lru_cache(maxsize=64)
def _timed(family: Any, text: str, sample: _Sample, steps: int) -> float:
    """Return the seconds, with two digits; 0 for a quick model and for one that cannot be fitted here."""
    times, grows = list[float](), False
    for data in sample.parts:
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                model: DynamicsModel = models.make(Spec.parse(text))
                model.set_params(**(getattr(family, "timing_parameters", None) or {}))
                model.fit(data, rng=np.random.default_rng(0))
            times.append(_seconds(model))
            grows = model.kernel() is None or not getattr(model, "depth_only", False)
        except Exception:  # the cell of the fit reports the reason
            return 0.0
    few, more = times
    counts = [data.n_steps for data in sample.parts]
    grows = grows and more > GROWS * few and counts[1] > counts[0]
    growth = (more - few) / (counts[1] - counts[0]) if grows else 0.0
    found = more + growth * max(0, steps - counts[1])
    return float(f"{found:.2g}") if found > QUICK else 0.0


def _seconds(model: DynamicsModel) -> float:
    """Return the processor time of a step of one rollout in s; 0 for a compiled model with noise."""
    kernel, nx = model.kernel(), model.system.nx
    carry = started(model, np.resize(model.training_sample_[:, :nx], (ROLLOUTS, nx)))
    control = np.tile(model.system.neutral_control, (ROLLOUTS, 1))
    if kernel is None:
        noise = np.zeros((ROLLOUTS, model.n_noise)) if model.n_noise else None
        return _shortest(lambda: model.step(carry, control, noise)) / ROLLOUTS + IN_NUMPY
    if model.n_noise:
        return 0.0

    def run(steps: int) -> float:
        controls, learned = np.repeat(control[:, None], steps, axis=1), kernel.parameters[None]
        bounds, precision = model.state_bounds_, kernel.precision
        return _shortest(
            lambda: free_runs(
                kernel.source, kernel.n_scratch, learned, carry[None], controls, bounds, precision=precision
            )
        )

    return (run(1 + STEPS_TIMED) - run(1)) / (ROLLOUTS * STEPS_TIMED)


def _shortest(call: Callable[[], object]) -> float:
    times = []
    for _ in range(3):
        began = time.process_time()
        call()
        times.append(time.process_time() - began)
    return min(times)


def random_steps(system: System, count: int) -> Dataset:
    """Return a recording of random numbers, where only the number of channels matters."""
    rng = np.random.default_rng(0)

    def drawn(channels: Sequence[Channel], rows: int) -> Array:
        found = np.empty((rows, len(channels)))
        for column, channel in zip(found.T, channels, strict=True):
            spread = 0.5 * (channel.high - channel.low) if channel.bounded else 1.0
            column[:] = np.clip(channel.neutral + spread * rng.uniform(-1.0, 1.0, rows), channel.low, channel.high)
        return found

    states, controls = drawn(system.states, count + 1), drawn(system.controls, count)
    return Dataset(system, (Trajectory(states, controls, system.dt),))


def limited(experiment: Experiment, members: Collection[Plant]) -> Experiment:
    """Return ``experiment`` with as many generations as fit into ``search_minutes``, if ``members`` are slow."""
    budget, seconds = experiment.budget, sum(member.slow for member in members)
    generation = budget.repeats * budget.trials * CANDIDATES * STEPS * seconds
    most = max(FEWEST, int(60.0 * experiment.search_minutes / generation)) if seconds else budget.generations
    if most >= budget.generations:
        return experiment
    fewer = {"generations": most, "polish_generations": min(budget.polish_generations, most)}
    return experiment.model_copy(update=fewer)


def slow_remarks(experiment: Experiment, members: Collection[Plant]) -> list[str]:
    """Return a sentence for each of ``members`` in which searches have fewer generations, or take long all the same."""
    found = []
    for member in members:
        fewer = limited(experiment, (member,)).budget
        if fewer.generations < experiment.budget.generations:
            minutes = fewer.repeats * fewer.generations * fewer.trials * CANDIDATES * STEPS * member.slow / 60.0
            found.append(
                f"{member.label}: {fewer.generations} of {experiment.budget.generations} generations, about "
                f"{minutes:.2g} min for a search on one processor, because a step takes {1e6 * member.slow:.2g} µs. "
                "search_minutes sets that time"
            )
    return found
