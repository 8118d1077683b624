"""Family evolved3 (paper, section 4.2): one network for the acceleration of each state, set by evolution."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, Self

import numpy as np

from model_zoo.features import Features
from model_zoo.scaling import ChannelScaling
from sysid_evo import Dataset, DynamicsModel, register_model
from sysid_evo.evolution import ModelEvolution
from sysid_evo.evolution.model_evolution import Weights
from sysid_evo.kernels import DynamicsKernel
from sysid_evo.models.kernels import Predictor, network_predictor, with_angles
from sysid_evo.models.learned import Declared
from sysid_evo.models.parameters import Limit, above, at_least
from sysid_evo.progress import Progress
from sysid_evo.types import Array, IntArray


@register_model("evolved3")
class Evolved3(DynamicsModel):
    """One small network per state for its acceleration, with weights found by an evolution strategy.

    Every network has one layer of ``hidden`` tanh units and a linear output. All weights form one vector, which a 50+50
    strategy with Gaussian mutation (deviation 0.1) evolves for ``generations`` on the squared error ``horizon`` steps
    after ``windows`` random starts. Not stated in the paper: five hidden units, inputs divided by their standard
    deviations, outputs in units of each state's RMS change in one step, initial weights of deviation ``initial_std``.
    Lags (none in the paper) add earlier samples to the inputs; periodic states enter as sine and cosine.

    With ``error_units="spread"`` the error of every state is divided by its standard deviation. With "paper", the
    preset of that name, states count in their own units: the lateral speed, small in numbers, then hardly counts and
    can have a larger error than no change (192 % in table 1 of the paper).
    """

    knowledge = "dark grey"
    model_class = "network"
    typical_fit_seconds = 12.0
    periodic = True
    resumable = True
    presets: ClassVar[dict[str, dict[str, Any]]] = {
        "quick": {"generations": 150},
        "paper": {"error_units": "paper"},
    }
    limits: ClassVar[dict[str, Limit]] = {
        **{name: at_least(1) for name in ("hidden", "generations", "windows", "horizon")},
        "initial_std": above(0),
    }

    hidden: int = 5
    generations: int = 1000
    windows: int = 100
    horizon: int = 10
    initial_std: float = 0.5
    error_units: Weights = "spread"
    state_lags: int = 0
    control_lags: int = 0

    def fit(self, dataset: Dataset, *, rng: np.random.Generator, progress: Progress | None = None) -> Self:
        standard = ChannelScaling.of(dataset)
        self.centre_, self.scale_ = standard.of_inputs(self.layout)
        self.output_scale_ = standard.change / dataset.system.dt
        n = dataset.system.nx * (self.hidden * (len(self.centre_) + 1) + self.hidden + 1)
        search = ModelEvolution(
            generations=self.generations, windows=self.windows, horizon=self.horizon, error_units=self.error_units
        )
        self.parameters_ = search.run(
            self._advance,
            dataset,
            initial=np.zeros(n),
            spread=self.initial_std,
            rng=rng,
            progress=progress,
            checkpoint=self.checkpoint,
            kernel=self._kernels,
            start=self.initial_carry,
            history=self.n_lags,
        )
        return self

    def learned_arrays(self) -> Mapping[str, Declared]:
        n, nx = Features(self.system, self.lags).n_carry + self.system.nu, self.system.nx
        size = nx * (self.hidden * (n + 1) + self.hidden + 1)
        return {"centre_": (n,), "scale_": (n,), "output_scale_": (nx,), "parameters_": (size,)}

    def step(self, carry: Array, control: Array, noise: Array | None = None) -> Array:
        return self._advance(self.parameters_[None], carry[None], control)[0]

    def predictor(self) -> Predictor:
        return self._predictor(self.parameters_)

    def _predictor(self, parameters: Array) -> Predictor:
        """Return the compiled form of the networks with ``parameters`` (n,)."""
        nx, n = self.system.nx, len(self.centre_)
        first, first_bias, last, last_bias = np.split(parameters, self._cut)
        weights = first.reshape(n, nx * self.hidden) / self.scale_[:, None]
        own = np.repeat(np.eye(nx), self.hidden, axis=0)
        layers = [
            (weights, first_bias - self.centre_ @ weights),
            (own * last[:, None] * self.output_scale_, last_bias * self.output_scale_),
        ]
        seen = Features(self.system, self.lags).n_carry
        return with_angles(network_predictor([layers], seen, self.system.nu), self.system, self.lags)

    @property
    def _cut(self) -> IntArray:
        """Positions at which a parameter vector is split into first weights, biases, last weights, biases."""
        nx = self.system.nx
        return np.cumsum([nx * self.hidden * len(self.centre_), nx * self.hidden, nx * self.hidden])

    def _kernels(self, parameters: Array) -> tuple[DynamicsKernel, Array] | None:
        """Return a kernel, if there is one, and its flat parameters (P, m) for parameter vectors (P, n)."""
        predictors = [self._predictor(one) for one in parameters]
        kernel = self.stepping(predictors[0])
        if kernel is None:
            return None
        return kernel, kernel.of_candidates(np.stack([predictor.parameters for predictor in predictors]))

    def _advance(self, parameters: Array, carry: Array, control: Array) -> Array:
        """Step parameter vectors (P, n) from carries (P, B, n_carry) under controls (B, nu)."""
        p, nx, n = len(parameters), self.system.nx, len(self.centre_)
        first, first_bias, last, last_bias = np.split(parameters, self._cut, axis=1)
        held = np.broadcast_to(control, (p, *control.shape))
        inputs = (Features(self.system, self.lags)(carry, held) - self.centre_) / self.scale_
        hidden = np.tanh(inputs @ first.reshape(p, n, nx * self.hidden) + first_bias[:, None])
        by_state = hidden.reshape(p, len(control), nx, self.hidden)
        change = np.einsum("pbsh,psh->pbs", by_state, last.reshape(p, nx, self.hidden)) + last_bias[:, None]
        after = self.system.integrate(carry[..., :nx], change * self.output_scale_)
        return self.shift_lags(carry, held, self.apply_limits(after))
