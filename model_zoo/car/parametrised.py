"""Family parametrised (paper, section 4.4): twelve physical parameters set by evolution."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, Self

import numpy as np

from model_zoo.car.planar_car import PHYSICAL, CarRoles, PlanarCarModel, accelerations, equation_one
from sysid_evo import Dataset, register_model
from sysid_evo.evolution import ModelEvolution
from sysid_evo.evolution.model_evolution import Weights
from sysid_evo.kernels import DynamicsKernel
from sysid_evo.models.kernels import Predictor
from sysid_evo.models.learned import Declared
from sysid_evo.models.parameters import Limit, at_least
from sysid_evo.models.stochastic import StochasticModel
from sysid_evo.progress import Progress
from sysid_evo.types import Array, check_shape

PARAMETERS = (
    *PHYSICAL,
    ("min_speed", "m/s"),
    ("min_yaw_rate", "rad/s"),
    ("max_speed", "m/s"),
    ("max_yaw_rate", "rad/s"),
)


@register_model("parametrised")
class Parametrised(PlanarCarModel, StochasticModel):
    """Car with thrust, steering, drag, static friction and top speeds: twelve parameters found by evolution.

    With forward speed u, yaw rate r, drive u1 and steer u2 (+1 = left, opposite to the paper)::

        du/dt = U_f max(u1, 0) - U_b max(-u1, 0) - u D_ul - sgn(u) u^2 D_uv
        dr/dt = u (R_l max(u2, 0) - R_r max(-u2, 0)) - r D_rl - sgn(r) r^2 D_rv

    A speed below its minimum without a command is zero; speeds are clipped to their maxima; the lateral speed is zero
    (the intent of Equation 1). The parameters, in units derived from the data, are evolved for ``generations`` of a
    50+50 strategy on the error ``horizon`` steps after ``windows`` random starts. The error of each state is divided by
    its standard deviation, or in its own unit with ``error_units="paper"``, the preset of that name.

    ``drive`` and ``steer`` name the controls with these roles. ``control_lags`` delays the commands by that many
    samples (none in the paper).
    """

    knowledge = "grey"
    model_class = "physics"
    resumable = True
    presets: ClassVar[dict[str, dict[str, Any]]] = {
        "quick": {"generations": 300},
        "paper": {"error_units": "paper"},
    }
    limits: ClassVar[dict[str, Limit]] = {name: at_least(1) for name in ("generations", "windows", "horizon")}

    generations: int = 1000
    windows: int = 100
    horizon: int = 10
    error_units: Weights = "spread"
    control_lags: int = 0

    def fit(self, dataset: Dataset, *, rng: np.random.Generator, progress: Progress | None = None) -> Self:
        scale = parameter_scale(dataset, self.roles)
        search = ModelEvolution(
            generations=self.generations, windows=self.windows, horizon=self.horizon, error_units=self.error_units
        )
        best = search.run(
            lambda population, carry, control: self._advance(np.abs(population) * scale, carry, control),
            dataset,
            initial=INITIAL,
            spread=0.2,
            rng=rng,
            progress=progress,
            checkpoint=self.checkpoint,
            kernel=lambda population: self._kernels(np.abs(population) * scale),
            start=self.initial_carry,
            history=self.n_lags,
        )
        self.parameters_ = np.abs(best) * scale
        self.calibrate(dataset, rng)
        return self

    def learned_arrays(self) -> Mapping[str, Declared]:
        return {"parameters_": (len(PARAMETERS),)}

    def next_state(self, carry: Array, control: Array) -> Array:
        return self._next_states(self.parameters_, carry, control)

    def predictor(self) -> Predictor:
        return Predictor(
            equation_one,
            self._flat(check_shape("parameters_", self.parameters_, (len(PARAMETERS),))[None])[0],
            n_scratch=0,
        )

    def _kernels(self, parameters: Array) -> tuple[DynamicsKernel, Array] | None:
        """Return a kernel and its flat parameters (P, m) for parameter vectors (P, 12)."""
        flat = self._flat(parameters)
        kernel = self.stepping(Predictor(equation_one, flat[0], n_scratch=0))
        return None if kernel is None else (kernel, kernel.of_candidates(flat))

    def _flat(self, parameters: Array) -> Array:
        """Return the parameters (P, m) of `equation_one` for parameter vectors (P, 12)."""
        head = np.tile(self.kernel_parameters(self._oldest_command), (len(parameters), 1))
        return np.concatenate([head, parameters], axis=1)

    @property
    def _oldest_command(self) -> int:
        """Position in the carry of the command that acts; 0 for the present one."""
        lag = self.lags[1]
        return self.system.nx + self.system.nu * (lag - 1) if lag else 0

    def _advance(self, parameters: Array, carry: Array, control: Array) -> Array:
        """Step parameter vectors (P, 12) from carries (P, B, n_carry) under controls (B, nu)."""
        applied = np.broadcast_to(control, (len(parameters), *control.shape))
        after = self.apply_limits(self._next_states(parameters, carry, applied))
        return self.shift_lags(carry, applied, after)

    def _next_states(self, parameters: Array, carry: Array, control: Array) -> Array:
        """Return the next states (..., B, nx) of parameter vectors (..., 12) under controls (..., B, nu)."""
        nx, past = self.system.nx, self._oldest_command
        state, control = carry[..., :nx], carry[..., past : past + self.system.nu] if past else control
        forward, _, yaw_rate, drive, steer = self.roles
        dt = self.system.dt
        *physical, u_min, r_min, u_max, r_max = parameters.T[..., None]
        u, r, u1, u2 = state[..., forward], state[..., yaw_rate], control[..., drive], control[..., steer]
        du, dr = accelerations(u, r, u1, u2, physical)
        next_u, next_r = u + dt * du, r + dt * dr
        after = np.zeros_like(state)
        u_still, r_still = (np.abs(next_u) < u_min) & (u1 == 0.0), (np.abs(next_r) < r_min) & (u2 == 0.0)
        np.clip(next_u, -u_max, u_max, out=after[..., forward], where=~u_still)
        np.clip(next_r, -r_max, r_max, out=after[..., yaw_rate], where=~r_still)
        return after


INITIAL = np.array([1.0, 1.0, 1.0, 1.0, 1.0, 0.5, 1.0, 0.5, 0.5, 0.5, 1.0, 1.0])


def parameter_scale(dataset: Dataset, roles: CarRoles) -> Array:
    """Return the natural size (12,) of every parameter, from the RMS and the largest values of the data."""
    forward, _, yaw_rate, _, _ = roles
    states = np.concatenate([episode.states for episode in dataset.episodes])
    u, r = (max(float(np.sqrt(np.mean(states[:, i] ** 2))), 1e-6) for i in (forward, yaw_rate))
    u_max, r_max = (max(float(np.abs(states[:, i]).max()), 1e-6) for i in (forward, yaw_rate))
    rate = 2.0  # 1/s: a car settles in about half a second
    return np.array(
        [rate * u, rate * u]
        + [2.0 * rate * r / u] * 2
        + [rate, rate / u, 2.0 * rate, 2.0 * rate / r]
        + [0.1 * u, 0.1 * r, u_max, r_max]
    )
