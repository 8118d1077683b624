"""Family equations: a function of the user, of rates or next states, with or without unknown parameters."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache, cached_property
from types import FunctionType
from typing import Any, Literal

import numpy as np

from model_zoo.grey_box.equation import GreyBoxEquation
from model_zoo.grey_box.model import GreyBox
from model_zoo.grey_box.parameters import DECADE, Parameter
from model_zoo.scaling import positive
from sysid_evo import register_model
from sysid_evo.data import Dataset
from sysid_evo.errors import IncompatibleSystem, InvalidArgument, ShapeError
from sysid_evo.laws import array_form
from sysid_evo.models.learned import Declared
from sysid_evo.registry.objects import class_name, kept_object
from sysid_evo.registry.plugins import named_in_plugin
from sysid_evo.system import System
from sysid_evo.types import Array

EXAMPLE = (
    "def pendulum(x, u, p=(('stiffness', 1, 100), ('friction', 0, 5))):\n"
    "    return x[1], -p[0] * np.sin(x[0]) - p[1] * x[1] + u[0]"
)
TRIED = 12
"""Recorded states at which the forms of a function are compared."""
CLEAR = 1.25
"""How many times the error of one meaning must be that of the other if the data are to choose between them."""


@register_model("equations")
class FunctionGreyBox(GreyBox):
    """Equations of your own: a function f(x, u) or f(x, u, p) of NumPy that returns rates or next states.

    ``function`` is the function, or the name of one in a plugin file (``FILE.NAME`` if several files have it). x and u
    are states and controls in the order of the system. The function may be written for one sample, x (nx,), which often
    holds for x (nx, N) too, or for rows, x (N, nx): `fit` calls it to find out, and compares with single calls.
    ``returns`` is ``rate`` or ``next_state``; None chooses by the error of one step, and raises `InvalidArgument` if
    the two errors are close. Rates are integrated by the Runge-Kutta method with controls held, in ``substeps``; the
    rotation of a body frame is not added.

    The default of ``p`` is a tuple of parameters, each a `Parameter` or ``(name, low, high)``. They are fitted as in
    any grey box. Without ``p`` nothing is fitted. A function that kernels can read (docs/extending/kernels.md) is
    compiled; others run in NumPy. An angle is continuous, beyond a turn as well.
    """

    knowledge = "grey"
    periodic = True
    plugin_parameters = ("function",)

    function: Any = None
    returns: Literal["rate", "next_state"] | None = None

    @property
    def called(self) -> Callable[..., Any]:
        """The function. Raises `InvalidArgument` if there is none, or if it has another signature."""
        found = kept_object(self.function)
        found = named_in_plugin(found, FunctionType) if isinstance(found, str) else found
        if not callable(found):
            raise InvalidArgument(f"equations: expected a function or the name of one in a plugin file. {EXAMPLE}")
        arguments = list(inspect.signature(found).parameters.values())
        needed = [one for one in arguments if one.default is one.empty]
        if len(arguments) not in (2, 3) or len(needed) != 2:
            given = f"{class_name(found)}{inspect.signature(found)}"
            raise InvalidArgument(
                f"equations: expected f(x, u), or f(x, u, p) with bounds as the default of p; got {given}. {EXAMPLE}"
            )
        return found

    @property
    def law(self) -> Callable[..., Any]:
        function = self.called
        return function if self.law_parameters() else _without_parameters(function)

    def law_parameters(self) -> tuple[Parameter, ...]:
        arguments = list(inspect.signature(self.called).parameters.values())
        return _parameters(arguments[2].default) if len(arguments) == 3 else ()

    def check_parameters(self) -> None:
        if self.returns == "next_state":
            self._check_rates()

    def _check_rates(self) -> None:
        if self.actuator_lag or self.residual:
            raise InvalidArgument("equations: actuator_lag and residual need a function that returns rates")

    def check_system(self, system: System) -> None:
        """Call the function at rest. Raises `IncompatibleSystem` if it does not return the states of ``system``."""
        p = np.array([parameter.guess for parameter in self.law_parameters()])
        x, u = system.neutral_state, system.neutral_control
        try:
            with np.errstate(all="ignore"):
                _of_one(self.called, x, u, p)
        except (TypeError, ValueError, IndexError) as error:
            _of_rows(self.called, np.stack([x, x, x]), np.stack([u, u, u]), p, error)

    def prepare(self, dataset: Dataset) -> None:
        data, system, function = dataset.transitions(), dataset.system, self.called
        rows = np.unique(np.linspace(0, len(data.state) - 1, TRIED).astype(np.int64))
        x, u, after = data.state[rows], data.control[rows], data.after[rows]
        p = np.array([parameter.guess for parameter in self.law_parameters()])
        try:
            found = np.stack([_of_one(function, x[i], u[i], p) for i in range(len(x))])
            forms: tuple[str, ...] = FORMS[:2]
        except (TypeError, ValueError, IndexError) as error:
            found, forms = _of_rows(function, x, u, p, error), FORMS[1:2]
        odd = np.flatnonzero(~np.isfinite(found).all(axis=1))
        if len(odd):
            raise InvalidArgument(
                f"equations: expected finite numbers at the recorded states, got {found[odd[0]]} at x = {x[odd[0]]}"
            )
        again = _of_one(function, x[0], u[0], p) if len(forms) > 1 else _of_rows(function, x, u, p, ValueError())[0]
        if not np.array_equal(again, found[0]):
            raise InvalidArgument(
                f"equations: expected the same numbers for the same x and u: {class_name(function)} returned "
                f"{found[0]}, then {again}. It must neither draw random numbers nor keep values between calls"
            )
        self.form_ = next((one for one in forms if _equals(function, one, x, u, p, found)), "single")
        spread = positive(data.state.std(axis=0))
        reached = {"rate": x + system.dt * found, "next_state": found}
        errors = {name: float(np.abs(system.difference(y, after) / spread).mean()) for name, y in reached.items()}
        likely, other = sorted(errors, key=lambda one: errors[one])
        if self.returns is None and errors[other] < CLEAR * errors[likely]:
            raise InvalidArgument(
                f"equations: the data do not show whether {class_name(function)} returns rates or next states (errors "
                f"of one step {errors['rate']:.3g} and {errors['next_state']:.3g} standard deviations): add "
                "returns='rate' or returns='next_state'"
            )
        self.returned_ = self.returns or likely
        if self.returned_ == "next_state":
            self._check_rates()

    @cached_property
    def _array_law(self) -> Callable[..., Any]:
        return _on_arrays(self.called, self.form_)

    def _structure_on(
        self, system: System, states: tuple[int, ...] | None = None, controls: tuple[int, ...] | None = None
    ) -> GreyBoxEquation:
        found = super()._structure_on(system, states, controls)
        if not hasattr(self, "returned_"):
            return found
        return replace(found, array_law=self._array_law, own_frame=True, discrete=self.returned_ == "next_state")

    def learned_arrays(self) -> Mapping[str, Declared]:
        for name, allowed in (("form_", FORMS), ("returned_", ("rate", "next_state"))):
            if getattr(self, name, None) not in allowed:
                raise ShapeError(f"{name}: expected one of {', '.join(allowed)}, got {getattr(self, name, None)!r}")
        return super().learned_arrays()

    @property
    def fit_note(self) -> str:
        single = ", one sample at a time" if self.form_ == "single" else ""
        slow = "write one number for each state, with x[0], u[0], math and if, and without loops, to have one"
        slow = "" if self.kernel() is not None else f"runs in NumPy{single}, because it has no compiled form: {slow}"
        return "; ".join(filter(None, (super().fit_note, "" if self.law_parameters() else "used as it is", slow)))


FORMS = ("columns", "rows", "single")


def _parameters(given: Any) -> tuple[Parameter, ...]:
    """Return the parameters that the default of p describes; a guess is the middle of the bounds."""
    found = []
    for one in given if isinstance(given, (list, tuple)) else ():
        if isinstance(one, Parameter):
            found.append(one)
        elif isinstance(one, (list, tuple)) and len(one) == 3 and isinstance(one[0], str):
            low, high = float(one[1]), float(one[2])
            logarithmic = low > 0.0 and high >= DECADE * low
            found.append(Parameter(one[0], math.sqrt(low * high) if logarithmic else 0.5 * (low + high), low, high))
        else:
            raise InvalidArgument(f"equations: p: expected a Parameter or (name, low, high), got {one!r}. {EXAMPLE}")
    if not found:
        raise InvalidArgument(
            f"equations: expected parameters as the default of p, got {given!r}: leave p out, or write {EXAMPLE}"
        )
    return tuple(found)


@cache
def _without_parameters(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return ``function`` with the arguments of a law, the same one each time, so that it is compiled once."""

    def law(x: Any, u: Any, p: Any) -> Any:  # noqa: ARG001  # the arguments of every law
        return function(x, u)

    return law


def _called(function: Callable[..., Any], x: Any, u: Any, p: Any) -> Any:
    x, u = np.array(x), np.array(u)  # a function may write into its arguments
    return function(x, u, p) if len(p) else function(x, u)


def _of_one(function: Callable[..., Any], x: Array, u: Array, p: Array) -> Array:
    """Return the result (nx,) for one sample. Raises `ValueError` if it is another number of numbers."""
    found = np.asarray(_called(function, x, u, p), dtype=np.float64).ravel()
    if found.shape != x.shape:
        raise ValueError(f"{len(found)} numbers for {len(x)} states")
    return found


def _of_rows(function: Callable[..., Any], x: Array, u: Array, p: Array, error: Exception) -> Array:
    """Return the results (N, nx) of a function that takes rows only. Raises `IncompatibleSystem` with ``error``."""
    try:
        found = np.asarray(_called(function, x, u, p), dtype=np.float64)
        if found.shape == x.shape:
            return found
        if isinstance(error, IndexError):
            error = ValueError(f"a result of shape {found.shape} for x of shape {x.shape}")
    except (TypeError, ValueError, IndexError):  # the first error is the one to show
        pass
    raise IncompatibleSystem(
        f"equations: expected a function of x ({x.shape[1]},) and u ({u.shape[1]},)"
        f"{f' and p ({len(p)},)' if len(p) else ''} that returns {x.shape[1]} numbers; got {type(error).__name__}: "
        f"{error}. For example\n{EXAMPLE}"
    ) from error


def _equals(function: Callable[..., Any], form: str, x: Array, u: Array, p: Array, found: Array) -> bool:
    """Whether the function in ``form`` gives ``found`` (N, nx)."""
    try:
        with np.errstate(all="ignore"):
            tried = np.stack(_on_arrays(function, form)(tuple(x.T), tuple(u.T), tuple(p[:, None])), axis=1)
    except Exception:  # a function may fail in any way on arrays for which it was not written
        return False
    return np.allclose(tried, found, rtol=1e-9, atol=1e-12)


def _on_arrays(function: Callable[..., Any], form: str) -> Callable[..., Any]:
    """Return the law of tuples of arrays that are broadcast, which calls ``function`` in this ``form``."""
    columns = function
    if form == "columns":
        try:
            columns = array_form(function)
        except InvalidArgument:  # written for whole arrays already, or its source cannot be read
            columns = function

    def law(x: Sequence[Any], u: Sequence[Any], p: Sequence[Any]) -> list[Array]:
        grid = np.broadcast_shapes(*(np.shape(one) for one in (*x, *u, *p)))
        count = math.prod(grid)
        states, controls, values = (_flat(some, grid) for some in (x, u, p))
        if form == "rows":
            found: Any = np.empty((len(x), count))
            vectors, which = np.unique(values, axis=1, return_inverse=True)
            for number, vector in enumerate(vectors.T):
                some = np.ravel(which) == number
                found[:, some] = np.asarray(_called(function, states.T[some], controls.T[some], vector)).T
        elif form == "single":
            each = zip(states.T, controls.T, values.T, strict=True)
            found = np.stack([_of_one(function, *one) for one in each], axis=1)
        else:
            found = _called(columns, states, controls, values)
        if len(found) != len(x):
            raise ValueError(f"{len(found)} numbers for {len(x)} states")
        return [np.broadcast_to(one, count).reshape(grid) for one in found]

    return law


def _flat(values: Sequence[Any], grid: tuple[int, ...]) -> Array:
    """Return the arrays, broadcast to ``grid``, as rows (n, N)."""
    found = np.empty((len(values), math.prod(grid)))
    for row, value in zip(found, values, strict=True):
        row[:] = np.broadcast_to(value, grid).ravel()
    return found
