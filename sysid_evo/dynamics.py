"""The contract of everything that steps: models and emulated robots."""

from __future__ import annotations

import functools
import time
from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from sklearn.base import BaseEstimator

from sysid_evo.arrays import Array, check_shape
from sysid_evo.errors import IncompatibleSystem, InvalidData, NotFitted

if TYPE_CHECKING:
    from sysid_evo.data import Dataset
    from sysid_evo.engine.compiled.kernel import DynamicsKernel
    from sysid_evo.progress import Progress
    from sysid_evo.system import System


REST_BAND = 0.005
"""Share of the range of the training states, around neutral, that counts as rest."""


class Dynamics(ABC):
    """Anything that steps by one ``system.dt``.

    The *carry* (B, n_carry) is the state followed by whatever else is remembered; ``carry[:, :nx]``
    is the state. ``n_lags`` samples of history are wanted by `start`; ``n_noise`` standard normal
    numbers are given to every `step` and ``n_draws`` to every `start`, by whoever runs the loop:
    never drawn inside. What controllers and tasks observe of the state stands in the carry from
    ``observed_at`` on: the state itself, unless a wrapper puts an estimate beside it.
    """

    system: System
    n_carry: int
    observed_at: int = 0
    n_lags: int = 0
    n_noise: int = 0
    n_draws: int = 0

    @property
    def envelope(self) -> Array | None:
        """Lowest and highest value of each state, (2, nx), to which a loop clips; None for no clip."""
        return None

    @abstractmethod
    def start(self, states: Array, controls: Array, draws: Array | None = None) -> Array:
        """Return the carry (B, n_carry) after a history.

        ``states`` (B, n_lags + 1, nx) ends at the present, ``controls`` (B, n_lags, nu) at the
        sample before it, ``draws`` is (B, n_draws).
        """

    @abstractmethod
    def step(self, carry: Array, control: Array, noise: Array | None = None) -> Array:
        """Return the next carry (B, n_carry) under ``control`` (B, nu), with ``noise`` (B, n_noise).

        Pure: the same arguments give the same result, each row for itself.
        """

    def kernel(self) -> DynamicsKernel | None:
        """Return the compiled form of `step`, if it has one."""
        return None


class DynamicsModel(Dynamics, BaseEstimator):
    """A model family: hyper-parameters in a keyword-only constructor, learned names end in ``_``.

    A family writes ``__init__`` (which only stores its arguments), `fit`, and one of

    - `acceleration`, if it predicts accelerations: the integration is inherited (paper, section 4);
    - `next_state`, if it predicts the next state;
    - `step`, if its carry is more than states and controls.

    A family with the hyper-parameters ``state_lags`` or ``control_lags`` has a carry of the state,
    that many earlier states (newest first) and that many earlier controls (newest first). None leaves
    the number to `fit`, which then records it as ``state_lags_`` or ``control_lags_``. With
    ``rest_hold``, a state within 0.5 % of the training range around neutral stays at neutral as long as
    the control is neutral, and so are the earlier controls in the carry, which may still act.

    ``knowledge`` says how much physics the family assumes (black, dark grey, grey, white);
    ``presets`` gives the hyper-parameters that change with a budget (quick, standard, paper).

    What `fit` learns must be arrays, numbers, strings, or lists of these, so that it can be stored;
    anything else is derived from them when needed; a `functools.cached_property`, a kernel among them, is
    forgotten as soon as anything is set, by `fit`, by `set_params` or by hand. Every `fit` also records ``system_`` and
    ``envelope_``: the centre of the training states plus and minus ``envelope_multiple`` half
    ranges, beyond which a simulation is clipped (a periodic state has no limits); ``fit_seconds`` is how long it took.
    """

    knowledge: ClassVar[str] = "black"
    envelope_multiple: ClassVar[float] = 2.0
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {}
    state_lags: int | None = 0
    control_lags: int | None = 0
    rest_hold: bool = False
    fit_seconds: float | None = None
    system_: System
    envelope_: Array

    _derived: ClassVar[frozenset[str]] = frozenset()

    def __init_subclass__(cls, **keywords: Any) -> None:
        super().__init_subclass__(**keywords)
        cached = {name for name, value in vars(cls).items() if isinstance(value, functools.cached_property)}
        cls._derived = cls._derived | cached
        if "fit" in cls.__dict__:
            cls.fit = _recorded(cls.__dict__["fit"])  # type: ignore[method-assign]  # wraps the family's own

    def __setattr__(self, name: str, value: Any) -> None:
        """Set what is learned or chosen, and forget every cached property: its kernel is made anew."""
        for derived in self._derived:
            self.__dict__.pop(derived, None)
        super().__setattr__(name, value)

    @property
    def system(self) -> System:  # type: ignore[override]  # known only after fit
        """The system of the training data. Raises `NotFitted` before `fit`."""
        if not hasattr(self, "system_"):
            raise NotFitted(f"{type(self).__name__} is not fitted yet: call fit(dataset, rng=...) first")
        return self.system_

    @property
    def lags(self) -> tuple[int, int]:
        """Earlier states and earlier controls in the carry: as asked for, else as `fit` chose (0 before it)."""
        states = getattr(self, "state_lags_", 0) if self.state_lags is None else self.state_lags
        controls = getattr(self, "control_lags_", 0) if self.control_lags is None else self.control_lags
        return states, controls

    @property
    def n_lags(self) -> int:  # type: ignore[override]  # follows from the hyper-parameters
        return max(self.lags)

    @property
    def n_carry(self) -> int:  # type: ignore[override]  # follows from the hyper-parameters
        return self.system.nx * (1 + self.lags[0]) + self.system.nu * self.lags[1]

    @property
    def envelope(self) -> Array | None:
        return getattr(self, "envelope_", None)

    @abstractmethod
    def fit(self, dataset: Dataset, *, rng: np.random.Generator, progress: Progress | None = None) -> Self:
        """Learn from ``dataset`` and return self.

        ``progress(done, total)`` is called at the beginning, now and then (about every second, if a
        family takes longer), and at the end; what it raises, as Ctrl-C does, stops the fit, and the model
        is as it was before.
        """

    def check_system(self, system: System) -> None:
        """Raise `IncompatibleSystem` if this family cannot describe ``system``; called before `fit`."""

    def start(self, states: Array, controls: Array, draws: Array | None = None) -> Array:
        return self.lagged(states, controls)

    def lagged(self, states: Array, controls: Array) -> Array:
        """Return state, earlier states and earlier controls, newest first, side by side."""
        state_lags, control_lags = self.lags
        parts = [states[:, -1 - lag] for lag in range(state_lags + 1)]
        parts += [controls[:, -1 - lag] for lag in range(control_lags)]
        return np.concatenate(parts, axis=1)

    def step(self, carry: Array, control: Array, noise: Array | None = None) -> Array:
        after = self.held(carry, control, self.next_state(carry, control))
        return self.remember(carry, control, after)

    def remember(self, carry: Array, control: Array, after: Array) -> Array:
        """Return the lagged carry whose newest state is ``after``: states and controls move one place back.

        Like `held` for (B, n) arrays, or any number of axes before the last.
        """
        state_lags, control_lags = self.lags
        if not state_lags and not control_lags:
            return after
        nx, nu = self.system.nx, self.system.nu
        states = carry[..., : nx * state_lags]
        controls = np.concatenate([control, carry[..., nx * (1 + state_lags) :]], axis=-1)
        return np.concatenate([after, states, controls[..., : nu * control_lags]], axis=-1)

    @property
    def rest_band(self) -> Array | None:
        """How near to neutral (nx,) a state counts as rest; None without ``rest_hold``."""
        if not self.rest_hold:
            return None
        ranges = (self.envelope_[1] - self.envelope_[0]) / self.envelope_multiple
        for i, period in self.system.periods.items():
            ranges[i] = period
        return REST_BAND * ranges

    def held(self, carry: Array, control: Array, after: Array) -> Array:
        """Return ``after`` (B, nx), with ``rest_hold`` neutral where the body rests and all controls are neutral.

        Earlier controls in the carry count too: with dead time, a short pulse acts after it has ended.
        """
        band = self.rest_band
        if band is None:
            return after
        neutral, (state_lags, control_lags) = self.system.neutral_state, self.lags
        nx, nu = self.system.nx, self.system.nu
        still = (np.abs(carry[..., :nx] - neutral) <= band).all(axis=-1)
        idle = (control == self.system.neutral_control).all(axis=-1)
        if control_lags:
            past = carry[..., nx * (1 + state_lags) : nx * (1 + state_lags) + nu * control_lags]
            idle = idle & (past == np.tile(self.system.neutral_control, control_lags)).all(axis=-1)
        return np.where((still & idle)[..., None], neutral, after)

    def next_state(self, carry: Array, control: Array) -> Array:
        """Return the next state (B, nx); by default the integral of `acceleration`."""
        return self.system.integrate(carry[:, : self.system.nx], self.acceleration(carry, control))

    def acceleration(self, carry: Array, control: Array) -> Array:
        """Return the change of the state per second (B, nx), with the frame's rotation taken out."""
        raise TypeError(f"{type(self).__name__} must define one of acceleration, next_state, step")

    def simulate(
        self,
        states: Array,
        past_controls: Array,
        controls: Array,
        *,
        samples: int | None = None,
        rng: np.random.Generator | None = None,
    ) -> Array:
        """Run free under recorded controls: return the states (B, H, nx) after each of H steps.

        ``states`` (B, L + 1, nx) and ``past_controls`` (B, L, nu) are the measured history (L at
        least ``n_lags``; more is left unused), ``controls`` is (B, H, nu). States are clipped to
        the envelope; a state that is not a number becomes its upper limit there and stays nan
        without one. With ``samples``, a stochastic model is run that often: (samples, B, H, nx).
        """
        system = self.system
        states = check_shape("states", states, (None, None, system.nx))
        controls = check_shape("controls", controls, (len(states), None, system.nu))
        past_controls = check_shape("past_controls", past_controls, (len(states), states.shape[1] - 1, system.nu))
        lags = self.n_lags
        if states.shape[1] < lags + 1:
            raise InvalidData(f"{type(self).__name__} needs {lags + 1} measured states to start, got {states.shape[1]}")
        states, past_controls = states[:, -1 - lags :], past_controls[:, past_controls.shape[1] - lags :]
        if samples is not None:
            states, past_controls, controls = (np.tile(a, (samples, 1, 1)) for a in (states, past_controls, controls))
        batch, horizon = controls.shape[:2]
        rng = np.random.default_rng(0) if rng is None else rng
        draws = rng.standard_normal((batch, self.n_draws)) if self.n_draws else None
        out = np.empty((batch, horizon, system.nx))
        with np.errstate(all="ignore"):
            carry = self.start(states, past_controls, draws)
            for k in range(horizon):
                noise = rng.standard_normal((batch, self.n_noise)) if self.n_noise else None
                carry, _ = clip_state(self.step(carry, controls[:, k], noise), self.envelope)
                out[:, k] = carry[:, : system.nx]
        return out if samples is None else out.reshape(samples, batch // samples, horizon, system.nx)


def clip_state(carry: Array, envelope: Array | None) -> tuple[Array, np.ndarray]:
    """Clip the state at the head of ``carry`` to ``envelope``; also return which rows were changed (B,).

    A state that is not a number becomes the upper limit, so that a diverged simulation stays visible.
    """
    if envelope is None:
        return carry, np.zeros(len(carry), dtype=bool)
    low, high = envelope
    inside = np.ones(len(carry), dtype=bool)
    for value, least, most in zip(carry.T, low, high, strict=False):
        inside &= (value >= least) & (value <= most)
    if inside.all():
        return carry, ~inside
    clipped = carry.copy()
    for value, least, most in zip(clipped.T, low, high, strict=False):
        np.maximum(np.fmin(value, most), least, out=value)
    return clipped, ~inside


def training_envelope(states: Array, multiple: float) -> Array:
    """Return the centre of ``states`` (N, nx) plus and minus ``multiple`` half ranges, (2, nx)."""
    low, high = states.min(axis=0), states.max(axis=0)
    centre, half = (low + high) / 2.0, np.maximum((high - low) / 2.0, np.finfo(float).tiny)
    return np.stack([centre - multiple * half, centre + multiple * half])


def _recorded(fit: Any) -> Any:
    """Wrap a family's `fit`: check the system before it, record system and envelope, undo what is interrupted."""

    @functools.wraps(fit)
    def wrapped(
        self: DynamicsModel, dataset: Dataset, *, rng: np.random.Generator, progress: Progress | None = None
    ) -> DynamicsModel:
        self.check_system(dataset.system)
        before = dict(vars(self))
        began, told = time.perf_counter(), (0, 1)

        def report(done: int, total: int) -> None:
            nonlocal told
            told = done, total
            if progress is not None:
                progress(done, total)

        try:
            report(0, 1)
            self.system_ = dataset.system
            states = np.concatenate([episode.states for episode in dataset.episodes])
            self.envelope_ = training_envelope(states, self.envelope_multiple)
            for i in dataset.system.periods:
                self.envelope_[:, i] = -np.inf, np.inf
            fitted: object = fit(self, dataset, rng=rng, progress=report)
            if fitted is not self:
                raise TypeError(f"{type(self).__name__}.fit must return self, got {type(fitted).__name__}")
            if told[0] != told[1]:
                report(told[1], told[1])
        except BaseException:  # an interruption too leaves what was there before
            self.__dict__.clear()
            self.__dict__.update(before)
            raise
        self.fit_seconds = time.perf_counter() - began
        return self

    return wrapped


def require_planar(model: DynamicsModel, system: System) -> None:
    """Raise `IncompatibleSystem` unless the states of ``system`` move a planar body."""
    if system.motion is None or system.motion.kind != "planar_body":
        raise IncompatibleSystem(
            f"{type(model).__name__} describes a planar body, but the system has "
            f"{'no motion' if system.motion is None else 'the motion ' + system.motion.kind}"
        )
