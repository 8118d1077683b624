"""A control law as a short program of vector statements, which is exported to several languages.

A program is a list of statements, ``name = expression``. Expressions work element by element on vectors of one
length (a vector of one element is broadcast), except for `Dot`, a matrix times a vector, and `Take`, some elements
of a vector::

    seen = variable("observation", 5)
    hidden = Statement("hidden", apply("tanh", dot("W_IN", weights, seen)))
    raw = Statement("raw", apply("tanh", dot("W_OUT", more, hidden.value)))
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias, cast

import numpy as np

from sysid_evo.errors import InvalidArgument
from sysid_evo.kernels import nearest
from sysid_evo.laws import LawReading
from sysid_evo.types import Array

Vectors: TypeAlias = Mapping[str, Array]


@dataclass(frozen=True, eq=False)
class Expression:
    """An expression of ``size`` elements; ``+ - * /`` combine two, and comparisons are tests of a choice."""

    size: int

    def __add__(self, other: Operand) -> Expression:
        return _binary("+", self, other)

    def __radd__(self, other: Operand) -> Expression:
        return _binary("+", other, self)

    def __sub__(self, other: Operand) -> Expression:
        return _binary("-", self, other)

    def __rsub__(self, other: Operand) -> Expression:
        return _binary("-", other, self)

    def __mul__(self, other: Operand) -> Expression:
        return _binary("*", self, other)

    def __rmul__(self, other: Operand) -> Expression:
        return _binary("*", other, self)

    def __truediv__(self, other: Operand) -> Expression:
        return _binary("/", self, other)

    def __rtruediv__(self, other: Operand) -> Expression:
        return _binary("/", other, self)

    def __neg__(self) -> Expression:
        return _binary("-", 0.0, self)

    def __abs__(self) -> Expression:
        return apply("abs", self)

    def __gt__(self, other: Operand) -> Relation:
        return Relation(">", self, number(other))

    def __ge__(self, other: Operand) -> Relation:
        return Relation(">=", self, number(other))

    def __lt__(self, other: Operand) -> Relation:
        return Relation(">", number(other), self)

    def __le__(self, other: Operand) -> Relation:
        return Relation(">=", number(other), self)


Operand: TypeAlias = Expression | float


@dataclass(frozen=True, eq=False)
class Relation:
    """Whether left ``>`` (or ``>=``) right."""

    operator: str
    left: Expression
    right: Expression

    def __bool__(self) -> bool:
        raise InvalidArgument("program: a test of an observation must be written as 'a if test else b', not as 'if'")


@dataclass(frozen=True, eq=False)
class NamedValue(Expression):
    """A value with a name, which becomes a statement."""

    name: str
    of: Expression


@dataclass(frozen=True, eq=False)
class Joined(Expression):
    """A vector made of ``parts`` of one element each; only used as a whole statement."""

    parts: tuple[Expression, ...]


@dataclass(frozen=True, eq=False)
class Number(Expression):
    """A number."""

    value: float


@dataclass(frozen=True, eq=False)
class Variable(Expression):
    """An input, a vector that is remembered, or the result of an earlier statement."""

    name: str
    remembered: bool = False


@dataclass(frozen=True, eq=False)
class ConstantVector(Expression):
    """A vector of constants with a name."""

    name: str
    values: Array


@dataclass(frozen=True, eq=False)
class Dot(Expression):
    """A matrix of constants with a name, (size, of.size), times a vector."""

    name: str
    matrix: Array
    of: Variable


@dataclass(frozen=True, eq=False)
class Take(Expression):
    """The elements of a vector at ``places``."""

    name: str
    places: tuple[int, ...]
    of: Variable


@dataclass(frozen=True, eq=False)
class Binary(Expression):
    """Two vectors, element by element: ``+ - * / min max``."""

    operator: str
    left: Expression
    right: Expression


@dataclass(frozen=True, eq=False)
class Unary(Expression):
    """A function of each element: one of `FUNCTIONS`."""

    function: str
    of: Expression


@dataclass(frozen=True, eq=False)
class Choice(Expression):
    """``yes`` where left ``>`` (or ``>=``) right, else ``no``."""

    operator: str
    left: Expression
    right: Expression
    yes: Expression
    no: Expression


FUNCTIONS: dict[str, Callable[[Any], Any]] = {
    "tanh": np.tanh, "abs": np.abs, "round": np.rint, "sqrt": np.sqrt, "sin": np.sin,
}  # fmt: skip
OPERATORS: dict[str, Callable[[Any, Any], Any]] = {
    "+": np.add, "-": np.subtract, "*": np.multiply, "/": np.divide, "min": np.minimum, "max": np.maximum,
    ">": np.greater, ">=": np.greater_equal,
}  # fmt: skip


@dataclass(frozen=True)
class Statement:
    """``name = expression``, with a comment."""

    name: str
    expression: Expression
    remark: str = ""

    @property
    def value(self) -> Variable:
        """The result, for later statements."""
        return Variable(self.expression.size, self.name)


@dataclass(frozen=True)
class Program:
    """Statements in order; the ``result`` is the value of one of them.

    ``remembered`` maps each vector of the memory, zeros at first, to the statement whose value it takes for the next
    sample. The only input is called `OBSERVATION`.
    """

    statements: tuple[Statement, ...]
    result: Variable
    remembered: Mapping[str, Variable] = field(default_factory=dict)

    def begin(self) -> dict[str, Array]:
        """Return the memory before the first sample."""
        return {name: np.zeros(value.size) for name, value in self.remembered.items()}

    def run(self, observation: Array, memory: Vectors) -> tuple[Array, dict[str, Array]]:
        """Return the result for one observation (n,), and the memory after it, in the precision of the input."""
        known: dict[str, Array] = {OBSERVATION: observation}
        for statement in self.statements:
            value = _value(statement.expression, known, memory, observation.dtype)
            known[statement.name] = np.broadcast_to(value, (statement.expression.size,))
        return known[self.result.name], {name: known[value.name] for name, value in self.remembered.items()}

    def constants(self) -> dict[str, Array]:
        """Return every table of numbers by its name, in order: vectors, matrices, and places as whole numbers."""
        found: dict[str, Array] = {}
        for statement in self.statements:
            for part in parts_of(statement.expression):
                if isinstance(part, ConstantVector):
                    found[part.name] = part.values
                elif isinstance(part, Dot):
                    found[part.name] = part.matrix
                elif isinstance(part, Take) and part.size > 1:
                    found[part.name] = np.array(part.places)
        return found


OBSERVATION = "observation"


def observation(n: int) -> Variable:
    """Return the input of a program, (n,)."""
    return Variable(n, OBSERVATION)


def remembered(name: str, n: int) -> Variable:
    """Return the vector ``name`` of the memory, (n,)."""
    return Variable(n, name, remembered=True)


def constant(name: str, values: Any) -> ConstantVector:
    """Return a vector of constants."""
    numbers = np.asarray(values, dtype=np.float64)
    return ConstantVector(len(numbers), name, numbers)


def dot(name: str, matrix: Array, of: Variable) -> Dot:
    """Return ``matrix`` (n_out, n_in) times a vector."""
    return Dot(len(matrix), name, np.asarray(matrix, dtype=np.float64), of)


def take(name: str, of: Variable, *places: int) -> Take:
    """Return the elements of a vector at ``places``."""
    return Take(len(places), name, places, of)


def limited(of: Expression) -> Expression:
    """Return ``of`` within [-1, 1]."""
    return Binary(of.size, "min", Binary(of.size, "max", of, number(-1.0)), number(1.0))


def number(value: Operand) -> Expression:
    """Return a number as an expression."""
    return value if isinstance(value, Expression) else Number(1, float(value))


def choose(left: Expression, operator: str, right: Operand, yes: Operand, no: Operand) -> Choice:
    """Return ``yes`` where ``left operator right``, else ``no``."""
    sides = (left, number(right), number(yes), number(no))
    return Choice(max(side.size for side in sides), operator, *sides)


def apply(function: str, of: Expression) -> Unary:
    """Return one of `FUNCTIONS` of ``of``."""
    return Unary(of.size, function, of)


def _binary(operator: str, left: Operand, right: Operand) -> Expression:
    a, b = number(left), number(right)
    if operator == "*" and any(isinstance(side, Number) and side.value == 0.0 for side in (a, b)):
        return number(0.0)
    if operator in "+-" and isinstance(b, Number) and b.value == 0.0:
        return a
    return Binary(max(a.size, b.size), operator, a, b)


def parts_of(expression: Expression) -> Iterator[Expression]:
    """Yield ``expression`` and all its parts."""
    yield expression
    for name in ("left", "right", "yes", "no", "of"):
        part = getattr(expression, name, None)
        if isinstance(part, Expression):
            yield from parts_of(part)
    for part in expression.parts if isinstance(expression, Joined) else ():
        yield from parts_of(part)


def _value(e: Expression, known: Vectors, memory: Vectors, real: Any) -> Any:
    """Return the value of an expression in the precision ``real``."""

    def value(part: Expression) -> Any:
        return _value(part, known, memory, real)

    match e:
        case Number():
            return np.asarray(e.value, dtype=real)
        case Variable():
            return memory[e.name].astype(real) if e.remembered else known[e.name]
        case ConstantVector():
            return e.values.astype(real)
        case Dot():
            return e.matrix.astype(real) @ value(e.of)
        case Take():
            return value(e.of)[list(e.places)]
        case Unary():
            return FUNCTIONS[e.function](value(e.of))
        case Binary():
            return OPERATORS[e.operator](value(e.left), value(e.right))
        case Choice():
            return np.where(OPERATORS[e.operator](value(e.left), value(e.right)), value(e.yes), value(e.no))
        case Joined():
            return np.hstack([value(part) for part in e.parts])
        case _:
            raise TypeError(f"program: expected an expression, got {type(e).__name__}")


def elements(of: Variable) -> list[Operand]:
    """Return the elements of a vector."""
    return [take(f"{of.name.upper()}_{place}", of, place) for place in range(of.size)]


def program_of(result: Sequence[Operand], memory: Mapping[str, Sequence[Operand]]) -> Program:
    """Return the program that computes ``result`` and the new ``memory`` by name, from the values of a law."""
    writer = _Statements()
    raw = writer.joined("raw", result)
    after = {name: writer.joined(f"{name}_after", values) for name, values in memory.items()}
    return Program(tuple(writer.done), raw, after)


class _Statements:
    """Writes every named value as a statement, once, after the statements that it depends on."""

    def __init__(self) -> None:
        self.done: list[Statement] = []
        self.known: dict[NamedValue, Variable] = {}
        self.count: dict[str, int] = {}

    def joined(self, name: str, values: Sequence[Operand]) -> Variable:
        parts = tuple(self.plain(number(value)) for value in values)
        return self.statement(name, parts[0] if len(parts) == 1 else Joined(len(parts), parts))

    def statement(self, name: str, expression: Expression) -> Variable:
        self.count[name] = self.count.get(name, 0) + 1
        whole = name if self.count[name] == 1 else f"{name}_{self.count[name]}"
        self.done.append(Statement(whole, expression))
        return self.done[-1].value

    def plain(self, e: Expression) -> Expression:
        """Return ``e`` with named values replaced by variables."""
        if isinstance(e, NamedValue):
            if e not in self.known:
                self.known[e] = self.statement(e.name, self.plain(e.of))
            return self.known[e]
        inner: Mapping[str, Any] = {
            key: self.plain(part) for key, part in vars(e).items() if isinstance(part, Expression)
        }
        return replace(e, **inner) if inner else e


def _chosen(test: Any, yes: Operand, no: Operand) -> Operand:
    if not isinstance(test, Relation):
        return yes if test else no
    return choose(test.left, test.operator, test.right, yes, no)


def _extreme(operator: str, of_numbers: Callable[[Any, Any], Any]) -> Callable[[Operand, Operand], Operand]:
    def extreme(a: Operand, b: Operand) -> Operand:
        if isinstance(a, Expression) or isinstance(b, Expression):
            return _binary(operator, a, b)
        return cast("float", of_numbers(a, b))

    return extreme


def _function(function: Any) -> Callable[..., Operand]:
    """Return ``function``, which for an expression is one of `FUNCTIONS`."""
    name = "round" if function is nearest else function.__name__

    def applied(*of: Operand) -> Operand:
        if not any(isinstance(one, Expression) for one in of):
            return cast("float", function(*of))
        (one,) = of
        if name not in FUNCTIONS:
            raise InvalidArgument(f"program: {name} of an observation is not supported, only {', '.join(FUNCTIONS)}")
        return apply(name, number(one))

    return applied


def _named(name: str, value: Any) -> Any:
    """Return ``value`` as a `NamedValue`, unless it is a number, a variable or an element of one."""
    if not isinstance(value, Expression) or isinstance(value, Number | Variable | Take | NamedValue):
        return value
    return NamedValue(value.size, name, value)


SYMBOLS = LawReading(_chosen, _extreme("min", min), _extreme("max", max), {}, _function, _named, branches=True)
"""Reads a law with expressions: numbers are computed, everything else becomes an expression."""
