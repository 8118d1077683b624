"""A sparse Gaussian process of the acceleration, with its predictive variance."""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from scipy.linalg import cho_solve, cholesky
from sklearn.base import clone

from model_zoo.spread import calibrated_scale, growth_on_unseen_recordings
from model_zoo.standardise import Standard, positive
from model_zoo.stepwise import lagged_steps
from model_zoo.validation import lag_candidates, simulation_error, time_blocks, validation_windows
from sysid_evo.arrays import Array
from sysid_evo.data import Dataset
from sysid_evo.dynamics import DynamicsModel
from sysid_evo.errors import InvalidArgument
from sysid_evo.progress import Progress
from sysid_evo.registry import register_model

if TYPE_CHECKING:
    from sysid_evo.engine.compiled.kernel import DynamicsKernel

JITTER = 1e-6
LINEAR_RIDGE = 1e-3
TRIAL_INDUCING = 120


@register_model("gaussian_process")
class GaussianProcess(DynamicsModel):
    """Acceleration = linear part + Gaussian process of (carry, control), squared exponential, one length an input.

    The linear part, fitted first by ridge regression, is what remains far from the data.
    The lengths maximise the marginal likelihood on ``inducing`` random steps; the same steps are the
    inducing points of the deterministic training conditional over all data (Seeger 2003; Quinonero
    Candela, Rasmussen 2005, equation 20): mean k_* S K_uf y / s^2, variance
    k_** - k_* (K_uu^-1 - S) k_*^T + s^2 with S = (K_uu + K_uf K_fu / s^2)^-1. Lags left at None are
    chosen by the simulation error over one second on held-out blocks of time. With ``stochastic``
    every step adds normal noise of that variance, scaled so that 90 % intervals hold 90 % of
    held-out samples after one second. A fit with ``stochastic`` also holds out whole recordings in
    turn, and widens the intervals by how much more errors there are than on held-out blocks
    (`growth_on_unseen_recordings`).
    """

    knowledge = "dark grey"
    presets: ClassVar[dict[str, dict[str, Any]]] = {"quick": {"inducing": 40, "state_lags": 0, "control_lags": 0}}

    def __init__(
        self,
        *,
        inducing: int = 250,
        state_lags: int | None = None,
        control_lags: int | None = None,
        stochastic: bool = False,
        rest_hold: bool = False,
    ) -> None:
        self.inducing = inducing
        self.state_lags = state_lags
        self.control_lags = control_lags
        self.stochastic = stochastic
        self.rest_hold = rest_hold

    @property
    def n_noise(self) -> int:  # type: ignore[override]  # follows from the hyper-parameters
        return self.system.nx if self.stochastic else 0

    def fit(self, dataset: Dataset, *, rng: np.random.Generator, progress: Progress | None = None) -> Self:
        if self.inducing < 2:
            raise InvalidArgument(f"gaussian_process: expected at least 2 inducing points, got {self.inducing}")
        options = lag_candidates(self.state_lags, self.control_lags, ((0, 0), (0, 3), (1, 3)))
        learned, held = time_blocks(dataset)
        trials, errors = [], []
        for number, option in enumerate(options):
            trials.append(self._trial(learned, option, rng))
            errors.append(simulation_error(trials[-1], validation_windows(held, trials[-1].n_lags)))
            if progress is not None:
                progress(number + 1, len(options) + 1)
        chosen = int(np.argmin(errors))
        lags = options[chosen]
        if self.state_lags is None:
            self.state_lags_ = lags[0]
        if self.control_lags is None:
            self.control_lags_ = lags[1]
        self._learn(dataset, lags, rng)
        self.noise_scale_ = np.ones(self.system.nx)
        self._calibrate(dataset, trials[chosen], held, rng)
        if progress is not None:
            progress(len(options) + 1, len(options) + 1)
        return self

    def step(self, carry: Array, control: Array, noise: Array | None = None) -> Array:
        state = carry[:, : self.system.nx]
        mean, variance = self.predicted(carry, control, with_variance=noise is not None)
        after = self.system.integrate(state, mean)
        if noise is not None:
            after = after + self.noise_scale_ * np.sqrt(variance) * self.system.dt * noise
        return self.remember(carry, control, self.held(carry, control, after))

    def kernel(self) -> DynamicsKernel | None:
        from sysid_evo.engine.kernels import gaussian_predictor, stepping_kernel

        if self.stochastic:
            return None
        predictor = gaussian_predictor(
            self.points_,
            self.lengths_,
            self.weights_ * self.amplitude_[:, None] ** 2,
            self.slope_,
            self.intercept_,
            self.n_carry,
        )
        shell = stepping_kernel(predictor, self.system, output="acceleration", lags=self.lags, rest_band=self.rest_band)
        return replace(shell, precision="float64")  # its large weights cancel

    def predicted(self, carry: Array, control: Array, *, with_variance: bool = True) -> tuple[Array, Array]:
        """Return mean and variance (B, nx) of the acceleration; without variance, zeros for it."""
        inputs = np.concatenate([carry, control], axis=1)
        mean = np.empty((len(inputs), self.system.nx))
        variance = np.zeros_like(mean)
        for channel in range(self.system.nx):
            kernel = self._kernel(inputs, self.points_, channel)
            mean[:, channel] = kernel @ self.weights_[channel]
            if with_variance:
                explained = np.sum((kernel @ self.reduction_[channel]) * kernel, axis=1)
                prior = self.amplitude_[channel] ** 2
                variance[:, channel] = np.maximum(prior - explained, 0.0) + self.noise_[channel] ** 2
        return mean + inputs @ self.slope_ + self.intercept_, variance

    def _kernel(self, left: Array, right: Array, channel: int) -> Array:
        """Return the covariance (A, B) of inputs (A, n) and (B, n)."""
        a, b = left / self.lengths_[channel], right / self.lengths_[channel]
        square = np.sum(a**2, axis=1)[:, None] + np.sum(b**2, axis=1) - 2.0 * a @ b.T
        return self.amplitude_[channel] ** 2 * np.exp(-0.5 * np.maximum(square, 0.0))

    def _trial(self, dataset: Dataset, lags: tuple[int, int], rng: np.random.Generator) -> GaussianProcess:
        """Return a smaller model without noise that learned from ``dataset``, with the envelope of this one."""
        trial = clone(self).set_params(
            state_lags=lags[0], control_lags=lags[1], inducing=min(TRIAL_INDUCING, self.inducing), stochastic=False
        )
        trial.system_, trial.envelope_ = self.system_, self.envelope_
        trial._learn(dataset, lags, rng)
        return trial

    def _calibrate(self, dataset: Dataset, trial: GaussianProcess, held: Dataset, rng: np.random.Generator) -> None:
        """Set the scale of the noise (nx,) with which intervals hold the errors of ``trial`` on ``held``."""
        together = clone(self).set_params(stochastic=False)
        together.__dict__.update({key: value for key, value in vars(self).items() if key.endswith("_")})
        growth = np.ones(self.system.nx)
        if self.stochastic:
            growth = growth_on_unseen_recordings(lambda part: self._trial(part, self.lags, rng), dataset)
        windows = validation_windows(held, self.n_lags)
        history = windows.past_states, windows.past_controls, windows.controls
        error = windows.states - trial.simulate(*history)
        truth = replace(windows, states=together.simulate(*history) + growth * error)
        self.noise_scale_ = calibrated_scale(self, truth, rng)

    def _learn(self, dataset: Dataset, lags: tuple[int, int], rng: np.random.Generator) -> None:
        from sklearn.gaussian_process import GaussianProcessRegressor
        from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

        carry, control, after = lagged_steps(dataset, lags)
        inputs = np.concatenate([carry, control], axis=1)
        targets = dataset.system.acceleration(carry[:, : dataset.system.nx], after)
        _, scale = Standard.of(dataset).of_inputs(lags)
        rows = np.sort(rng.choice(len(inputs), size=min(self.inducing, len(inputs)), replace=False))
        centre = inputs.mean(axis=0)
        gram = (inputs - centre).T @ (inputs - centre) + LINEAR_RIDGE * len(inputs) * np.diag(scale**2)
        self.slope_ = np.linalg.solve(gram, (inputs - centre).T @ (targets - targets.mean(axis=0)))
        self.intercept_ = targets.mean(axis=0) - centre @ self.slope_
        targets = targets - inputs @ self.slope_ - self.intercept_
        size = positive(targets.std(axis=0))
        nx, n = targets.shape[1], inputs.shape[1]
        self.points_ = inputs[rows]
        self.lengths_, self.amplitude_, self.noise_ = np.empty((nx, n)), np.empty(nx), np.empty(nx)
        self.weights_, self.reduction_ = np.empty((nx, len(rows))), np.empty((nx, len(rows), len(rows)))
        for channel in range(nx):
            kernel = ConstantKernel(1.0, (1e-2, 1e2)) * RBF(np.full(n, 3.0), (0.3, 100.0))
            search = GaussianProcessRegressor(kernel + WhiteKernel(0.1, (1e-4, 1.0)))
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # a length at its bound says that the input does not matter
                search.fit(inputs[rows] / scale, targets[rows, channel] / size[channel])
            found = search.kernel_
            self.amplitude_[channel] = np.sqrt(found.k1.k1.constant_value) * size[channel]
            self.lengths_[channel] = found.k1.k2.length_scale * scale
            self.noise_[channel] = np.sqrt(found.k2.noise_level) * size[channel]
            self._condition(channel, inputs, targets[:, channel])

    def _condition(self, channel: int, inputs: Array, targets: Array) -> None:
        """Set weights and variance reduction of one channel from all data."""
        points, square = self.points_, self.noise_[channel] ** 2
        identity = np.eye(len(points))
        own = self._kernel(points, points, channel) + JITTER * self.amplitude_[channel] ** 2 * identity
        cross = self._kernel(points, inputs, channel)
        posterior = cholesky(own + cross @ cross.T / square, lower=True)
        self.weights_[channel] = cho_solve((posterior, True), cross @ targets) / square
        prior = cho_solve((cholesky(own, lower=True), True), identity)
        self.reduction_[channel] = prior - cho_solve((posterior, True), identity)
