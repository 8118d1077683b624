"""The contract of model families: fit, step, simulate, score, adapt."""

from __future__ import annotations

import functools
import time
import warnings
from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from importlib.metadata import entry_points
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, ClassVar, Self, cast, dataclass_transform

import numpy as np
import numpy.typing as npt

from sysid_evo.carry import CarryLayout
from sysid_evo.data.dataset import Dataset, as_dataset, from_samples, subsample
from sysid_evo.data.support import recorded_pairs
from sysid_evo.data.trajectory import Trajectory
from sysid_evo.data.usable import warnings_about
from sysid_evo.display import html_table, line_of
from sysid_evo.errors import DataWarning, IncompatibleSystem, InvalidArgument, InvalidData, NotFitted
from sysid_evo.extras import DISTRIBUTION, missing_extra
from sysid_evo.kernels import DynamicsKernel, Precision, Predictor
from sysid_evo.models.dynamics import (
    Dynamics,
    far_from_zero,
    many_runs,
    no_times,
    of_each_row,
    one_run,
    training_bounds,
)
from sysid_evo.models.kernels.stepping import Output, StepNoise, stepping_kernel
from sysid_evo.models.learned import Declared, Numbers
from sysid_evo.models.parameters import (
    Limit,
    ParameterAccess,
    at_least,
    check_names,
    check_values,
    checked,
    declare,
    shorter,
)
from sysid_evo.processors import one_blas_thread
from sysid_evo.progress import Checkpoint, Progress, TimeLeft, reporting
from sysid_evo.randomness import as_generator
from sysid_evo.registry.grammar import Spec
from sysid_evo.registry.registry import models
from sysid_evo.system import System
from sysid_evo.types import Array
from sysid_evo.validation.simulation_error import error_windows, simulation_error

MOST_LAGS = 10_000
"""A guess: more than any recording supports, and a carry of that size still fits into memory."""


@dataclass_transform(kw_only_default=True, eq_default=False)
class DynamicsModel(Dynamics, ParameterAccess):
    """Base class of model families: hyper-parameters in a keyword-only constructor, learned names end in ``_``.

    A family declares its hyper-parameters as annotated names of the class, ``ridge: float = 0.0``. The constructor is
    generated from these and those of its base classes; an explicit one may only store its arguments. The family
    defines `fit` and one of

    - `acceleration`, if it predicts accelerations: the integration is inherited (paper, section 4);
    - `next_state`, if it predicts the next state;
    - `step`, if its carry holds more than states and controls.

    Hyper-parameters that the base class implements:

    - ``state_lags``, ``control_lags``: the carry holds the state, that many earlier states and that many earlier
      controls, newest first. None lets `fit` choose; it records ``state_lags_`` or ``control_lags_``.
    - ``max_steps``: `fit` gets at most this many steps. Longer data are reduced to blocks of time at random places
      (`sysid_evo.data.dataset`); a `DataWarning` and `fit_note` report it.

    Class attributes:

    - ``knowledge``: how much physics the family assumes (black, dark grey, grey, white).
    - ``model_class``: the class in which `auto` compares it (network, polynomial, neighbours, physics, or another).
    - ``presets``: hyper-parameters that change with the budget (quick, standard, paper); ``limits``: which
      numbers are allowed (types follow from the constructor).
    - ``requires``: optional packages that `fit` imports; ``precision``: the lowest that is exact enough for the
      compiled form.
    - ``periodic``: angles that differ by whole turns are equal to the model.
    - ``resumable``: `fit` stores its progress in ``checkpoint``, if set, and resumes from there to the same model.
    - ``fast_fit``: a fit takes about a second, so that advice may fit copies to parts of the data.
    - ``chooses_families``: `fit` fits many other families, so it is not refitted for an adaptation.

    The shapes of learned arrays are declared in `learned_arrays`; without, files are only checked for nan.

    The `fit` of a family gets a `Dataset`, a generator and a callable. Callers may write ``fit(dataset)``,
    ``fit(dataset, rng=0, progress=True)``, or pass a list of data sets of one system. ``rng=None`` is seed 0;
    ``progress=True`` shows a bar on standard error. Arrays are accepted as in pysindy:
    ``fit(x, t=0.05, u=u, feature_names=[...])`` (`sysid_evo.data.dataset.from_samples`).

    Learned values must be arrays, numbers, strings, fitted models, or lists of these, so that they can be stored.
    Anything else is derived from them when needed: a `functools.cached_property`, such as a kernel, is cleared whenever
    an attribute is set. Every `fit` also records

    - ``system_``;
    - ``state_bounds_``: the centre of the training states plus and minus ``bounds_multiple`` half ranges; simulations
      are clipped there (a periodic state has no bounds);
    - ``training_sample_``: states and controls of the training data, to detect what lies outside them;
    - ``fit_seconds``: the duration of the fit.

    A family that holds data out may record ``held_out_error_`` (`sysid_evo.models.adaptation.held_out_error`): `adapt`
    changes nothing if the error on the new data is similar.
    """

    knowledge: ClassVar[str] = "black"
    model_class: ClassVar[str] = ""
    bounds_multiple: ClassVar[float] = 2.0
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {}
    limits: ClassVar[Mapping[str, Limit]] = {
        "state_lags": at_least(0),
        "control_lags": at_least(0),
        "max_steps": at_least(1),
    }
    requires: ClassVar[tuple[str, ...]] = ()
    resumable: ClassVar[bool] = False
    fast_fit: ClassVar[bool] = False
    chooses_families: ClassVar[bool] = False
    periodic: ClassVar[bool] = False
    precision: ClassVar[Precision] = "float32"
    state_lags: int | None = 0
    control_lags: int | None = 0
    max_steps: int | None = None
    kept_steps_: list[int]
    fit_seconds: float | None = None
    checkpoint: Checkpoint | None = None
    system_: System
    state_bounds_: Array
    training_sample_: Array
    held_out_error_: Array | None = None

    _derived: ClassVar[frozenset[str]] = frozenset({"_stepping_kernel"})

    def __init_subclass__(cls, **keywords: Any) -> None:
        super().__init_subclass__(**keywords)
        cached = {name for name, value in vars(cls).items() if isinstance(value, functools.cached_property)}
        cls._derived = cls._derived | cached
        if "fit" in cls.__dict__:
            cls.fit = recorded(cls.__dict__["fit"])  # type: ignore[method-assign, assignment]  # wraps the family's own
        declare(cls)
        if "__init__" in cls.__dict__:
            cls.__init__ = checked(cls.__dict__["__init__"])  # type: ignore[method-assign]  # wraps the family's own

    def set_params(self, **parameters: Any) -> Self:
        """Change hyper-parameters; a wrong name or value is refused and changes nothing."""
        check_names(type(self), [name.split("__")[0] for name in parameters])
        before = self.get_params(deep=False)
        super().set_params(**parameters)
        try:
            self.check_parameters()
        except InvalidArgument:
            super().set_params(**before)
            raise
        return self

    def check_parameters(self) -> None:
        """Raise `InvalidArgument` if a hyper-parameter has the wrong type or is out of its ``limits``.

        Called by the constructor, `set_params` and `fit`; a family may add checks of several at once.
        """
        check_values(type(self), self.get_params(deep=False))

    @classmethod
    def check_installed(cls) -> None:
        """Raise `MissingExtra` with the command that installs it if a package of ``requires`` is missing."""
        for module in cls.requires:
            if find_spec(module) is None:  # only then: reading all entry points takes longer than a small fit
                points = entry_points(group="sysid_evo.models")
                owner = next((point.dist for point in points if point.module == cls.__module__), None)
                raise missing_extra(cls.__name__, module, owner or DISTRIBUTION)

    def __setattr__(self, name: str, value: Any) -> None:
        """Set an attribute and clear all cached properties, the kernel included."""
        for derived in self._derived:
            self.__dict__.pop(derived, None)
        super().__setattr__(name, value)

    @property
    def system(self) -> System:
        """The system of the training data. Raises `NotFitted` before `fit`."""
        if not hasattr(self, "system_"):
            raise NotFitted(f"{type(self).__name__} is not fitted yet: call fit(dataset, rng=...) first")
        return self.system_

    @property
    def lags(self) -> tuple[int, int]:
        """Number of earlier states and of earlier controls in the carry; if `fit` chooses them, 0 before it."""
        states = getattr(self, "state_lags_", 0) if self.state_lags is None else self.state_lags
        controls = getattr(self, "control_lags_", 0) if self.control_lags is None else self.control_lags
        return states, controls

    def record_lags(self, chosen: tuple[int, int]) -> None:
        """Record the lags ``chosen`` by `fit` (states, controls) where the hyper-parameters are None."""
        if self.state_lags is None:
            self.state_lags_ = chosen[0]
        if self.control_lags is None:
            self.control_lags_ = chosen[1]

    @property
    def layout(self) -> CarryLayout:
        """The positions of states and controls in the carry."""
        return CarryLayout(self.system.nx, self.system.nu, *self.lags)

    @property
    def n_lags(self) -> int:
        return max(self.lags)

    @property
    def n_carry(self) -> int:
        return self.layout.size

    @property
    def state_bounds(self) -> Array | None:
        return getattr(self, "state_bounds_", None)

    @abstractmethod
    def fit(self, dataset: Dataset, *, rng: np.random.Generator, progress: Progress | None = None) -> Self:
        """Fit the model to ``dataset`` and return self.

        ``progress(done, total)`` is called at the beginning, about once a second, and at the end. An exception that it
        raises, or Ctrl-C, stops the fit and leaves the model as it was before.
        """

    def check_system(self, system: System) -> None:
        """Raise `IncompatibleSystem` if this family cannot describe ``system``; called before `fit`."""

    def record(self, dataset: Dataset) -> None:
        """Record the system, the state bounds and a training sample of ``dataset``, as every `fit` does first."""
        states = np.concatenate([episode.states for episode in dataset.episodes])
        self.system_ = dataset.system.within(states)
        self.state_bounds_ = training_bounds(states, self.bounds_multiple)
        for i in dataset.system.periods:
            self.state_bounds_[:, i] = -np.inf, np.inf
        self.training_sample_ = recorded_pairs(dataset)

    def learned_arrays(self) -> Mapping[str, Declared]:
        """Return the shape, or `Numbers`, of each learned array of this fitted model by name.

        ``{"points_": ("points", self.n_carry), "rates_": ("points", self.system.nx)}``: a length given by name is the
        same in all arrays. Shapes are checked when a model is stored and loaded, so that a changed file cannot make a
        kernel read beyond an array. Declarations of base classes are included, without `super`, unless redeclared.
        """
        nx, lags = self.system.nx, Numbers(whole=True, least=0, most=MOST_LAGS, optional=True)
        return {
            "state_lags_": lags,
            "control_lags_": lags,
            "state_bounds_": Numbers(2, nx, infinite=True, rising=True, optional=True),
            "training_sample_": Numbers("pairs", nx + self.system.nu, optional=True),
            "held_out_error_": Numbers(nx, infinite=True, optional=True),
        }

    @property
    def fit_note(self) -> str:
        """Remarks on the fit and its data in one sentence; empty if there are none."""
        far = [self.system.state_names[i] for i in far_from_zero(self.state_bounds)]
        precise = (
            f"runs in double precision, which takes twice the time: {', '.join(far)} varies little compared with its "
            "distance from zero; subtract a constant from the recordings"
        )
        return "; ".join(filter(None, (self._kept_note, precise if far else "")))

    @property
    def _kept_note(self) -> str:
        """How much of the data is used; unlike `fit_note`, which may need learned values, known before the fit."""
        kept, given = getattr(self, "kept_steps_", (0, 0))
        if kept == given:
            return ""
        return (
            f"uses {kept:,} of {given:,} steps, blocks of time at random places, limited by max_steps={self.max_steps}"
        )

    def equations(self) -> list[str]:
        """Return the fitted model as equations in text, one for each state; empty for a family without equations."""
        return []

    def parameters_table(self) -> list[dict[str, Any]]:
        """Return name, value, standard error and unit of every physical parameter; empty for a family without any."""
        return []

    def candidate_ranking(self) -> list[dict[str, str]]:
        """Return the candidates among which `fit` chose, best first; empty for a family that does not choose."""
        return []

    def facts(self) -> Mapping[str, str]:
        """Return a summary of the fitted model, text by name; empty before `fit`."""
        if not hasattr(self, "system_"):
            return {}
        facts = {name: text for name, text in self.system.facts().items() if name != "name"}
        return {"fitted": f"{_numbers_learned(self):,} numbers", **facts} | (
            {"note": self.fit_note} if self.fit_note else {}
        )

    def __repr__(self) -> str:
        made, facts = super().__repr__(), self.facts()
        return f"{made}, {line_of(facts)}" if facts else made

    def _repr_html_(self) -> str:
        facts = dict(self.facts()) or {"fitted": "no"}
        if hasattr(self, "system_"):
            rows = (f"{row['parameter']} = {row['value']:.4g} {row['unit']}" for row in self.parameters_table())
            chosen = (", ".join(row.values()) for row in self.candidate_ranking())
            learned = {"equations": self.equations(), "parameters": rows, "chosen from": chosen}
            facts |= {name: text for name, lines in learned.items() if (text := "\n".join(lines))}
        return html_table(super().__repr__(), facts)

    def families_used(self) -> tuple[str, ...]:
        """Return the names of other registered families that `fit` uses, on which the result depends too."""
        return ()

    def without_noise(self) -> Self:
        """Return this fitted model without noise; itself if it draws none."""
        return self.variant(stochastic=False) if self.get_params(deep=False).get("stochastic") else self

    def fine_tuned(self, dataset: Dataset, updates: int, *, rng: np.random.Generator) -> Self | None:
        """Return this fitted model after ``updates`` more training updates on ``dataset``; None if it has no such."""
        return None

    def score(self, dataset: Dataset | Sequence[Dataset], y: None = None) -> float:
        """Return minus the simulation error: higher is better, as in scikit-learn.

        Simulations of one second, at least ten steps, start at every fourth sample in motion (of long data fewer,
        10,000 in all). The error is the root mean square divided by the standard deviation of the recording, averaged
        over steps and states: 0 is perfect, about -1 no better than the mean of the recording. Noise is switched off.
        ``y`` is unused; scikit-learn passes it.
        """
        data = as_dataset(dataset, f"{type(self).__name__}.score", of=self.system)
        for remark in warnings_about(data, "scored on"):
            warnings.warn(f"{type(self).__name__} {remark}", DataWarning, stacklevel=2)
        return -simulation_error(self.without_noise(), error_windows(data, self.n_lags))

    def adapt(
        self,
        dataset: Dataset,
        *,
        training: Dataset | None = None,
        rng: np.random.Generator | int | None = None,
        progress: Progress | bool | None = None,
    ) -> DynamicsModel:
        """Return this model adapted to a recording of 10 to 30 s in a new condition, as a model of family ``adapted``.

        Returns the model unchanged (inside ``adapted``) if no candidate passes the acceptance test; `fit_note` reports
        the decision. A fit to the new data alone, and with ``training`` (the data of this model) a refit to both, are
        candidates too; each takes four fits.

        Raises `IncompatibleSystem` for data of another robot, `InvalidData` if they are too short to simulate 1 s.
        """
        family: Any = models.get("adapted")
        found: DynamicsModel = family(base=None).given(self, training).fit(dataset, rng=rng, progress=progress)
        return found

    def predictor(self) -> Predictor | None:
        """Return the compiled form of `next_state` or `acceleration`, whichever is predicted; None without one."""
        return None

    def kernel(self) -> DynamicsKernel | None:
        return self._stepping_kernel

    @functools.cached_property
    def _stepping_kernel(self) -> DynamicsKernel | None:
        predictor = self.predictor()
        return None if predictor is None else self.stepping(predictor)

    def stepping(self, predictor: Predictor, noise: StepNoise | None = None) -> DynamicsKernel | None:
        """Return the compiled form of `step`: ``predictor`` with motion, noise and lags; None without one."""
        output: Output = "acceleration" if type(self).next_state is DynamicsModel.next_state else "next_state"
        kernel = stepping_kernel(predictor, self.system, output=output, lags=self.lags, noise=noise)
        return None if kernel is None else replace(kernel, precision=self.precision)

    def start(self, states: Array, controls: Array, draws: Array | None = None) -> Array:
        return self.initial_carry(states, controls)

    def initial_carry(self, states: Array, controls: Array) -> Array:
        """Return the carry (B, n_carry): state, earlier states and earlier controls, newest first."""
        return np.concatenate(self.layout.initial_parts(states, controls), axis=1)

    def step(self, carry: Array, control: Array, noise: Array | None = None) -> Array:
        after = of_each_row(self, "next_state", carry, self.next_state(carry, control))
        return self.shift_lags(carry, control, self.apply_limits(after))

    def shift_lags(self, carry: Array, control: Array, after: Array) -> Array:
        """Return the lagged carry whose newest state is ``after``: states and controls move one place back.

        Like `apply_limits` for (B, n) arrays, or any number of axes before the last.
        """
        parts = self.layout.shifted_parts(carry, control, after)
        return np.concatenate(parts, axis=-1) if len(parts) > 1 else after

    def apply_limits(self, after: Array) -> Array:
        """Return ``after`` (B, nx) within the limits of the channels."""
        return np.clip(after, *self.system.limits) if self.system.limited else after

    def next_state(self, carry: Array, control: Array) -> Array:
        """Return the next state (B, nx); by default the integral of `acceleration`."""
        rates = of_each_row(self, "acceleration", carry, self.acceleration(carry, control))
        return self.system.integrate(carry[:, : self.system.nx], rates)

    def acceleration(self, carry: Array, control: Array) -> Array:
        """Return the rate of change of the state per second (B, nx), without the rotation of the frame."""
        raise TypeError(f"{type(self).__name__} must define one of acceleration, next_state, step")

    def simulate(
        self,
        states: npt.ArrayLike | Trajectory,
        past_controls: npt.ArrayLike | None = None,
        controls: npt.ArrayLike | None = None,
        *,
        samples: int | None = None,
        rng: np.random.Generator | int | None = None,
        t: object = None,
        u: object = None,
    ) -> Array:
        """Return the states after each of H steps of a simulation under given controls.

        One run: ``simulate(x0, u)`` with the state (nx,) or a history (L + 1, nx), and controls
        (H, nu), (H,) for one control; returns (H, nx). The controls before the run are neutral unless given:
        ``simulate(history, past_u, u)``.
        ``simulate(trajectory)`` starts from its first ``n_lags`` + 1 states and runs to its end.

        Many runs: ``simulate(states, past_controls, controls)`` with the measured history (B, L + 1, nx)
        and (B, L, nu), and (B, H, nu); returns (B, H, nx).

        If a history has fewer than ``n_lags`` samples before its last state, its first state is repeated, with neutral
        controls; more than ``n_lags`` are ignored.

        States are clipped to the state bounds; nan becomes the upper bound, and stays nan without one. ``samples``
        simulations of a stochastic model are the first axis of the result; ``rng`` (seed 0 by default) draws its noise.
        """
        system, lags = self.system, self.n_lags
        if t is not None or u is not None:
            raise InvalidArgument(no_times(system))
        if isinstance(states, Trajectory):
            run = states
            if len(run) <= lags:
                raise InvalidData(
                    f"{type(self).__name__} needs {lags + 1} states to start, {run.name!r} has no more than these"
                )
            states, past_controls, controls = run.states[: lags + 1], run.controls[:lags], run.controls[lags:]
        elif controls is None:
            past_controls, controls = None, past_controls
        if samples is not None and getattr(self, "stochastic", False) and not self.n_noise:
            raise NotFitted(
                f"{type(self).__name__} was not fitted with stochastic=True, so its noise is not known: fit it again"
            )
        if controls is None:
            raise InvalidArgument("simulate: expected a state and controls, or a Trajectory; got no controls")
        alone = np.ndim(states) < 3 and np.ndim(controls) < 3
        if alone:
            states, past_controls, controls = one_run(system, states, past_controls, controls)
        simulated = many_runs(self, states, past_controls, controls, samples, as_generator(rng))
        return simulated[..., 0, :, :] if alone else simulated


def _numbers_learned(model: DynamicsModel) -> int:
    """Return the number of values in the arrays of a fitted model, nested models included."""
    learned = {name: value for name, value in vars(model).items() if name.endswith("_") and name != "training_sample_"}
    parts = [part for value in learned.values() for part in (value if isinstance(value, (list, tuple)) else [value])]
    arrays = sum(part.size for part in parts if isinstance(part, np.ndarray))
    return arrays + sum(_numbers_learned(part) for part in parts if isinstance(part, DynamicsModel))


def require_planar(model: DynamicsModel, system: System) -> None:
    """Raise `IncompatibleSystem` unless the states of ``system`` move a planar body."""
    if system.motion is None or system.motion.kind != "planar_body":
        raise IncompatibleSystem(
            f"{type(model).__name__} describes a planar body, but the system has "
            f"{'no motion' if system.motion is None else 'the motion ' + system.motion.kind}"
        )


def recorded(fit: Callable[..., DynamicsModel]) -> Callable[..., DynamicsModel]:
    """Wrap a family's `fit`: check the arguments, record system and state bounds, restore the model if it fails."""

    @functools.wraps(fit)
    def wrapped(
        self: DynamicsModel,
        dataset: Dataset | Sequence[Dataset] | npt.ArrayLike,
        *,
        rng: np.random.Generator | int | None = None,
        progress: Progress | bool | None = None,
        t: float | npt.ArrayLike | Sequence[npt.ArrayLike] | None = None,
        u: npt.ArrayLike | Sequence[npt.ArrayLike] | None = None,
        feature_names: Sequence[str] | None = None,
    ) -> DynamicsModel:
        called, generator = f"{type(self).__name__}.fit", as_generator(rng)
        if (u is not None or feature_names is not None) and t is None:
            raise InvalidArgument(
                f"{called}: expected the time step or the times t with u and feature_names: fit(x, t=0.05, u=u); a "
                "Dataset has its own"
            )
        x = cast(npt.ArrayLike, dataset)
        data = as_dataset(dataset, called) if t is None else from_samples(x, t, u, feature_names)
        self.check_parameters()
        self.check_installed()
        self.check_system(data.system)
        for remark in warnings_about(data, "fitted to"):
            warnings.warn(f"{type(self).__name__} {remark}", DataWarning, stacklevel=2)
        with reporting(progress, f"fit {type(self).__name__}") as report, one_blas_thread():
            return _kept(self, fit, data, generator, report)

    del wrapped.__wrapped__  # so that its signature shows all arguments
    return wrapped


def _kept(
    self: DynamicsModel,
    fit: Callable[..., DynamicsModel],
    dataset: Dataset,
    rng: np.random.Generator,
    progress: Progress | None,
) -> DynamicsModel:
    before = dict(vars(self))
    began, last, estimate = time.perf_counter(), (0, 1), TimeLeft()

    def report(done: int, total: int, note: str = "") -> None:  # noqa: ARG001  # a fit reports numbers only
        nonlocal last
        last = done, total
        if (left := estimate.long(done, total)) is not None:
            what = f"may take {left / 60.0:.0f} min more; each of these makes it shorter: {shorter(self, dataset)}"
            warnings.warn(f"{type(self).__name__} {what}", DataWarning, stacklevel=4)
        if progress is not None:
            progress(done, total)

    try:
        report(0, 1)
        self.record(dataset)
        fitted: object = fit(self, _few_enough(self, dataset, rng), rng=rng, progress=report)
        if fitted is not self:
            raise TypeError(f"{type(self).__name__}.fit must return self, got {type(fitted).__name__}")
        if last[0] != last[1]:
            report(last[1], last[1])
    except BaseException:  # also restored after Ctrl-C
        self.__dict__.clear()
        self.__dict__.update(before)
        raise
    self.fit_seconds = time.perf_counter() - began
    return self


def _few_enough(self: DynamicsModel, dataset: Dataset, rng: np.random.Generator) -> Dataset:
    """Return at most ``max_steps`` steps of ``dataset``; if that is not all, warn and record how many."""
    few = dataset if self.max_steps is None else subsample(dataset, self.max_steps, rng)
    self.__dict__.pop("kept_steps_", None)
    if few is not dataset:
        self.kept_steps_ = [few.n_steps, dataset.n_steps]
        warnings.warn(f"{type(self).__name__} {self._kept_note}", DataWarning, stacklevel=4)
    return few


if TYPE_CHECKING:

    class AnyModel(DynamicsModel):
        """A model of some family as callers see it: `fit` takes everything that `recorded` converts to a `Dataset`."""

        def fit(
            self,
            dataset: Dataset | Sequence[Dataset] | npt.ArrayLike,
            *,
            rng: np.random.Generator | int | None = None,
            progress: Progress | bool | None = None,
            t: float | npt.ArrayLike | Sequence[npt.ArrayLike] | None = None,
            u: npt.ArrayLike | Sequence[npt.ArrayLike] | None = None,
            feature_names: Sequence[str] | None = None,
        ) -> Self: ...

else:
    AnyModel = DynamicsModel


def make_model(spec: str | Spec, /, **parameters: Any) -> AnyModel:
    """Return the unfitted model that ``spec`` names, with its parameters and ``parameters``; see `Registry.make`."""
    made: AnyModel = models.make(spec, **parameters)
    return made
