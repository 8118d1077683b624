"""Family regressor, and the adapter that makes models of the regressors that are passed in Python."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from typing import Any, ClassVar, Literal, Self

import numpy as np

from model_zoo.compiled_forms import CompiledForm, compiled_form, of_scaled
from model_zoo.estimators import Boosters, estimator_class, fitted_estimator, make_estimator, predicted, read, written
from model_zoo.features import Features, between_limits, integrals, next_state, next_state_predictor
from model_zoo.scaling import deviation
from model_zoo.tree_ensembles import has_trees
from sysid_evo import Adapter, Dataset, DynamicsModel, register_adapter, register_model
from sysid_evo.errors import InvalidArgument, ShapeError, UnknownName
from sysid_evo.kernels import DynamicsKernel
from sysid_evo.models.kernels import Predictor, with_angles
from sysid_evo.models.kernels.shells import scaled_outputs
from sysid_evo.models.kernels.stepping import StepNoise
from sysid_evo.models.learned import Declared, Numbers
from sysid_evo.models.stochastic import StochasticModel
from sysid_evo.progress import Counter, Progress
from sysid_evo.registry.objects import is_object_text, kept_object
from sysid_evo.types import Array
from sysid_evo.validation.folds import FOLDS
from sysid_evo.validation.held_out import HeldOutError, best_candidate, count_fits, lag_candidates

FAR = 1e30
"""Limit of the scaled inputs: trees compare them in single precision."""


@register_model("regressor")
class Regressor(StochasticModel):
    """Any regressor of scikit-learn's interface, such as a random forest, fitted to the steps of the recordings.

    ``estimator`` is the class name of a regressor of scikit-learn, LightGBM, XGBoost or a plugin file, and all further
    parameters are its own: ``regressor(estimator=RandomForestRegressor, n_estimators=50)``. In Python it may also be an
    object, such as a pipeline or a `GridSearchCV`, of which the best estimator is kept. A regressor of a single output
    is fitted for each state.

    Inputs are the lagged states and controls, an angle as sine and cosine. Inputs and outputs are divided by their
    deviations, except the inputs of trees, which are rounded to single precision. ``target`` is the change of the state
    in one step, the default, or the next state (of positions and angles the change, see `integrals`). Lags left at None
    are chosen by the simulation error over one second on held-out blocks of time.

    With ``fitted`` the object is used as it is: its inputs are states, earlier states, earlier controls and controls in
    the units of the recordings, newest first, its outputs the ``target`` of all states, by default the one with the
    lower error of one step.
    """

    knowledge = "black"
    typical_fit_seconds = 20.0
    model_class = "regressor"
    periodic = True
    requires = ("skops",)
    plugin_parameters = ("estimator",)
    presets: ClassVar[dict[str, dict[str, Any]]] = {"quick": {"state_lags": 0, "control_lags": 3}}
    timing_parameters: ClassVar[dict[str, Any]] = {}

    def __init__(
        self,
        *,
        estimator: Any = "HistGradientBoostingRegressor",
        target: Literal["change", "next_state"] | None = None,
        fitted: bool = False,
        state_lags: int | None = None,
        control_lags: int | None = None,
        stochastic: bool = False,
        max_steps: int | None = 100_000,
        **settings: Any,
    ) -> None:
        self.estimator, self.target, self.fitted = estimator, target, fitted
        self.state_lags, self.control_lags = state_lags, control_lags
        self.stochastic, self.max_steps = stochastic, max_steps
        self.settings = settings

    def get_params(self, deep: bool = True) -> dict[str, Any]:
        parameters = super().get_params(deep)
        settings = parameters.pop("settings")
        return {**parameters, **settings}

    def set_params(self, **parameters: Any) -> Self:
        own, before = inspect.signature(type(self)).parameters, self.settings
        self.settings = {**before, **{name: value for name, value in parameters.items() if name not in own}}
        try:
            return super().set_params(**{name: value for name, value in parameters.items() if name in own})
        except InvalidArgument:
            self.settings = before
            raise

    def check_parameters(self) -> None:
        super().check_parameters()
        if self._from_python:
            if self.settings:
                raise InvalidArgument(
                    f"regressor: {', '.join(self.settings)}: set the parameters of an object before it is passed"
                )
            return
        if self.fitted:
            raise InvalidArgument("regressor: fitted=True expects a fitted regressor as estimator, got a class name")
        make_estimator(self.estimator, self.settings)

    def fit(self, dataset: Dataset, *, rng: np.random.Generator, progress: Progress | None = None) -> Self:
        seed = int(rng.integers(2**31))
        if self.fitted:
            return self._use(kept_object(self.estimator), dataset)
        pairs = lag_candidates(self.state_lags, self.control_lags)
        counter = Counter(progress, count_fits(pairs) * FOLDS + 1)
        blocks = HeldOutError.of(dataset)

        def learned(part: Dataset, lags: tuple[int, int]) -> DynamicsModel:
            trial = self.variant(state_lags=lags[0], control_lags=lags[1])
            trial._learn(part, seed)
            return trial

        chosen = best_candidate(
            pairs, lambda lags: blocks.error(lambda part: learned(part, lags), stride=8, report=counter.advance)
        )
        self.record_lags(chosen)
        self._keep(self._learn(dataset, seed))
        counter.advance()
        self.calibrate(dataset, rng, lambda: counter.advance(0))
        return self

    def _learn(self, dataset: Dataset, seed: int) -> Any:
        """Fit the regressor with the present lags and return it; it is not stored yet."""
        system = dataset.system
        data = dataset.transitions(state_lags=self.lags[0], control_lags=self.lags[1], moving=True)
        free = between_limits(system, data.after)
        state, after = data.state[free], data.after[free]
        inputs = Features(system, self.lags)(data.carry[free], data.control[free])
        changed = np.ones(system.nx, dtype=bool) if self.target != "next_state" else integrals(dataset)
        targets = np.where(changed, system.difference(after, state), after)
        self.added_ = changed.astype(float)
        self.output_centre_, self.output_scale_ = targets.mean(axis=0), deviation(targets)
        unfitted = kept_object(self.estimator)
        unfitted = make_estimator(unfitted, self.settings) if isinstance(unfitted, str) else unfitted
        self.single_ = has_trees(unfitted)
        nothing = np.zeros(inputs.shape[1])
        self.input_centre_ = nothing if self.single_ else inputs.mean(axis=0)
        self.input_scale_ = nothing + 1.0 if self.single_ else deviation(inputs)
        inputs = self._scaled(inputs)
        targets = (targets - self.output_centre_) / self.output_scale_
        found, self.converged_ = fitted_estimator(unfitted, inputs, targets, seed)
        self.__dict__["_regressor"] = found
        return found

    def _keep(self, regressor: Any) -> None:
        self.format_, data = written(regressor)
        self.stored_ = np.frombuffer(data, dtype=np.int8)

    def _use(self, regressor: Any, dataset: Dataset) -> Self:
        """Use a fitted ``regressor`` as it is. Raises `InvalidArgument` if its inputs or outputs are others."""
        regressor = getattr(regressor, "best_estimator_", regressor)
        self.record_lags((0, 0))
        nx, names = self.system.nx, self.layout.input_names(self.system.state_names, self.system.control_names)
        self.added_ = np.zeros(nx)
        self.input_centre_, self.input_scale_, self.single_ = np.zeros(len(names)), np.ones(len(names)), False
        self.output_centre_, self.output_scale_ = np.zeros(nx), np.ones(nx)
        expected = (
            f"regressor: expected a fitted one with the inputs {', '.join(names)} and {nx} outputs (an unfitted one is "
            "fitted to the recordings: sklearn.base.clone(it))"
        )
        given = list(getattr(regressor, "feature_names_in_", names))
        if given != names and set(given) & set(names):
            raise InvalidArgument(f"{expected}, got the inputs {', '.join(given)}")
        self._keep(regressor)
        data = dataset.transitions(state_lags=self.lags[0], control_lags=self.lags[1])
        try:
            found = predicted(self._regressor, np.hstack([data.carry, data.control]))
        except ValueError as error:
            raise InvalidArgument(f"{expected}: {error}") from error
        if found.size != data.state.size or len(found) != len(data.state):
            raise InvalidArgument(f"{expected}, got outputs of shape {found.shape[1:]}")
        spread, found = deviation(data.state), found.reshape(data.state.shape)
        change, next_state = (
            float(np.abs(self.system.difference(reached, data.after) / spread).mean())
            for reached in (data.state + found, found)
        )
        self.added_ += self.target == "change" or (self.target is None and change < next_state)
        return self

    @cached_property
    def _regressor(self) -> Any:
        return read(self.format_, self.stored_.tobytes())

    def learned_arrays(self) -> Mapping[str, Declared]:
        nx, lags = self.system.nx, self.lags
        inputs = self.layout.size + self.system.nu if self.fitted else len(Features(self.system, lags).names)
        known = int(getattr(self._regressor, "n_features_in_", inputs))
        if known != inputs or predicted(self._regressor, np.zeros((1, inputs))).size != nx:
            raise ShapeError(f"the stored regressor: expected {inputs} inputs and {nx} outputs, got {known} inputs")
        return {
            "stored_": Numbers("bytes", whole=True),
            "added_": Numbers(nx, least=0, most=1),
            "input_centre_": (inputs,),
            "input_scale_": (inputs,),
            "output_centre_": (nx,),
            "output_scale_": (nx,),
        }

    @property
    def fit_note(self) -> str:
        outputs = "changes" if np.any(getattr(self, "added_", 0.0)) else "next states"
        used = (
            f"the regressor was fitted in Python before and is used as it is, its outputs as {outputs}; "
            "errors are too low where it was fitted to held-out data"
        )
        given = "the regressor was given in Python" if self._from_python else ""
        early = "" if getattr(self, "converged_", True) else "the fit ended before it converged: increase max_iter"
        return "; ".join(filter(None, (super().fit_note, used if self.fitted else given, early)))

    @property
    def depth_only(self) -> bool:
        """Whether a step takes longer with more data only as trees become deeper."""
        return self.single_

    @property
    def _from_python(self) -> bool:
        """Whether the estimator is an object, or the text that names one, rather than a class name."""
        return not isinstance(self.estimator, str) or is_object_text(self.estimator)

    @cached_property
    def _compiled_form(self) -> CompiledForm | None:
        from sklearn.multioutput import MultiOutputRegressor

        regressor, seen = self._regressor, self.layout.size
        if isinstance(regressor, Boosters):
            regressor = MultiOutputRegressor(None)
            regressor.estimators_ = self._regressor.boosters
        return compiled_form(
            regressor, seen if self.fitted else Features(self.system, self.lags).n_carry, self.system.nu
        )

    def predictor(self) -> Predictor | None:
        """None for a regressor without a compiled form, see `compiled_form`; the model then runs in Python."""
        if self._compiled_form is None:
            return None
        inner = self._compiled_form.predictor
        if not self.fitted:
            n_carry = Features(self.system, self.lags).n_carry
            if not self.single_:
                inner = of_scaled(inner, n_carry, 1.0 / self.input_scale_, self.input_centre_)
            inner = with_angles(inner, self.system, self.lags)
            inner = scaled_outputs(inner, self.output_scale_, self.output_centre_)
        return next_state_predictor(self.added_, inner)

    def stepping(self, predictor: Predictor, noise: StepNoise | None = None) -> DynamicsKernel | None:
        kernel, form = super().stepping(predictor, noise), self._compiled_form
        return None if kernel is None or form is None else replace(kernel, precision=form.precision)

    def _scaled(self, inputs: Array) -> Array:
        """Return scaled inputs (N, m), those of trees rounded to single precision as in their compiled form."""
        scaled = np.clip((inputs - self.input_centre_) / self.input_scale_, -FAR, FAR)
        return scaled.astype(np.float32).astype(np.float64) if self.single_ else scaled

    def next_state(self, carry: Array, control: Array) -> Array:
        join = (lambda a, b: np.concatenate([a, b], axis=1)) if self.fitted else Features(self.system, self.lags)
        inputs = self._scaled(join(carry, control))
        known = np.isfinite(inputs).all(axis=1, keepdims=True)
        inputs = np.where(known, inputs, 0.0)
        found = predicted(self._regressor, inputs).reshape(len(carry), -1)
        found = np.where(known, found * self.output_scale_ + self.output_centre_, np.nan)
        return next_state(self.added_, carry[:, : self.system.nx], found)


@register_adapter("scikit_learn")
class ScikitLearnAdapter(Adapter):
    """Regressors of scikit-learn's interface: estimators, pipelines, searches, LightGBM and XGBoost."""

    example = "sklearn.linear_model.Ridge()"

    def recognises(self, thing: object) -> bool:
        if not hasattr(thing, "get_params") or not hasattr(thing, "predict"):
            return False
        from sklearn.base import is_regressor

        try:
            return bool(is_regressor(thing))
        except (AttributeError, TypeError):  # it has no tags of scikit-learn
            return False

    def model(self, thing: Any, *, fitted: bool = False) -> Regressor:
        """Return the family with the class name and settings of ``thing`` if text can write them, else with a copy."""
        from sklearn.base import clone
        from sklearn.exceptions import NotFittedError
        from sklearn.utils.validation import check_is_fitted

        try:
            check_is_fitted(thing)
        except NotFittedError as error:
            if fitted:
                raise InvalidArgument(f"fitted=True: expected a fitted regressor: {error}") from error
        else:
            return Regressor(estimator=thing, fitted=True)
        name = type(thing).__name__
        try:
            defaults = make_estimator(name, {}).get_params() if estimator_class(name) is type(thing) else {}
        except (UnknownName, InvalidArgument):
            defaults = {}
        changed = {
            key: one for key, one in thing.get_params(deep=False).items() if repr(one) != repr(defaults.get(key))
        }
        plain = all(one is None or type(one) in (bool, int, float, str) for one in changed.values())
        plain = plain and changed.keys() <= defaults.keys()  # boosters take parameters that they do not name
        if not defaults or not plain or changed.keys() & inspect.signature(Regressor).parameters.keys():
            return Regressor(estimator=clone(thing))
        return Regressor(estimator=name, **changed)
