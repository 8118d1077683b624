"""The parametrised car: twelve physical parameters set by evolution (paper, section 4.4, Equation 1)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np

from model_zoo.car.physics import PHYSICAL, accelerations
from model_zoo.car.roles import CarRoles, car_roles, require_car
from sysid_evo.arrays import Array
from sysid_evo.data import Dataset
from sysid_evo.dynamics import DynamicsModel
from sysid_evo.evolution import ModelEvolution
from sysid_evo.evolution.identification import Weights
from sysid_evo.hyperparameters import Limit, at_least
from sysid_evo.progress import Progress
from sysid_evo.registry import register_model
from sysid_evo.system import System

if TYPE_CHECKING:
    from sysid_evo.engine.compiled.kernel import DynamicsKernel

PARAMETERS = (
    *PHYSICAL,
    ("min_speed", "m/s"),
    ("min_yaw_rate", "rad/s"),
    ("max_speed", "m/s"),
    ("max_yaw_rate", "rad/s"),
)


@register_model("parametrised")
class Parametrised(DynamicsModel):
    """A car with thrust, steering, drag, static friction and top speeds; lateral speed is neglected.

    With forward speed u, yaw rate r, drive u1 and steer u2 (+1 = left, the paper's sign turned)::

        du/dt = U_f max(u1, 0) - U_b max(-u1, 0) - u D_ul - sgn(u) u^2 D_uv
        dr/dt = u (R_l max(u2, 0) - R_r max(-u2, 0)) - r D_rl - sgn(r) r^2 D_rv

    A speed below its minimum without a command is zero; speeds are clipped to their maxima; the
    lateral speed is zero (Equation 1, read by its intent). The twelve parameters are encoded in
    units of the data's own scale and evolved with ``generations`` of a 50+50 strategy on the error
    after ``horizon`` steps from ``windows`` random starts, every state divided by its standard deviation;
    in the states' own units with ``weights="paper"``, the preset of that name.

    ``drive`` and ``steer`` name the controls with these roles. With ``control_lags`` the equation is
    driven by the command of that many samples ago, a dead time (none in the paper).
    """

    knowledge = "grey"
    presets: ClassVar[dict[str, dict[str, Any]]] = {
        "quick": {"generations": 300},
        "paper": {"weights": "paper"},
    }
    limits: ClassVar[dict[str, Limit]] = {name: at_least(1) for name in ("generations", "windows", "horizon")}

    generations: int = 1000
    windows: int = 100
    horizon: int = 10
    weights: Weights = "spread"
    drive: str = "drive"
    steer: str = "steer"
    control_lags: int = 0
    rest_hold: bool = False

    def check_system(self, system: System) -> None:
        require_car(self, "parametrised", system, self.drive, self.steer)

    def fit(self, dataset: Dataset, *, rng: np.random.Generator, progress: Progress | None = None) -> Self:
        scale = parameter_scale(dataset, self.roles)
        search = ModelEvolution(
            generations=self.generations, windows=self.windows, horizon=self.horizon, weights=self.weights
        )
        best = search.run(
            lambda population, carry, control: self._advance(np.abs(population) * scale, carry, control),
            dataset,
            initial=INITIAL,
            spread=0.2,
            rng=rng,
            progress=progress,
            kernel=lambda population: self._kernels(np.abs(population) * scale),
            start=self.lagged,
            history=self.n_lags,
        )
        self.parameters_ = np.abs(best) * scale
        return self

    def step(self, carry: Array, control: Array, noise: Array | None = None) -> Array:
        return self._advance(self.parameters_, carry, control)

    def kernel(self) -> DynamicsKernel:
        return self._kernels(self.parameters_[None])[0]

    def _kernels(self, parameters: Array) -> tuple[DynamicsKernel, Array]:
        """Return a kernel and its flat parameters (P, m) for parameter vectors (P, 12)."""
        from model_zoo.kernels.car import equation_one
        from sysid_evo.engine.kernels import Predictor, stepping_kernel

        roles = [-1 if role is None else role for role in self.roles]
        head = [*roles, self.system.nx, self.system.dt, self._oldest_command]
        flat = np.concatenate([np.tile(head, (len(parameters), 1)), parameters], axis=1)
        kernel = stepping_kernel(
            Predictor(equation_one, flat[0], 0),
            self.system,
            output="next_state",
            lags=self.lags,
            rest_band=self.rest_band,
        )
        return kernel, kernel.of_candidates(flat)

    @property
    def roles(self) -> CarRoles:
        """Where forward speed, lateral speed, yaw rate, drive and steer stand."""
        return car_roles(self.system, self.drive, self.steer)

    @property
    def _oldest_command(self) -> int:
        """Where in the carry the command stands that drives the equation; 0 for the present one."""
        lag = self.lags[1]
        return self.system.nx + self.system.nu * (lag - 1) if lag else 0

    def _advance(self, parameters: Array, carry: Array, control: Array) -> Array:
        """Step one parameter vector (12,) from carries (B, n_carry), or each of (P, 12) from (P, B, n_carry).

        Controls are (B, nu).
        """
        nx, past = self.system.nx, self._oldest_command
        present = control if carry.ndim == 2 else np.broadcast_to(control, (*carry.shape[:-1], control.shape[-1]))
        driven = carry[..., past : past + self.system.nu] if past else control
        after = self.held(carry, present, self._equation_one(parameters, carry[..., :nx], driven))
        return self.remember(carry, present, after)

    def _equation_one(self, parameters: Array, state: Array, control: Array) -> Array:
        """Return the next states (..., B, nx) of parameter vectors (..., 12) under controls (..., B, nu)."""
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
