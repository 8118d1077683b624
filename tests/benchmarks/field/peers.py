"""Other packages as model families, each with the settings of its authors; a plugin file for a comparison.

The families hold arrays only, so that a run stores them. A step is NumPy or PyTorch: the plan times it.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping
from functools import cached_property
from typing import Any, ClassVar, Self

import numpy as np

from sysid_evo import Dataset, DynamicsModel, register_model
from sysid_evo.models.kernels import Predictor, network_predictor, polynomial_predictor
from sysid_evo.progress import Progress
from sysid_evo.types import Array


def joined(dataset: Dataset) -> tuple[Array, Array]:
    """Return states (T, nx) and the controls before them (T, nu) of all episodes, one after the other.

    None of these packages but deepSI takes several episodes; a joint is a wrong sample in a thousand.
    """
    states = np.concatenate([episode.states[1:] for episode in dataset])
    return states, np.concatenate([episode.controls for episode in dataset])


@register_model("sysidentpy_frols")
class SysIdentPyFrols(DynamicsModel):
    """SysIdentPy: polynomial NARX by FROLS, one for each state; the others and the controls are its inputs.

    Settings of "Building Polynomial NARX models with FROLS algorithm" in its README, but up to 20 terms instead of 3.
    """

    state_lags: int | None = 1
    control_lags: int | None = 1

    def fit(self, dataset: Dataset, *, rng: np.random.Generator, progress: Progress | None = None) -> Self:
        (nx, nu), (states, before) = (dataset.system.nx, dataset.system.nu), joined(dataset)
        channels = np.concatenate([states, np.concatenate([before[1:], before[-1:]])], axis=1)
        late = [*range(nx, 2 * nx), *range(2 * nx, 2 * nx + nu)]  # places in carry and control, one step before
        places = np.array([[*range(nx), *range(2 * nx + nu, 2 * (nx + nu))], late])
        lags: Any = [[1, 2]] * (nx - 1 + nu) if nx - 1 + nu > 1 else [1, 2]
        powers, weights = list[Array](), list[Array]()
        for i in range(nx):
            order = [i, *(j for j in range(nx + nu) if j != i)]
            for codes, weight in self.terms(channels[:, order[1:]], channels[:, [i]], lags):
                used = [places[code % 1000 - 1, order[code // 1000 - 1]] for code in codes[codes > 0]]
                powers.append(np.bincount(np.array(used, dtype=np.int64), minlength=2 * (nx + nu)))
                weights.append(weight * np.eye(nx)[i])
        self.powers_, self.coefficients_ = np.array(powers), np.array(weights)
        return self

    def terms(self, x: Array, y: Array, lags: Any) -> Iterable[tuple[Array, float]]:
        """Return the codes of SysIdentPy and the weight of each term for the next of ``y`` (T, 1), of inputs (T, n)."""
        from sysidentpy.basis_function import Polynomial
        from sysidentpy.model_structure_selection import FROLS

        most = min(20, math.comb(2 * (x.shape[1] + 1) + 2, 2))
        model = FROLS(n_info_values=most, ylag=2, xlag=lags, basis_function=Polynomial(degree=2), **frols_example())
        model.fit(X=x, y=y)
        return zip(model.final_model, np.ravel(model.theta), strict=True)

    def next_state(self, carry: Array, control: Array) -> Array:
        return np.prod(np.concatenate([carry, control], axis=1)[:, None] ** self.powers_, axis=2) @ self.coefficients_

    def predictor(self) -> Predictor:
        return polynomial_predictor(self.powers_, self.coefficients_, self.n_carry, self.system.nu)


def frols_example() -> dict[str, Any]:
    """Return the other settings of the example."""
    from sysidentpy.parameter_estimation import LeastSquares

    return {"order_selection": True, "info_criteria": "aic", "estimator": LeastSquares(), "err_tol": None}


@register_model("sysidentpy_narx")
class SysIdentPyNarx(SysIdentPyFrols):
    """SysIdentPy: its general NARX with Bayesian ridge regression, on all terms, as in "General NARX models"."""

    def terms(self, x: Array, y: Array, lags: Any) -> Iterable[tuple[Array, float]]:
        from sklearn.linear_model import BayesianRidge
        from sysidentpy.basis_function import Polynomial
        from sysidentpy.general_estimators import NARX

        found = BayesianRidge()
        model = NARX(base_estimator=found, ylag=2, xlag=lags, basis_function=Polynomial(degree=2)).fit(X=x, y=y)
        constant = np.zeros_like(model.final_model[0])
        return [(constant, found.intercept_), *zip(model.final_model, found.coef_, strict=True)]


@register_model("pydmd_dmdc")
class PyDmdc(DynamicsModel):
    """PyDMD: dynamic mode decomposition with control, all modes (``svd_rank=-1``), as in its tutorial on DMDc."""

    def fit(self, dataset: Dataset, *, rng: np.random.Generator, progress: Progress | None = None) -> Self:
        from pydmd import DMDc

        states, before = joined(dataset)
        found = DMDc(svd_rank=-1).fit(states.T, before[1:].T)
        basis = found.basis
        a = basis @ found.operator.as_numpy_array @ basis.conj().T
        self.coefficients_ = np.concatenate([a.real.T, np.real(found.B).T])
        return self

    def next_state(self, carry: Array, control: Array) -> Array:
        return np.concatenate([carry, control], axis=1) @ self.coefficients_

    def predictor(self) -> Predictor:
        return network_predictor([[(self.coefficients_, np.zeros(self.system.nx))]], self.n_carry, self.system.nu)


class WithHiddenState(DynamicsModel):
    """A model whose carry is the state, then ``n_hidden`` numbers that it estimates from a history of ``history``."""

    history: ClassVar[int] = 20

    @property
    def n_hidden(self) -> int:
        """Number of hidden states."""
        raise NotImplementedError

    @property
    def n_lags(self) -> int:
        return self.history

    @property
    def n_carry(self) -> int:
        return self.system.nx + self.n_hidden

    def initial_carry(self, states: Array, controls: Array) -> Array:
        return np.concatenate([states[:, -1], self.estimated(states, controls)], axis=1)

    def estimated(self, states: Array, controls: Array) -> Array:
        """Return the hidden state (B, n_hidden) after a history (B, L + 1, nx), (B, L, nu)."""
        raise NotImplementedError


@register_model("nfoursid")
class NFourSid(WithHiddenState):
    """nfoursid: N4SID with ten block rows, as in its notebook, where the order is read off a picture.

    Here it is at the largest gap.
    """

    def fit(self, dataset: Dataset, *, rng: np.random.Generator, progress: Progress | None = None) -> Self:
        import pandas as pd
        from nfoursid.nfoursid import NFourSID

        states, before = joined(dataset)
        y, u = list(dataset.system.state_names), list(dataset.system.control_names)
        found = NFourSID(pd.DataFrame(np.concatenate([states, before], axis=1), columns=y + u), y, u, num_block_rows=10)
        found.subspace_identification()
        values = np.diag(found.R32_decomposition.eigenvalues)[:11]
        space, _ = found.system_identification(rank=1 + int(np.argmax(values[:-1] / values[1:])))
        self.a_, self.b_, self.c_, self.d_ = map(np.ascontiguousarray, (space.a, space.b, space.c, space.d))
        return self

    @property
    def n_hidden(self) -> int:
        return len(self.a_)

    def estimated(self, states: Array, controls: Array) -> Array:
        """Least squares of the state at the begin of the history, carried on to its end."""
        powers = list(itertools.accumulate([self.a_] * self.history, np.matmul, initial=np.eye(len(self.a_))))
        observed = np.concatenate([self.c_ @ power for power in powers[:-1]])
        forced, residual = np.zeros((len(states), len(self.a_))), []
        for k in range(self.history):
            residual.append(states[:, k + 1] - forced @ self.c_.T - controls[:, k] @ self.d_.T)
            forced = forced @ self.a_.T + controls[:, k] @ self.b_.T
        first = np.concatenate(residual, axis=1) @ np.linalg.pinv(observed).T
        return first @ powers[-1].T + forced

    def step(self, carry: Array, control: Array, noise: Array | None = None) -> Array:
        hidden = carry[:, self.system.nx :]
        after = hidden @ self.c_.T + control @ self.d_.T
        return np.concatenate([after, hidden @ self.a_.T + control @ self.b_.T], axis=1)


@register_model("deepsi_subnet")
class DeepSiSubnet(WithHiddenState):
    """deepSI: SUBNET with the settings of the example of its README and its default of ten hidden states.

    There are 2,000 updates of the network instead of 10,000, which take three minutes on one core. Every fifth episode
    is held out, or the last fifth of each if they are fewer. Histories and simulations have 20 steps, or as many as
    short episodes allow.
    """

    n_hidden: int = 10
    updates: int = 2_000
    timing_parameters: ClassVar[Mapping[str, Any]] = {"updates": 1}

    def fit(self, dataset: Dataset, *, rng: np.random.Generator, progress: Progress | None = None) -> Self:
        import deepSI
        import torch
        from deepSI.fitting import fit_minimal_implementation  # `fit` keeps its progress in pickled files

        torch.manual_seed(int(rng.integers(2**31)))
        usual, held = int(np.median([len(episode) for episode in dataset])), dataset.names[4::5]
        self.history_ = min(20, usual // 3 if held else usual // 10)
        parts = [
            [deepSI.Input_output_data(u=e.controls, y=e.states[:-1]) for e in part if len(e) >= 2 * self.history_]
            for part in dataset.split(held or 0.2)
        ]
        norm = deepSI.get_nu_ny_and_auto_norm(parts[0])[2]
        self.norm_ = [np.asarray(one, dtype=np.float64) for one in (norm.umean, norm.ustd, norm.ymean, norm.ystd)]
        self.weights_ = []
        size = min(256, sum(len(one.u) for one in parts[0]) // 3)
        best = fit_minimal_implementation(
            self._network, *parts, self.updates, T=self.history_, batch_size=size, val_freq=100
        )
        self.weights_ = [value.numpy().astype(np.float64) for value in best.values()]
        return self

    @property
    def n_lags(self) -> int:
        return self.history_

    @cached_property
    def _network(self) -> Any:
        import deepSI
        import torch

        network = deepSI.SUBNET(
            self.system.nu, self.system.nx, deepSI.Norm(*self.norm_), self.n_hidden, nb=self.history_, na=self.history_
        )
        if self.weights_:
            network.load_state_dict(dict(zip(network.state_dict(), map(torch.from_numpy, self.weights_), strict=True)))
        return network

    def estimated(self, states: Array, controls: Array) -> Array:
        return in_torch(self._network.encoder, controls, states[:, :-1])

    def step(self, carry: Array, control: Array, noise: Array | None = None) -> Array:
        hidden = in_torch(self._network.f, carry[:, self.system.nx :], control)
        return np.concatenate([in_torch(self._network.h, hidden), hidden], axis=1)


def in_torch(function: Any, *arrays: Array) -> Array:
    """Return a function of PyTorch of ``arrays``, in single precision."""
    import torch

    with torch.no_grad():
        return np.asarray(function(*(torch.from_numpy(one.astype(np.float32)) for one in arrays)), dtype=np.float64)
