"""The model family adapted: a model with a correction for a new condition."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Self

import numpy as np

from sysid_evo.artefacts import is_stored_artefact
from sysid_evo.data.dataset import Dataset
from sysid_evo.data.support import KEPT_PAIRS
from sysid_evo.data.trajectory import evenly_spaced
from sysid_evo.errors import IncompatibleSystem, InvalidArgument
from sysid_evo.kernels import DynamicsKernel
from sysid_evo.models.adaptation.action import ActionCorrection
from sysid_evo.models.adaptation.correction import CorrectionTerms
from sysid_evo.models.adaptation.selection import NEW_FIT, NONE, REFIT, LearnedCorrection, adaptation
from sysid_evo.models.base import DynamicsModel, make_model
from sysid_evo.models.kernels.correction import action_kernel, correction_kernel
from sysid_evo.models.learned import Declared, Numbers
from sysid_evo.models.stochastic import StochasticModel
from sysid_evo.models.storage import load_model
from sysid_evo.progress import Progress
from sysid_evo.registry.registry import register_model
from sysid_evo.system import System
from sysid_evo.types import Array
from sysid_evo.validation.intervals import MAX_WINDOWS, Case, horizon_scales, step_spread, usable_horizon


@register_model("adapted")
class Adapted(DynamicsModel):
    """A model plus a correction of its accelerations or of its action, if the correction passes an acceptance test.

    ``base`` is the path of a stored model, or a family, which is first fitted to the same data; None in a model
    made by ``model.adapt(dataset)``.

    The acceleration c = C phi(x, u) is added to that of the base. phi contains 1, state and control; then also the
    accelerations that the base predicts; then also products of states and controls. All are clipped to the range of the
    data. C is fitted to simulations of one second with a ridge penalty. So is the correction of the action, which
    gives the base gain * u + offset in place of every control u, in phi as well.

    Other candidates are a fine-tuned base, a fit of its family to the new data, a refit to old and new data, and the
    means of these and the best correction (a base of the family ``average``). The acceptance test holds out three
    blocks of time in turn: the error must be at least 15 % lower over all blocks together, statistically significant,
    and in no block more than 10 % higher; fine-tuned models have to pass a stricter test. Otherwise the model is its
    base. `fit_note` reports the decision. The noise of a ``stochastic`` base is calibrated again on the blocks,
    each simulated by the model fitted without it.
    """

    knowledge = "dark grey"
    periodic = True

    base: str | None = "linear"

    def given(self, base: DynamicsModel, training: Dataset | None = None) -> Self:
        """Return this model with the ``base`` for `fit` to adapt and, for a refit, its ``training`` data."""
        self.base_ = base
        vars(self)["_training"] = None if training is None else as_of(base.system, training)
        return self

    def check_system(self, system: System) -> None:
        if self.base is not None and not is_stored_artefact(self.base, "model"):
            make_model(self.base).check_system(system)

    def fit(self, dataset: Dataset, *, rng: np.random.Generator, progress: Progress | None = None) -> Self:
        training = vars(self).pop("_training", None)
        if self.base is not None:
            self.base_ = (
                load_model(Path(self.base))
                if is_stored_artefact(self.base, "model")
                else make_model(self.base).fit(dataset, rng=rng)
            )
        elif not hasattr(self, "base_"):
            raise InvalidArgument(
                "adapted: there is no model to adapt: give base=, the path of a stored model or a family, or call "
                "adapt(dataset) of a fitted model"
            )
        dataset = as_of(self.base_.system, dataset)
        found = adaptation(self.base_, dataset, training=training, rng=rng, progress=progress)
        self.base_ = found.learned.model
        self._hold(found.learned)
        self.decision_, self.chosen_ = found.decision.sentence, found.decision.chosen
        self.test_errors_ = [[trial.error, *trial.each] for trial in found.decision.trials]
        self.candidates_ = [trial.name for trial in found.decision.trials]
        self._widen()
        base = self.base_
        if isinstance(base, StochasticModel) and base.timed and self.chosen_ not in (NONE, NEW_FIT, REFIT):
            self.base_ = calibrated_elsewhere(base, found.fold_results, rng)
        return self

    @classmethod
    def holding(cls, learned: LearnedCorrection) -> Self:
        """Return a fitted model made of a model and its correction, without an acceptance test."""
        one = cls(base=None).given(learned.model)
        one._hold(learned)
        one.state_bounds_, one.training_sample_ = learned.model.state_bounds_, learned.model.training_sample_
        return one

    def _hold(self, learned: LearnedCorrection) -> None:
        self.system_ = self.base_.system
        for name, array in learned.terms.arrays.items():
            setattr(self, f"{name}_", array)
        self.coefficients_ = learned.coefficients
        action = learned.action or ActionCorrection.none(self.system_)
        self.gain_, self.offset_, self.delay_ = action.gain, action.offset, np.array([action.delay])

    def learned_arrays(self) -> Mapping[str, Declared]:
        if differences := self.system.differences(self.base_.system):
            raise IncompatibleSystem(f"base_ is of another system: {'; '.join(differences)}")
        return {
            **{f"{name}_": lengths for name, lengths in self.terms.lengths.items()},
            "coefficients_": self.terms.shape,
            "gain_": (self.system.nu,),
            "offset_": (self.system.nu,),
            "delay_": Numbers(1, least=0.0, most=1.0),
        }

    def _widen(self) -> None:
        """Extend state bounds and training sample by those of the base; use those of the base if nothing was chosen."""
        if self.chosen_ == NONE:
            self.state_bounds_ = self.base_.state_bounds_.copy()
            self.training_sample_ = self.base_.training_sample_.copy()
            return
        own, other = self.state_bounds_, self.base_.state_bounds_
        self.state_bounds_ = np.stack([np.minimum(own[0], other[0]), np.maximum(own[1], other[1])])
        pairs = np.concatenate([self.base_.training_sample_, self.training_sample_])
        self.training_sample_ = pairs[evenly_spaced(len(pairs), KEPT_PAIRS, nearest=True)]

    @functools.cached_property
    def terms(self) -> CorrectionTerms:
        """The regressors of the correction."""
        arrays = [getattr(self, f"{field.name}_") for field in fields(CorrectionTerms) if field.name != "system"]
        return CorrectionTerms(self.system, *arrays)

    @property
    def corrects(self) -> bool:
        """Whether accelerations are corrected."""
        return bool(np.any(self.coefficients_))

    @functools.cached_property
    def action(self) -> ActionCorrection:
        """The correction of the action."""
        return ActionCorrection(self.gain_, self.offset_, float(self.delay_[0]))

    def without_noise(self) -> Self:
        quiet = self.base_.without_noise()
        if quiet is self.base_:
            return self
        other = self.variant()
        other.base_ = quiet
        return other

    @property
    def fit_note(self) -> str:
        return str(self.decision_) if hasattr(self, "decision_") else super().fit_note

    @property
    def lags(self) -> tuple[int, int]:
        states, controls = self.base_.lags if hasattr(self, "base_") else (0, 0)
        return states, controls + self.memory

    @property
    def n_lags(self) -> int:
        return self.base_.n_lags + self.memory if hasattr(self, "base_") else 0

    @property
    def n_carry(self) -> int:
        return self.base_.n_carry + self.memory * self.system.nu

    @property
    def memory(self) -> int:
        """Number of earlier controls at the end of the carry: 1 if the correction of the action has a delay."""
        return self.action.memory if hasattr(self, "delay_") else 0

    @property
    def n_noise(self) -> int:
        return self.base_.n_noise if hasattr(self, "base_") else 0

    @property
    def n_draws(self) -> int:
        return self.base_.n_draws if hasattr(self, "base_") else 0

    @property
    def n_recent(self) -> int:
        return self.base_.n_recent if hasattr(self, "base_") else 0

    def start(self, states: Array, controls: Array, draws: Array | None = None) -> Array:
        carry = self.base_.start(*self.action.history(states, controls), draws)
        return self.action.joined(carry, controls)

    def step(self, carry: Array, control: Array, noise: Array | None = None) -> Array:
        inner, applied = self.action.split(carry, control)
        after = self.base_.step(inner, applied, noise)
        if self.corrects:
            after = self.terms.next_carry(inner, applied, after, self.coefficients_)
        return self.action.joined(after, control[:, None])

    def kernel(self) -> DynamicsKernel | None:
        return self._corrected_kernel

    @functools.cached_property
    def _corrected_kernel(self) -> DynamicsKernel | None:
        kernel = self.base_.kernel()
        if kernel is not None and self.corrects:
            kernel = correction_kernel(kernel, self.system, self.terms.arrays, self.coefficients_)
        if kernel is None or not self.action.changes:
            return kernel
        return action_kernel(kernel, self.gain_, self.offset_, self.action.delay, self.base_.n_carry)

    def equations(self) -> list[str]:
        """Return the equations of the base, if it has some, and the correction of each acceleration or control."""
        of_base = self.base_.equations()
        if self.action.changes:
            numbers = zip(self.system.control_names, self.gain_, self.offset_, strict=True)
            late = f", {self.action.delay:.2f} samples later" if self.action.delay else ""
            of_base += [f"{name} -> {gain:.3g} {name} {offset:+.3g}{late}" for name, gain, offset in numbers]
        if not self.corrects:
            return of_base
        names = ["1", *self.terms.names]
        added = []
        for channel, of_channel in zip(self.system.states, (self.coefficients_ * self.terms.unit).T, strict=True):
            sums = " ".join(f"{value:+.3g} {name}" for name, value in zip(names, of_channel, strict=True))
            added.append(f"d {channel.name}/dt += {sums}   (standardised)")
        return [*of_base, *added]


@dataclass(frozen=True)
class CorrectedSteps:
    """The disturbed steps of ``base`` under a corrected action, with a correction after the disturbance."""

    base: StochasticModel
    terms: CorrectionTerms
    coefficients: Array
    action: ActionCorrection

    @property
    def n_lags(self) -> int:
        return self.base.n_lags + self.action.memory

    @property
    def system(self) -> System:
        return self.base.system

    @property
    def state_bounds(self) -> Array | None:
        return self.base.state_bounds

    def initial_carry(self, states: Array, controls: Array) -> Array:
        return self.action.joined(self.base.initial_carry(*self.action.history(states, controls)), controls)

    def disturbed(self, carry: Array, control: Array, disturbance: Array) -> Array:
        inner, applied = self.action.split(carry, control)
        after = self.base.disturbed(inner, applied, disturbance)
        after = self.terms.next_carry(inner, applied, after, self.coefficients)
        return self.action.joined(after, control[:, None])


def calibrated_elsewhere(
    base: StochasticModel, fold_results: Sequence[LearnedCorrection], rng: np.random.Generator
) -> StochasticModel:
    """Return ``base`` with the noise of the models in ``fold_results``, each on its data ``held`` out.

    That is the error of one step, its persistent share, and the scales of `horizon_scales`; the last scale also holds
    beyond the longest simulation that the held-out data allow.
    """
    pairs = [
        (
            CorrectedSteps(
                one.model.variant(), one.terms, one.coefficients, one.action or ActionCorrection.none(base.system)
            ),
            one.held,
        )
        for one in fold_results
        if isinstance(one.model, StochasticModel) and one.held is not None
    ]
    no_noise = np.zeros(base.system.nx)
    residual, persistent = step_spread(pairs, lambda steps, carry, control: steps.disturbed(carry, control, no_noise))
    horizon = usable_horizon([held for _, held in pairs], base.n_lags)
    for steps, _ in pairs:
        steps.base.residual_ = residual
    cases = [Case.of(steps, held, horizon, MAX_WINDOWS // len(pairs)) for steps, held in pairs]
    other = base.variant()
    other.keep_spread(residual, persistent, horizon_scales(cases, persistent, rng))
    return other


def as_of(system: System, dataset: Dataset) -> Dataset:
    """Return ``dataset`` as a recording of ``system``; limits of continuous channels may differ.

    Raises `IncompatibleSystem` if channels, dt or motion differ.
    """
    if dataset.system == system:
        return dataset
    other = dataset.system
    same = len(other.controls) == len(system.controls) and len(other.states) == len(system.states)
    differences = other.differences(system)
    if same:
        controls = tuple(
            replace(theirs, low=own.low, high=own.high, neutral=own.neutral) if theirs.levels is None else theirs
            for own, theirs in zip(system.controls, other.controls, strict=True)
        )
        differences = system.differences(replace(other, controls=controls))
    if differences:
        raise IncompatibleSystem(f"adapt: the data are of another system: {'; '.join(differences)}")
    return Dataset(system, dataset.episodes, dataset.notes)
