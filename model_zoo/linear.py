"""Family linear: least squares of the next state (dynamic mode decomposition with control, ARX)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Self

import numpy as np

from model_zoo.features import between_limits
from model_zoo.scaling import deviation
from sysid_evo import Dataset, register_model
from sysid_evo.models.kernels import Predictor, network_predictor
from sysid_evo.models.learned import Declared
from sysid_evo.models.parameters import Limit, at_least
from sysid_evo.models.stochastic import StochasticModel
from sysid_evo.progress import Progress
from sysid_evo.types import Array


@register_model("linear")
class Linear(StochasticModel):
    """Linear difference equation, fitted by least squares: the fastest family, a baseline for the others.

    x_{k+1} = A x_k + B u_k + c (Proctor, Brunton, Kutz 2016, DMDc). ``state_lags`` and ``control_lags`` add that many
    earlier samples to x_k and u_k (ARX). ``ridge`` is the L2 penalty of A and B on standardised inputs; ``intercept``
    fits c. Samples that end at a limit of a channel are not used. An angle is a plain number here, because LQR needs A
    and B: the model is valid near one angle only.
    """

    knowledge = "black"
    fast_fit = True
    model_class = "polynomial"
    limits: ClassVar[dict[str, Limit]] = {"ridge": at_least(0)}

    ridge: float = 0.0
    intercept: bool = True
    state_lags: int = 0
    control_lags: int = 0

    def fit(self, dataset: Dataset, *, rng: np.random.Generator, progress: Progress | None = None) -> Self:
        data = dataset.transitions(state_lags=self.lags[0], control_lags=self.lags[1])
        free = between_limits(dataset.system, data.after)
        regressors, after = np.concatenate([data.carry, data.control], axis=1)[free], data.after[free]
        centre = regressors.mean(axis=0) if self.intercept else np.zeros(regressors.shape[1])
        target_centre = after.mean(axis=0) if self.intercept else np.zeros(after.shape[1])
        scale = deviation(regressors)
        penalty = np.sqrt(self.ridge * len(after)) * np.eye(len(scale))
        left = np.concatenate([(regressors - centre) / scale, penalty])
        right = np.concatenate([after - target_centre, np.zeros((len(scale), after.shape[1]))])
        solution, *_ = np.linalg.lstsq(left, right, rcond=None)
        self.coefficients_ = solution / scale[:, None]
        self.intercept_ = target_centre - centre @ self.coefficients_
        self.calibrate(dataset, rng)
        return self

    def learned_arrays(self) -> Mapping[str, Declared]:
        nx = self.system.nx
        return {"coefficients_": (self.layout.size + self.system.nu, nx), "intercept_": (nx,)}

    def next_state(self, carry: Array, control: Array) -> Array:
        n = carry.shape[1]
        return carry @ self.coefficients_[:n] + control @ self.coefficients_[n:] + self.intercept_

    def predictor(self) -> Predictor:
        return network_predictor([[(self.coefficients_, self.intercept_)]], self.n_carry, self.system.nu)
