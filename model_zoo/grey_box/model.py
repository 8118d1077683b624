"""GreyBox, the base class of families that are physics with unknown parameters; a radial network for its residual."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar, Self

import numpy as np
from scipy.linalg import cho_solve

from model_zoo.features import Features
from model_zoo.gaussian_process import JITTER, cholesky_with_jitter, maximise_likelihood, squared_exponential
from model_zoo.grey_box.equation import GreyBoxEquation, estimate_hidden, structure_kernel
from model_zoo.grey_box.estimation import (
    FINAL_STARTS,
    FIRST_EVALUATIONS,
    LAST_EVALUATIONS,
    SCREENED,
    FitWindows,
    LeastSquares,
    LeastSquaresFit,
    best_of,
    covariance_of,
    prior_variances,
    starts_of,
)
from model_zoo.grey_box.parameters import (
    HiddenState,
    Parameter,
    parameter_rows,
    undetermined_parameters,
)
from model_zoo.scaling import deviation, positive
from sysid_evo.carry import CarryLayout
from sysid_evo.data import Dataset
from sysid_evo.errors import IncompatibleSystem, InvalidArgument, ShapeError
from sysid_evo.kernels import DynamicsKernel
from sysid_evo.models import DynamicsModel
from sysid_evo.models.kernels import Predictor, gaussian_predictor, with_angles
from sysid_evo.models.learned import Declared, Numbers
from sysid_evo.models.parameters import Limit, at_least
from sysid_evo.progress import Counter, Progress
from sysid_evo.system import System
from sysid_evo.types import Array
from sysid_evo.validation.folds import time_fold
from sysid_evo.validation.simulation_error import error_windows, simulation_error

FIRST_FIT_DIVISOR = 5
"""The first fit uses simulations of one part in this many of the final length."""
WARM_UP_SAMPLES = 20
"""Samples before a window from which its actuator and hidden states are initialised, if episodes are long enough."""

SHARES = (0.0, 0.5, 1.0)
"""Shares of a residual that may be kept."""
MAX_ERROR_RATIO = 0.98
"""A residual is kept only if it reduces the simulation error to this share or less."""
HIDDEN_SHARE = 0.3
"""Share of the windows that is used if each has hidden states to be estimated, which takes longer."""


class GreyBox(DynamicsModel):
    """Base class for physics with unknown parameters: dx/dt = rate(x, u, p), p fitted to recordings.

    A family declares ``parameters`` and writes `rate` in plain numbers: its arguments are the tuples of ``states``,
    ``controls`` (all of the system's by default, in its order) and parameters, and it returns a tuple of one rate per
    state. It may use what kernels may use (docs/extending/kernels.md): it runs on arrays during the fit and compiled in
    evolution. For a system with a motion, the rotation of the body frame is added. A family of positions and speeds may
    write `acceleration` instead and map each position to its speed in ``rate_of``; it returns the rates of all states
    but the positions. ``hidden_states`` are unmeasured states, arguments of `rate` after the others; they are estimated
    from ``past_samples`` samples.

    Options: ``actuator_lag`` adds a first-order lag to every control (s); ``command_delay`` adds one delay of all
    controls, up to ``longest_delay`` samples. Both are fitted like other parameters. With ``residual`` a radial network
    of ``residual_points`` functions learns the one-step residual; it is zero far from the data. All, half or none of it
    is kept, by the simulation error on held-out blocks of time.

    The fit is least squares of simulations from measured states (multiple shooting): first over a fifth of ``seconds``,
    from ``starts`` points within the bounds, then over ``seconds``, in up to ``windows`` windows whose initial hidden
    states are estimated too. ``robust`` counts errors above 1.5 deviations linearly. Integration is fourth-order
    Runge-Kutta with ``substeps`` steps per sample.

    ``parameters_`` and ``standard_errors_`` are the result, with clustered standard errors over blocks of time, because
    neighbouring errors are correlated. ``undetermined_`` lists what the data do not determine. `parameters_table` has
    all of it.
    """

    knowledge = "grey"
    model_class = "physics"
    parameters: ClassVar[tuple[Parameter, ...]] = ()
    states: ClassVar[tuple[str, ...]] = ()
    controls: ClassVar[tuple[str, ...]] = ()
    hidden_states: ClassVar[tuple[HiddenState, ...]] = ()
    rate_of: ClassVar[Mapping[str, str]] = {}
    presets: ClassVar[dict[str, dict[str, Any]]] = {"quick": {"starts": 3, "windows": 120, "residual_points": 60}}
    limits: ClassVar[dict[str, Limit]] = {
        **{name: at_least(1) for name in ("starts", "windows", "substeps", "longest_delay", "residual_points")},
        "past_samples": at_least(0),
        "seconds": Limit(0.0, open_below=True),
    }

    actuator_lag: bool = False
    command_delay: bool = False
    longest_delay: int = 3
    seconds: float = 1.0
    starts: int = 6
    windows: int = 250
    robust: bool = False
    substeps: int = 1
    past_samples: int = 5
    residual: bool = False
    residual_points: int = 150
    max_steps: int | None = 100_000

    @staticmethod
    def rate(state: Any, control: Any, p: Any) -> Any:  # noqa: ARG004  # what a family writes
        """Return d/dt of every state from tuples of states, controls and parameters."""
        raise TypeError("a grey box must define rate(state, control, p) or acceleration(state, control, p)")

    @staticmethod
    def acceleration(state: Any, control: Any, p: Any) -> Any:  # type: ignore[override]  # noqa: ARG004  # a law, see below
        """Return d/dt of all states except the positions in ``rate_of``, in their order; instead of `rate`.

        It is a law like `rate`, with the same arguments; `step` never calls the inherited method.
        """
        raise TypeError("a grey box must define rate(state, control, p) or acceleration(state, control, p)")

    @property
    def law(self) -> Callable[..., Any]:
        """The function that is integrated: `rate` or `acceleration`, unless a family offers several."""
        own = type(self)
        return own.rate if own.acceleration is GreyBox.acceleration else own.acceleration

    def law_parameters(self) -> tuple[Parameter, ...]:
        """Return the parameters of `law`: ``parameters``, unless a family offers several laws."""
        return self.parameters

    def channel_indices(self, system: System) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Return the positions of the states and controls of `law` in ``system``. Raises `IncompatibleSystem`."""
        return (
            positions_of(self, "state", self.states, system.state_names),
            positions_of(self, "control", self.controls, system.control_names),
        )

    def prepare(self, dataset: Dataset) -> None:
        """Look at the data before anything is fitted; does nothing by default."""

    def check_system(self, system: System) -> None:
        states, controls = self.channel_indices(system)
        left = [name for i, name in enumerate(system.state_names) if i not in states]
        if left:
            raise IncompatibleSystem(
                f"{type(self).__name__} lacks {', '.join(left)}: name all states of the system, in the order "
                "of the arguments of rate"
            )
        self._structure_on(system, states, controls).check()

    def _structure_on(
        self, system: System, states: tuple[int, ...] | None = None, controls: tuple[int, ...] | None = None
    ) -> GreyBoxEquation:
        """Return the structure for the fit, with the longest delay."""
        at = self.channel_indices(system) if states is None or controls is None else (states, controls)
        return GreyBoxEquation(
            system=system,
            law=self.law,
            states=at[0],
            controls=at[1],
            own=self.law_parameters(),
            hidden=self.hidden_states,
            lagged=self.actuator_lag,
            delay=self.longest_delay if self.command_delay else 0,
            substeps=self.substeps,
            known=self._known_rates(system),
        )

    def _known_rates(self, system: System) -> tuple[tuple[int, int], ...]:
        """Return the positions of each key and value of ``rate_of``. Raises `InvalidArgument` with `rate`."""
        if not self.rate_of:
            return ()
        if self.law is not type(self).acceleration:
            raise InvalidArgument(
                f"{type(self).__name__}: rate_of names known rates, but rate returns those of all states: write "
                "acceleration(state, control, p) instead"
            )
        pairs = (tuple(self.rate_of), tuple(self.rate_of.values()))
        positions, rates = (positions_of(self, "state", names, system.state_names) for names in pairs)
        return tuple(zip(positions, rates, strict=True))

    @cached_property
    def integrated(self) -> GreyBoxEquation:
        """The integrated structure, with only the earlier controls that the fitted delay needs."""
        found = self._structure_on(self.system)
        return found.shorter(float(self.parameters_[-1])) if len(getattr(self, "parameters_", ())) else found

    def fit(self, dataset: Dataset, *, rng: np.random.Generator, progress: Progress | None = None) -> Self:
        self.prepare(dataset)
        structure = self._structure_on(dataset.system)
        if not structure.parameters:
            self.parameters_, self.covariance_ = np.empty(0), np.empty((0, 0))
            return self
        total = SCREENED + self.starts * FIRST_EVALUATIONS * 2 + FINAL_STARTS * LAST_EVALUATIONS * 2
        counter = Counter(progress, total)

        def report() -> None:
            counter.done = min(counter.done, total - 1)
            counter.advance()

        horizon = max(10, round(self.seconds / dataset.system.dt))
        longest = max(len(episode) for episode in dataset.episodes)
        history = min(WARM_UP_SAMPLES, longest // 4) if self._needs_history else 0
        history = max(structure.delay, self.past_samples if self._needs_history else 0, history)
        most = max(1, round(self.windows * HIDDEN_SHARE)) if structure.hidden else self.windows
        windows = [
            FitWindows.of(dataset, steps, history=history, most=most, limits=self.state_bounds_)
            for steps in (-(-horizon // FIRST_FIT_DIVISOR), horizon)
        ]
        first, last = (LeastSquares(structure, some, report, self.robust) for some in windows)
        results = [
            first.solve(place, evaluations=FIRST_EVALUATIONS).places for place in starts_of(first, self.starts, rng)
        ]
        best = best_of(last, results)
        if any(parameter.spread is not None for parameter in structure.parameters):
            _, inflation, noise = covariance_of(last, best)
            last = replace(last, noise=noise, inflation=inflation)
            best = last.solve(best.places, evaluations=LAST_EVALUATIONS)
        self._learn(last, best)
        if self.residual:
            self._learn_residual(dataset, rng, report)
        return self

    def learned_arrays(self) -> Mapping[str, Declared]:
        structure, nx, delay = self._structure_on(self.system), self.system.nx, self.parameters_[-1:]
        if structure.delay and not (np.isfinite(delay) & (delay >= 0.0) & (delay <= structure.delay)).all():
            raise ShapeError(f"parameters_: expected a delay from 0 to {structure.delay} samples, got {delay}")
        count = len(structure.parameters)
        found: dict[str, Declared] = {
            "parameters_": (count,),
            "residual_spread_": Numbers(nx, optional=True),
            "covariance_": Numbers(count, count, infinite=True, optional=True),
            "standard_errors_": Numbers(count, infinite=True, optional=True),
        }
        if structure.hidden:
            found |= dict.fromkeys(("hidden_mean_", "hidden_spread_"), (len(structure.hidden),))
        if self._residual is not None:
            seen = inputs_of(self.integrated)
            n = seen.n_carry + self.system.nu
            found |= {"residual_points_": ("bumps", n), "residual_weights_": (nx, "bumps")}
            found["residual_lengths_"] = Numbers(nx, n, least=np.finfo(float).tiny, infinite=True)
        return found

    @property
    def _needs_history(self) -> bool:
        """Whether the carry holds values that only the past determines."""
        return bool(self.hidden_states) or self.actuator_lag

    def _learn(self, problem: LeastSquares, best: LeastSquaresFit) -> None:
        structure = problem.structure
        parameters, box = structure.parameters, structure.box
        known = prior_variances(parameters, best.places)
        covariance, _, _ = covariance_of(problem, best)
        slopes = box.slopes(best.places)
        self.undetermined_, self.determined_ = undetermined_parameters(parameters, best.places, covariance, known)
        self.covariance_ = covariance * np.outer(slopes, slopes)
        self.standard_errors_ = np.sqrt(np.diag(self.covariance_))
        if structure.hidden:
            self.hidden_mean_, self.hidden_spread_ = best.hidden.mean(axis=1), best.hidden.std(axis=1) + 1e-9
        nx = structure.system.nx
        errors = best.errors.reshape(len(best.errors), -1, nx)
        self.residual_spread_ = np.sqrt(np.mean(errors**2, axis=(0, 1))) * problem.windows.scale
        self.parameters_ = box.values(best.places)

    def _learn_residual(self, dataset: Dataset, rng: np.random.Generator, report: Callable[[], None]) -> None:
        """Fit the residual of the physics; keep the share with the lowest simulation error on held-out blocks."""
        learned, held = time_fold(dataset)
        shape, noise = learned_shape(self.integrated, *self._residual_data(learned), self.residual_points, rng, report)
        tried, errors = conditioned(shape, noise, *self._residual_data(learned)), []
        windows = error_windows(held, self.n_lags)
        for share in SHARES:
            report()
            self._keep(tried, share)
            errors.append(simulation_error(self, windows))
        better = np.array(errors) * np.where(np.array(SHARES) == 0.0, MAX_ERROR_RATIO, 1.0)
        self.residual_share_ = SHARES[int(np.argmin(better))]
        self.residual_errors_ = [float(errors[SHARES.index(self.residual_share_)]), float(errors[SHARES.index(0.0)])]
        self._keep(conditioned(shape, noise, *self._residual_data(dataset)), self.residual_share_)

    def _keep(self, residual: ResidualNetwork, share: float) -> None:
        self.residual_points_, self.residual_lengths_ = residual.points, residual.lengths
        self.residual_weights_ = share * residual.weights

    def _residual_data(self, dataset: Dataset) -> tuple[Array, Array]:
        """Return inputs (N, n) of the residual at single steps, and the residual of the rates there (N, nx)."""
        windows = dataset.windows(1, history=self.n_lags, moving=True)
        windows = windows if len(windows) else dataset.windows(1, history=self.n_lags)
        physics = self.variant(residual=False)
        carry, control = physics.start(windows.past_states, windows.past_controls), windows.controls[:, 0]
        after = physics.step(carry, control)[:, : self.system.nx]
        off = self.system.difference(windows.states[:, 0], after)
        return inputs_of(self.integrated)(carry, control), off / self.system.dt

    @property
    def _residual(self) -> ResidualNetwork | None:
        if not self.residual or not hasattr(self, "residual_weights_"):
            return None
        return ResidualNetwork(self.residual_points_, self.residual_lengths_, self.residual_weights_)

    def parameters_table(self) -> list[dict[str, Any]]:
        """Return name, value, standard error, unit, bounds of every parameter, and whether the data determine it.

        Rows of parameters whose estimates are correlated above 0.9 with others have ``correlations``.
        """
        parameters = self._structure_on(self.system).parameters
        return parameter_rows(parameters, self.parameters_, self.covariance_, getattr(self, "determined_", []))

    @property
    def fit_note(self) -> str:
        notes = [super().fit_note, *getattr(self, "undetermined_", [])]
        if hasattr(self, "residual_share_"):
            kept, without = self.residual_errors_
            notes.append(
                f"{100 * self.residual_share_:.0f} % of the residual is kept: N after 1 s on held-out blocks is "
                f"{kept:.3f}, {without:.3f} without it"
            )
        return "; ".join(sentence for sentence in notes if sentence)

    @property
    def layout(self) -> CarryLayout:
        return self.integrated.layout

    @property
    def n_lags(self) -> int:
        return max(self.layout.control_lags, self.past_samples if self._needs_history else 0)

    def start(self, states: Array, controls: Array, draws: Array | None = None) -> Array:
        structure, hidden = self.integrated, np.empty((0, len(states)))
        with np.errstate(all="ignore"):
            if structure.hidden:
                hidden = estimate_hidden(
                    structure,
                    self.parameters_,
                    states,
                    controls,
                    mean=self.hidden_mean_,
                    spread=self.hidden_spread_,
                    noise=self.residual_spread_,
                )
            return structure.start(self.parameters_[:, None], states, controls, hidden).T.copy()

    def step(self, carry: Array, control: Array, noise: Array | None = None) -> Array:
        structure, residual, extra = self.integrated, self._residual, None
        if residual is not None:
            features, held = inputs_of(structure), carry[:, structure.extended.nx :]

            def extra(x: Array) -> Array:
                return residual(features(np.concatenate([x.T, held], axis=1), control)).T

        with np.errstate(all="ignore"):
            states, past = (part.T for part in structure.step(self.parameters_[:, None], carry.T, control.T, extra))
        return np.concatenate([states, past], axis=1)

    def kernel(self) -> DynamicsKernel | None:
        structure, residual = self.integrated, self._residual
        extra = None if residual is None else residual.predictor(structure)
        return structure_kernel(structure, self.parameters_, extra=extra)


def positions_of(model: DynamicsModel, what: str, wanted: Sequence[str], there: Sequence[str]) -> tuple[int, ...]:
    """Return the positions of the ``wanted`` channels in ``there``; all of them if none are named."""
    for name in wanted:
        if name not in there:
            raise IncompatibleSystem(
                f"{type(model).__name__} needs the {what} {name!r}: the system has {', '.join(there) or 'none'}"
            )
    return tuple(there.index(name) for name in wanted) if wanted else tuple(range(len(there)))


@dataclass(frozen=True)
class ResidualNetwork:
    """Mean of a sparse Gaussian process without a trend for each measured state.

    It is a sum of radial functions at ``points`` (M, n). ``lengths`` (nx, n) are infinite for inputs without effect;
    ``weights`` (nx, M) include the amplitudes. Far from the data, in units of the lengths, it is zero (deterministic
    training conditional: Quinonero Candela, Rasmussen 2005).
    """

    points: Array
    lengths: Array
    weights: Array

    def __call__(self, inputs: Array) -> Array:
        """Return the addition to the rates of the measured states, (B, nx)."""
        bumps = [squared_exponential(inputs / one, self.points / one) for one in self.lengths]
        return np.stack([bump @ weight for bump, weight in zip(bumps, self.weights, strict=True)], axis=1)

    def predictor(self, structure: GreyBoxEquation) -> Predictor:
        """Return the compiled form, of the structure's carry and the control."""
        nx, n = self.lengths.shape
        n_carry = inputs_of(structure).n_carry
        none = np.zeros((n, nx)), np.zeros(nx)
        bumps = gaussian_predictor(self.points, self.lengths, self.weights, *none, n_carry)
        return with_angles(bumps, structure.extended, (0, structure.delay))


def inputs_of(structure: GreyBoxEquation) -> Features:
    """Return the inputs of the residual, from carry and control."""
    return Features(structure.extended, (0, structure.delay))


def learned_shape(
    structure: GreyBoxEquation,
    inputs: Array,
    targets: Array,
    points: int,
    rng: np.random.Generator,
    report: Callable[[], None],
) -> tuple[ResidualNetwork, Array]:
    """Return a residual with points, lengths and amplitudes (as weights of one) chosen, and the noise (nx,).

    Lengths maximise the marginal likelihood at ``points`` random samples. Actuators with lags replace the commands as
    inputs.
    """
    rows = np.sort(rng.choice(len(inputs), size=min(points, len(inputs)), replace=False))
    counted = len(structure.extended.regressor_names) if structure.lagged else inputs.shape[1]
    scale, size = deviation(inputs)[:counted], positive(targets.std(axis=0))
    nx = targets.shape[1]
    lengths, amplitude, noise = np.full((nx, inputs.shape[1]), np.inf), np.empty(nx), np.empty(nx)
    for j in range(nx):
        found = maximise_likelihood(inputs[rows, :counted] / scale, targets[rows, j] / size[j], report=report)
        amplitude[j], lengths[j, :counted], noise[j] = found[0] * size[j], found[1] * scale, found[2] * size[j]
    return ResidualNetwork(inputs[rows], lengths, np.repeat(amplitude[:, None], len(rows), axis=1)), noise


def conditioned(shape: ResidualNetwork, noise: Array, inputs: Array, targets: Array) -> ResidualNetwork:
    """Return the residual of this shape fitted to all of ``inputs`` (N, n) and ``targets`` (N, nx)."""
    weights = np.empty_like(shape.weights)
    for j, length in enumerate(shape.lengths):
        square = shape.weights[j, 0] ** 2
        points = shape.points / length
        own = square * (squared_exponential(points, points) + JITTER * np.eye(len(points)))
        cross = square * squared_exponential(points, inputs / length)
        posterior = cholesky_with_jitter(own + cross @ cross.T / noise[j] ** 2)
        weights[j] = square * cho_solve((posterior, True), cross @ targets[:, j]) / noise[j] ** 2
    return replace(shape, weights=weights)
