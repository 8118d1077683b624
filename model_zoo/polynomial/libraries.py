"""Candidate terms named as in pysindy: libraries, their sums and products, the weak form.

A library is a text: ``polynomial(degree=2)``, ``fourier(n_frequencies=2)``, ``custom(functions=[tanh, x*abs(x)])``,
``identity``. A sum ``a + b`` has the terms of both, a product ``a * b`` all products of one term of each.
``WeakPDELibrary(function_library=...)`` selects the weak form. ``inputs=[speed, drive]`` restricts a library to some
inputs. pysindy's class names and arguments are accepted as well.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations, combinations_with_replacement
from typing import Any, Protocol, TypeAlias

import numpy as np
from scipy.sparse import csr_array

from model_zoo.features import FUNCTIONS, ChannelFunction, Features
from sysid_evo.angles import TURN
from sysid_evo.errors import InvalidArgument, InvalidData
from sysid_evo.registry.grammar import Spec
from sysid_evo.types import IntArray

Term: TypeAlias = tuple[str, ...]
"""The factors of one candidate term, sorted: names of features, or functions as `ChannelFunction.text`."""


class TermLibrary(Protocol):
    """A library of candidate terms."""

    def terms(self, features: Features) -> list[Term]:
        """Return the candidate terms over ``features``, in the order of pysindy's library."""
        ...


def selected(names: tuple[str, ...], features: Features) -> list[str]:
    """Return all features, or those of the channels or features called ``names``. Raises `InvalidArgument`."""
    system = features.system
    periodic = [n for n, c in zip(system.state_names, system.states, strict=True) if c.period is not None]
    owners: dict[str, set[str]] = {}
    for name in features.names:
        channel = re.sub(r"\[-\d+\]$", "", name)
        owners[name] = {name, channel, *(p for p in periodic if channel in (f"sin {p}", f"cos {p}"))}
    known = set().union(*owners.values())
    unknown = [name for name in names if name not in known]
    if unknown:
        raise InvalidArgument(f"library: expected inputs out of {', '.join(sorted(known))}, got {unknown[0]!r}")
    return [name for name in features.names if not names or owners[name] & set(names)]


@dataclass(frozen=True)
class Polynomial:
    """pysindy's PolynomialLibrary."""

    degree: int = 2
    include_interaction: bool = True
    interaction_only: bool = False
    include_bias: bool = True
    inputs: tuple[str, ...] = ()

    def terms(self, features: Features) -> list[Term]:
        seen, found = selected(self.inputs, features), list[Term]([()] if self.include_bias else [])
        for order in range(1, self.degree + 1):
            chosen = combinations if self.interaction_only else combinations_with_replacement
            if self.include_interaction:
                found += [tuple(sorted(factors)) for factors in chosen(seen, order)]
            else:
                found += [(name,) * order for name in seen]
        return found


@dataclass(frozen=True)
class Fourier:
    """pysindy's FourierLibrary; periodic states use the harmonics of their own period."""

    n_frequencies: int = 1
    include_sin: bool = True
    include_cos: bool = True
    inputs: tuple[str, ...] = ()

    def terms(self, features: Features) -> list[Term]:
        seen, system = selected(self.inputs, features), features.system
        periods = {name: system.periods[i] for i, name in enumerate(system.state_names) if i in system.periods}
        inputs: dict[str, float] = {}
        for name in seen:
            angle = re.sub(r"^(sin|cos) ", "", name)
            period = periods.get(re.sub(r"\[-\d+\]$", "", angle))
            if period is not None and angle != name:
                inputs[angle] = TURN / period
            elif name in features.plain_names:
                inputs[name] = 1.0
        wanted = [name for name, there in (("sin", self.include_sin), ("cos", self.include_cos)) if there]
        found: list[Term] = []
        for frequency in range(1, self.n_frequencies + 1):
            for name, factor in inputs.items():
                for function in wanted:
                    already = f"{function} {name}"
                    known = frequency == 1 and already in features.plain_names
                    found.append((already if known else ChannelFunction(function, frequency * factor, name).text,))
        return found


@dataclass(frozen=True)
class Custom:
    """pysindy's CustomLibrary of functions of one input, from `FUNCTIONS`, optionally of a multiple: sin(2*x)."""

    functions: tuple[str, ...] = ()
    include_bias: bool = False
    inputs: tuple[str, ...] = ()

    def terms(self, features: Features) -> list[Term]:
        raw = set(features.input_names)
        seen = [name for name in selected(self.inputs, features) if name in raw]
        found: list[Term] = [()] if self.include_bias else []
        for function, factor in map(of_x, self.functions):
            found += [(ChannelFunction(function, factor, name).text,) for name in seen]
        return found


OF_X = re.compile(r"(?P<function>\w+)(?:\((?:(?P<factor>[-+.\deE]+)\s*\*\s*)?x\))?")
ALIASES = {"x*abs(x)": "x_abs", "abs(x)*x": "x_abs", "sqrt(abs(x))": "sqrt_abs"}


def of_x(text: str) -> tuple[str, float]:
    """Return the function and the factor of ``tanh``, ``sin(2*x)`` or ``x*abs(x)``."""
    plain = re.sub(r"\s+", "", text)
    found = OF_X.fullmatch(ALIASES.get(plain, plain))
    if found is None or found["function"] not in FUNCTIONS:
        raise InvalidArgument(
            f"library: expected functions out of {', '.join(FUNCTIONS)}, such as tanh, sin(2*x) or x*abs(x); "
            f"got {text!r}"
        )
    return found["function"], 1.0 if found["factor"] is None else float(found["factor"])


@dataclass(frozen=True)
class Sum:
    """pysindy's ConcatLibrary: the terms of all ``parts``, each once."""

    parts: tuple[TermLibrary, ...]

    def terms(self, features: Features) -> list[Term]:
        return list(dict.fromkeys(term for part in self.parts for term in part.terms(features)))


@dataclass(frozen=True)
class Product:
    """pysindy's TensoredLibrary: every product of one term of each of ``parts``."""

    parts: tuple[TermLibrary, ...]

    def terms(self, features: Features) -> list[Term]:
        found: list[Term] = [()]
        for part in self.parts:
            found = [tuple(sorted(left + right)) for left in found for right in part.terms(features)]
        return list(dict.fromkeys(found))


@dataclass(frozen=True)
class ParsedLibrary:
    """The content of a text: candidate terms, and the weak form if requested."""

    terms: TermLibrary
    weak: WeakForm | None = None


@dataclass(frozen=True)
class Basis:
    """Terms as exponents (T, n) of the features followed by further ``functions`` of (carry, control)."""

    functions: tuple[str, ...]
    exponents: IntArray


@lru_cache(maxsize=256)
def basis_of(text: str, features: Features) -> Basis:
    """Return the terms of the library ``text`` over ``features``."""
    return basis_of_terms(read_library(text).terms.terms(features), features)


def basis_of_terms(terms: Sequence[Term], features: Features) -> Basis:
    """Return ``terms`` over ``features`` as exponents."""
    further = {name: ChannelFunction.read(name) for term in terms for name in term if name not in features.names}
    functions = [function for function in further.values() if function is not None]
    place = {name: i for i, name in enumerate([*features.names, *further])}
    exponents = np.zeros((len(terms), len(place)), dtype=np.int64)
    for row, term in zip(exponents, terms, strict=True):
        for factor in term:
            row[place[factor]] += 1
    return Basis(tuple(function.text for function in functions), exponents)


EXAMPLE = "expected NAME(parameter=value, ...), or several joined by + and *, such as 'polynomial(degree=2) + fourier'"
Kind: TypeAlias = type[Polynomial] | type[Fourier] | type[Custom]
KINDS: Mapping[str, Kind] = {
    "polynomial": Polynomial,
    "fourier": Fourier,
    "custom": Custom,
}
REFUSED: Mapping[str, str] = {
    "pde": "there are no spatial derivatives in these systems",
    "sindypi": "an implicit equation cannot be stepped",
    "parameterized": "write the product of two libraries with inputs=[...] instead",
    "generalized": "write sums and products of libraries with inputs=[...] instead",
}


@lru_cache(maxsize=256)
def read_library(text: str) -> ParsedLibrary:
    """Return the library described by ``text``. Raises `InvalidArgument` with the expected form."""
    try:
        return _read(text, ast.parse(text.strip(), mode="eval").body)
    except SyntaxError as error:
        raise InvalidArgument(f"library: {text!r} cannot be read: {error.msg}; {EXAMPLE}") from error
    except (RecursionError, MemoryError):  # raised by the parser or by the walk over its result
        raise InvalidArgument(f"library: {text[:80]!r} ... is nested too deep; {EXAMPLE}") from None


def _read(text: str, node: ast.expr) -> ParsedLibrary:
    if isinstance(node, ast.BinOp) and isinstance(node.op, (ast.Add, ast.Mult)):
        sides = (_read(text, node.left), _read(text, node.right))
        if any(side.weak is not None for side in sides):
            raise InvalidArgument(f"library: the weak form must enclose the whole library, got {text!r}")
        join: Callable[[tuple[TermLibrary, ...]], TermLibrary] = Sum if isinstance(node.op, ast.Add) else Product
        return ParsedLibrary(join((sides[0].terms, sides[1].terms)))
    if not isinstance(node, (ast.Call, ast.Name)):
        raise InvalidArgument(f"library: {text!r}: {EXAMPLE}")
    spec = Spec.parse(ast.unparse(node))
    name = re.sub(r"library$", "", spec.name.lower())
    if name in ("weakpde", "weak"):
        return _weak(spec)
    if name == "identity":
        return ParsedLibrary(_made(spec, Polynomial, {"degree": 1, "include_bias": False}))
    if name in ("concat", "tensored"):
        return ParsedLibrary((Sum if name == "concat" else Product)(_parts(spec)))
    if name in REFUSED:
        raise InvalidArgument(f"library: {spec.name} is not supported: {REFUSED[name]}")
    if name not in KINDS:
        known = ", ".join([*KINDS, "identity", "WeakPDELibrary"])
        raise InvalidArgument(f"library: expected one of {known}, or a sum or product of these, got {spec.name!r}")
    return ParsedLibrary(_made(spec, KINDS[name], {}))


def _parts(spec: Spec) -> tuple[TermLibrary, ...]:
    parts = spec.parameters.get("libraries")
    if not isinstance(parts, list) or set(spec.parameters) != {"libraries"}:
        raise InvalidArgument(f"library: expected {spec.name}(libraries=[...]), got {spec.text!r}")
    return tuple(read_library(str(part)).terms for part in parts)


def _weak(spec: Spec) -> ParsedLibrary:
    given = dict(spec.parameters)
    inside = read_library(str(given.pop("function_library", "polynomial(degree=2)")))
    weak = _checked(spec, WeakForm, given)
    if weak.H_xt <= 0 or weak.p < 1 or (weak.K is not None and weak.K < 1) or inside.weak is not None:
        raise InvalidArgument(f"library: expected H_xt > 0 s, p >= 1 and K >= 1 of {spec.name}, got {spec.text!r}")
    return ParsedLibrary(inside.terms, weak)


def _made(spec: Spec, kind: Kind, fixed: Mapping[str, Any]) -> TermLibrary:
    given = dict(spec.parameters)
    if "inputs" in given:
        given["inputs"] = _texts(spec, "inputs", given["inputs"])
    if kind is Custom:
        functions = given.pop("functions", given.pop("library_functions", None))
        given["functions"] = _texts(spec, "functions", functions)
        for text in given["functions"]:
            of_x(text)
    made = _checked(spec, kind, {**fixed, **given})
    least = made.degree if isinstance(made, Polynomial) else made.n_frequencies if isinstance(made, Fourier) else 1
    nothing = isinstance(made, Fourier) and not (made.include_sin or made.include_cos)
    if least < (0 if isinstance(made, Polynomial) else 1) or nothing:
        raise InvalidArgument(f"library: {spec.text!r} has no terms")
    return made


def _texts(spec: Spec, name: str, values: Any) -> tuple[str, ...]:
    if not isinstance(values, list) or not values or not all(isinstance(value, str) for value in values):
        raise InvalidArgument(f"library: {spec.name}: expected {name}=[NAME, ...], got {values!r}")
    return tuple(values)


def _checked(spec: Spec, kind: type[Any], given: Mapping[str, Any]) -> Any:
    """Return ``kind`` made with the given arguments, after a check of their types. Raises `InvalidArgument`."""
    defaults = kind()
    for name, value in given.items():
        if name not in defaults.__dataclass_fields__:
            known = ", ".join(defaults.__dataclass_fields__)
            raise InvalidArgument(f"library: {spec.name} has no parameter {name!r}; it has {known}")
        expected = getattr(defaults, name)
        right = isinstance(value, type(expected)) or (isinstance(expected, float) and type(value) is int)
        right = right or (expected is None and (value is None or type(value) is int))
        if not right or (isinstance(value, bool) and not isinstance(expected, bool)):
            raise InvalidArgument(f"library: {spec.name}: expected {name} as in {name}={expected!r}, got {value!r}")
    return kind(**given)


@dataclass(frozen=True)
class WeakForm:
    """Parameters of the weak form: windows of half width ``H_xt`` s, test functions (1 - s^2)^``p``.

    ``K`` windows, spread evenly over the data; None for one every quarter of a window.
    """

    H_xt: float = 0.5
    p: int = 4
    K: int | None = None


def testing_functions(sample: IntArray, dt: float, weak: WeakForm) -> csr_array:
    """Return the weights (M, N) with which M test functions sum N steps, each of norm 1.

    With phi(s) = (1 - s^2)^p on a window, sum phi_k (x_{k+1} - x_k) = -sum (phi_k - phi_{k-1}) x_k: the difference
    moves from the noisy states to the smooth phi (summation by parts; Messenger and Bortz 2021, and pysindy's
    WeakPDELibrary), with controls held over every step. ``sample`` (N,) numbers the steps: those of a window are
    consecutive. Raises `InvalidData` if there is no such window.
    """
    width = max(2, 2 * round(weak.H_xt / dt))
    rises = np.diff(sample) == 1
    unbroken = np.concatenate([[0], np.cumsum(~rises)])
    starts = np.arange(len(sample) - width + 1)
    starts = starts[unbroken[starts + width - 1] == unbroken[starts]] if len(starts) > 0 else starts
    if not len(starts):
        raise InvalidData(f"weak form: there are no {width} consecutive steps; use H_xt below {weak.H_xt:g} s")
    count = len(starts) if weak.K is None else min(weak.K, len(starts))
    step = max(1, width // 4)
    chosen = starts[::step] if weak.K is None else starts[np.linspace(0, len(starts) - 1, count).astype(np.int64)]
    s = (np.arange(width) + 0.5) * 2.0 / width - 1.0
    phi = (1.0 - s**2) ** weak.p
    phi /= np.linalg.norm(phi)
    rows = np.repeat(np.arange(len(chosen)), width)
    columns = (chosen[:, None] + np.arange(width)).ravel()
    return csr_array((np.tile(phi, len(chosen)), (rows, columns)), shape=(len(chosen), len(sample)))
