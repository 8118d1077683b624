"""Family pysindy: a SINDy object of pysindy with its own library, optimiser and differentiation."""

from __future__ import annotations

import copy
import warnings
from collections.abc import Mapping
from dataclasses import replace
from functools import cached_property
from itertools import product
from typing import Any, ClassVar, Self

import numpy as np

from model_zoo.features import FUNCTIONS, ChannelFunction, Features
from model_zoo.polynomial.libraries import Basis, Fourier, Polynomial, Term, basis_of_terms
from model_zoo.polynomial.model import MAX_EXPONENT, equation, evaluate, predictor_of_rows
from model_zoo.polynomial.optimizers import seeded
from sysid_evo import Dataset, DynamicsModel, register_model
from sysid_evo.errors import InvalidArgument
from sysid_evo.models.dynamics import rk4
from sysid_evo.models.kernels import Predictor, polynomial_predictor, runge_kutta_predictor
from sysid_evo.models.kernels.shells import SeenRow
from sysid_evo.models.learned import Declared, Numbers
from sysid_evo.models.parameters import Limit, at_least
from sysid_evo.progress import Progress
from sysid_evo.registry.objects import kept_object
from sysid_evo.system import System
from sysid_evo.types import Array

POINTS = np.linspace(-2.3, 2.1, 12)
"""Where a custom function is compared with those that have a compiled form."""
POWERS = 6
"""Highest power of one input that a custom function is compared with."""
REFUSED = {
    "SINDyPI": "an implicit equation cannot be stepped",
    "WeakPDELibrary": "the weak form is fitted, not stepped: take the library inside it, or sindy with library=...",
    "PDELibrary": "there are no spatial derivatives in these systems",
    "SINDyPILibrary": "an implicit equation cannot be stepped",
}


@register_model("pysindy")
class PySindy(DynamicsModel):
    """An object of pysindy, ``SINDy`` or ``DiscreteSINDy``, as it is configured (de Silva and others 2020).

    ``model`` is fitted with its own library, optimiser and differentiation to states and controls in their units; an
    angle is a plain number. With ``fitted`` it is used as it is. A `SINDy` is integrated by the Runge-Kutta method with
    controls held, in ``substeps``; pysindy's `simulate` interpolates controls unless they are a function.

    Libraries of polynomials, Fourier terms and common functions of one input, and their sums and products, become
    exponents: such a model has a compiled form and is stored as arrays. Others are evaluated by pysindy and work only
    where the object itself is given.
    """

    knowledge = "dark grey"
    fast_fit = True
    requires = ("pysindy",)
    limits: ClassVar[dict[str, Limit]] = {"substeps": at_least(1)}

    model: Any = None
    fitted: bool = False
    substeps: int = 1
    max_steps: int | None = 100_000

    def fit(self, dataset: Dataset, *, rng: np.random.Generator, progress: Progress | None = None) -> Self:
        import pysindy

        system = dataset.system
        peer = pysindy.SINDy() if self.model is None else copy.deepcopy(kept_object(self.model))
        for part in (peer.optimizer, peer.feature_library):
            if (name := type(part).__name__) in REFUSED:
                raise InvalidArgument(f"pysindy: {name} is not supported: {REFUSED[name]}")
        if not self.fitted:
            runs = dataset.episodes
            held = [np.concatenate([run.controls, run.controls[-1:]]) for run in runs] if system.nu else None
            names = [*system.state_names, *system.control_names]
            try:
                with seeded(int(rng.integers(2**32))):
                    peer.fit([run.states for run in runs], t=system.dt, u=held, feature_names=names)
            except (ValueError, TypeError, np.linalg.LinAlgError) as error:
                raise InvalidArgument(f"pysindy: the fit of {type(peer).__name__} failed: {error}") from error
        elif not hasattr(peer.optimizer, "coef_"):
            raise InvalidArgument(f"pysindy: expected a fitted {type(peer).__name__}; without fitted=True it is fitted")
        if np.ndim(peer.optimizer.coef_) == 1:  # a regressor of scikit-learn, of one state
            peer.optimizer.coef_ = np.atleast_2d(peer.optimizer.coef_)
        self.coefficients_ = np.ascontiguousarray(np.asarray(peer.optimizer.coef_, dtype=np.float64).T)
        self.seen_ = system.nx + int(peer.n_control_features_)
        if self.coefficients_.shape[1] != system.nx or self.seen_ not in (system.nx, system.nx + system.nu):
            raise InvalidArgument(
                f"pysindy: expected an object fitted to {system.nx} states and {system.nu} controls, got "
                f"{self.coefficients_.shape[1]} and {peer.n_control_features_}"
            )
        self.discrete_ = "DiscreteSINDy" in {base.__name__ for base in type(peer).__mro__}
        right = zip(self._left_sides(), peer.equations(precision=4), strict=True)
        self.equations_ = [f"{left} = {terms}" for (left, _), terms in right]
        self._set_basis(peer.feature_library)
        return self

    def _set_basis(self, library: Any) -> None:
        """Store the terms of pysindy's ``library`` as exponents, if they are equal on the training sample."""
        vars(self)["_library"] = library
        for name in ("exponents_", "functions_"):
            self.__dict__.pop(name, None)
        terms = terms_of(library, plain_features(self.system), self.seen_)
        if terms is None:
            return
        basis = basis_of_terms(terms, plain_features(self.system))
        seen, nx = self.training_sample_, self.system.nx
        expected = np.asarray(library.transform(seen[:, : self.seen_]))
        found = self._terms(basis, seen[:, :nx], seen[:, nx:])
        if found.shape == expected.shape and np.allclose(found, expected, rtol=1e-9, atol=1e-12):
            self.exponents_, self.functions_ = basis.exponents, list(basis.functions)

    def learned_arrays(self) -> Mapping[str, Declared]:
        nx, nu, functions = self.system.nx, self.system.nu, len(getattr(self, "functions_", []))
        if self._basis is None and "_library" not in vars(self):
            kept_object(self.model)
        else:
            plain_features(self.system, tuple(getattr(self, "functions_", ())))
        return {
            "coefficients_": ("terms", nx),
            "exponents_": Numbers(
                "terms", nx + nu + functions, whole=True, least=0, most=MAX_EXPONENT, optional=self.model is not None
            ),
            "seen_": Numbers(whole=True, least=nx, most=nx + nu),
        }

    def equations(self) -> list[str]:
        if not hasattr(self, "coefficients_") or self._basis is None:
            return list(getattr(self, "equations_", []))
        features, exponents = plain_features(self.system, self._basis.functions), self._basis.exponents
        pairs = zip(self._left_sides(), self.coefficients_.T, strict=True)
        return [
            equation(left, unit, own, exponents, features.shown_names, features.units) for (left, unit), own in pairs
        ]

    def _left_sides(self) -> list[tuple[str, str]]:
        if self.discrete_:
            return [(f"{state.name}[+1]", state.unit) for state in self.system.states]
        return [(f"rate of {state.name}", f"{state.unit or '1'}/s") for state in self.system.states]

    @property
    def fit_note(self) -> str:
        slow = "" if self._basis else "its library has no compiled form; it is evaluated by pysindy, which is slow"
        empty = (
            "" if self.coefficients_.any() else "all its coefficients are zero: lower the threshold of its optimizer"
        )
        return "; ".join(filter(None, (super().fit_note, "used as it is" if self.fitted else "", empty, slow)))

    def next_state(self, carry: Array, control: Array) -> Array:
        if self.discrete_:
            return self.right_side(carry, control)
        after = carry
        for _ in range(self.substeps):
            after = rk4(lambda state: self.right_side(state, control), after, self.system.dt / self.substeps)
        return after

    def right_side(self, state: Array, control: Array) -> Array:
        """Return the rates (B, nx), or the next states of a discrete model."""
        if self._basis is None:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                seen = np.concatenate([state, control], axis=1)[:, : self.seen_]
                return np.asarray(self._own_library.transform(seen)) @ self.coefficients_
        return self._terms(self._basis, state, control) @ self.coefficients_

    def predictor(self) -> Predictor | None:
        if self._basis is None:
            return None
        nx, features = self.system.nx, plain_features(self.system, self._basis.functions)
        exponents, coefficients = self._basis.exponents, self.coefficients_
        if features.functions:
            rows = [SeenRow(*row, -np.inf, np.inf) for row in features.rows]
            sums = predictor_of_rows(rows, nx, exponents, coefficients)
        else:
            sums = polynomial_predictor(exponents, coefficients, nx, self.system.nu)
        if self.discrete_:
            return sums
        return runge_kutta_predictor(sums, self.system, substeps=self.substeps, n_carry=nx)

    @cached_property
    def _basis(self) -> Basis | None:
        """The terms as exponents; None if pysindy itself evaluates them."""
        if not hasattr(self, "exponents_"):
            return None
        return Basis(tuple(self.functions_), self.exponents_)

    @cached_property
    def _own_library(self) -> Any:
        """The library of the object, fitted to the number of its inputs."""
        library = vars(self).get("_library")
        if library is None:
            library = copy.deepcopy(kept_object(self.model)).feature_library
            library.fit(np.zeros((2, self.seen_)))
        return library

    def _terms(self, basis: Basis, state: Array, control: Array) -> Array:
        return evaluate(plain_features(self.system, basis.functions)(state, control), basis.exponents)


def plain_features(system: System, functions: tuple[str, ...] = ()) -> Features:
    """Return states and controls as pysindy sees them, angles as plain numbers, and ``functions`` of them."""
    states = tuple(replace(state, period=None) for state in system.states)
    return Features(replace(system, states=states), (0, 0), functions)


def terms_of(library: Any, features: Features, seen: int) -> list[Term] | None:
    """Return the terms of pysindy's ``library`` over the first ``seen`` features, in its order; None if unknown."""
    kind, names = type(library).__name__, features.names[:seen]
    inputs = tuple(names)
    if kind == "PolynomialLibrary":
        given: tuple[str, ...] = ("degree", "include_interaction", "interaction_only", "include_bias")
        found = Polynomial(**{name: getattr(library, name) for name in given}, inputs=inputs).terms(features)
    elif kind == "FourierLibrary":
        given = ("n_frequencies", "include_sin", "include_cos")
        found = Fourier(**{name: getattr(library, name) for name in given}, inputs=inputs).terms(features)
    elif kind == "IdentityLibrary":
        found = [(name,) for name in names]
    elif kind == "CustomLibrary":
        functions = [_known(function) for function in library.functions]
        if None in functions:
            return None
        found = [()] if library.include_bias else []
        found += [_of(function, name) for function in functions if function for name in names]
    elif kind in ("ConcatLibrary", "TensoredLibrary"):
        parts = [terms_of(part, features, seen) for part in library.libraries]
        if any(part is None for part in parts):
            return None
        known = [part for part in parts if part is not None]
        if kind == "ConcatLibrary":
            found = [term for part in known for term in part]
        else:
            found = [tuple(sorted(sum(several, ()))) for several in product(*known)]
    else:
        return None
    return found


def _known(function: Any) -> str | int | None:
    """Return the name, or the power, of a custom function of one input that equals it at some points."""
    try:
        with np.errstate(all="ignore"), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = np.asarray(function(POINTS), dtype=np.float64)
    except Exception:  # a function of several inputs, or one that fails in any way
        return None
    for power in range(1, POWERS + 1):
        if found.shape == POINTS.shape and np.allclose(found, POINTS**power, rtol=1e-12):
            return power
    return next((name for name, known in FUNCTIONS.items() if np.allclose(found, known(POINTS), rtol=1e-12)), None)


def _of(function: str | int, name: str) -> Term:
    return (name,) * function if isinstance(function, int) else (ChannelFunction(function, 1.0, name).text,)
