"""One step of any model family as a regressor of scikit-learn."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, Self

import numpy as np
import numpy.typing as npt
from sklearn.base import BaseEstimator, MultiOutputMixin, RegressorMixin
from sklearn.utils.validation import check_is_fitted, validate_data

from sysid_evo.arrays import Array, IntArray
from sysid_evo.data import Dataset
from sysid_evo.data.unnamed import numbered
from sysid_evo.dynamics import DynamicsModel
from sysid_evo.errors import IncompatibleSystem, InvalidArgument
from sysid_evo.fitting import as_generator
from sysid_evo.registry import Spec, make_model
from sysid_evo.system import System

if TYPE_CHECKING:
    from sklearn.utils import Tags

SAME = 1e-9
"""Two rows follow each other if the state after one and that of the next differ by no more than this share of it."""


class TransitionRegressor(MultiOutputMixin, RegressorMixin, BaseEstimator):  # type: ignore[misc]  # scikit-learn has no types
    """The step of a model family from one sample to the next, with ``fit(X, y)`` and ``predict(X)``.

    A row of X is a state and the control held from there, side by side (N, nx + nu); a row of y is the state ``dt``
    seconds later (N, nx), or with ``target="change"`` how much it changes on the way. One state may be flat (N,).
    ``Dataset.transitions().as_arrays()`` is such a pair. y says how many columns of X are states.

    ``model`` is the name of a family with its parameters, such as ``"sindy(degree=3)"``, or an unfitted model, whose
    hyper-parameters then go by ``model__degree`` in a `GridSearchCV`. Families with physics or with periodic
    states need the `System` itself as ``system``, which brings its own ``dt``. ``random_state`` is the seed of the fit,
    0 if it is None. Rows of which each begins where the one before ended become one recording, so that families that
    learn from free runs have runs to learn from; a shuffled table gives single steps.

    A row of X is one sample, so that families with lags get none; one that cannot do without earlier samples, and
    lags that were asked for, are refused. It is the error of a single step that is seen here, which says little about
    simulation: `DynamicsModel.score` judges that. Learned: ``model_``, the fitted `DynamicsModel`.
    """

    model_: DynamicsModel
    n_features_in_: int
    flat_: bool

    def __init__(
        self,
        model: str | Spec | DynamicsModel = "linear",
        *,
        system: System | None = None,
        dt: float = 1.0,
        target: Literal["state", "change"] = "state",
        random_state: int | None = None,
    ) -> None:
        self.model = model
        self.system = system
        self.dt = dt
        self.target = target
        self.random_state = random_state

    def fit(self, X: npt.ArrayLike, y: npt.ArrayLike) -> Self:
        """Fit the family to N transitions and return self.

        Raises `InvalidArgument` if y has more columns than X, ``target`` is unknown or the model shall have lags,
        `IncompatibleSystem` if the columns do not fit ``system`` or the family needs more than one sample, and what
        the family itself raises.
        """
        if self.target not in ("state", "change"):
            raise InvalidArgument(f"target: expected 'state' or 'change', got {self.target!r}")
        rows: Array
        targets: Array
        rows, targets = validate_data(
            self, X, y, multi_output=True, y_numeric=True, ensure_min_samples=2, dtype=np.float64
        )
        after = np.asarray(targets, dtype=np.float64).reshape(len(rows), -1)
        before = rows[:, : after.shape[1]]
        if before.shape != after.shape:
            raise InvalidArgument(
                f"y: expected at most as many columns as X has ({rows.shape[1]}), got {after.shape[1]}: a row of X is "
                "a state and a control, a row of y the state after it"
            )
        if self.target == "change":
            after = before + after
        data = _recording(self._system(rows.shape[1], after.shape[1]), rows, after)
        model = self._unfitted().fit(data, rng=as_generator(self.random_state))
        if model.n_carry > model.system.nx:
            raise IncompatibleSystem(
                f"{type(model).__name__} looks at more than one sample (it remembers {model.n_carry} numbers, the "
                f"state has {model.system.nx}), but a row of X is one: fit the model itself to a Dataset"
            )
        self.model_ = model
        self.flat_ = targets.ndim == 1
        return self

    def predict(self, X: npt.ArrayLike) -> Array:
        """Return the state after each row of X, or its change, (N, nx); (N,) if y was flat. Noise is left out."""
        check_is_fitted(self)
        rows: Array = validate_data(self, X, reset=False, dtype=np.float64)
        nx = self.model_.system.nx
        after = self.model_.step(np.ascontiguousarray(rows[:, :nx]), np.ascontiguousarray(rows[:, nx:]))
        told = after if self.target == "state" else after - rows[:, :nx]
        return told[:, 0] if self.flat_ else told

    def _unfitted(self) -> DynamicsModel:
        """Return the family to fit, made by name or another one like that which was given, without lags."""
        model = self.model.unfitted() if isinstance(self.model, DynamicsModel) else make_model(self.model)
        parameters, usual = model.get_params(), type(model)().get_params()
        lags = [name for name in ("state_lags", "control_lags") if parameters.get(name, 0) != 0]
        asked = [f"{name}={parameters[name]}" for name in lags if parameters[name] != usual[name]]
        if asked:
            raise InvalidArgument(
                f"{type(model).__name__}({', '.join(asked)}): expected no lags, as a row of X is one sample; leave "
                "them out, or fit the model itself to a Dataset"
            )
        return model.set_params(**dict.fromkeys(lags, 0))

    def _system(self, columns: int, nx: int) -> System:
        """Return the system of these columns: that of the user, or states x0, x1, ... and controls u0, u1, ..."""
        if self.system is None:
            return System(numbered("x", nx), numbered("u", columns - nx), self.dt)
        if (self.system.nx, self.system.nu) != (nx, columns - nx):
            raise IncompatibleSystem(
                f"expected {self.system.nx} states in y and {self.system.nx} + {self.system.nu} columns in X, as the "
                f"system has, got {nx} and {columns}"
            )
        return self.system

    def __sklearn_tags__(self) -> Tags:
        tags = super().__sklearn_tags__()
        tags.target_tags.single_output = True
        return tags


def _recording(system: System, X: Array, after: Array) -> Dataset:
    """Return the transitions as episodes, one for each stretch of rows that follow each other."""
    nx = system.nx
    firsts = _firsts(X[:, :nx], after)
    lasts = [*firsts[1:], len(X)]
    stretches = [(first, last) for first, last in zip(firsts, lasts, strict=True)]
    return Dataset.from_arrays(
        system,
        [np.concatenate([X[first:last, :nx], after[last - 1 : last]]) for first, last in stretches],
        [X[first:last, nx:] for first, last in stretches],
        names=[f"rows {first} to {last - 1}" for first, last in stretches],
    )


def _firsts(before: Array, after: Array) -> IntArray:
    """Return the rows that do not begin where the row before them ended."""
    follows = np.isclose(before[1:], after[:-1], rtol=SAME, atol=SAME * np.abs(before).max(initial=0.0)).all(axis=1)
    return np.concatenate([[0], 1 + np.flatnonzero(~follows)])
