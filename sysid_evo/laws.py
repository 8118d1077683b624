"""Laws written for single numbers, and their conversion to arrays, to the lanes of a kernel, or to symbols.

A law is a plain function of numbers. The numbers of a rollout that it reads or writes are elements of sequences::

    def proportional(theta, memory, observation, raw, parameters, scratch):
        for i in range(int(parameters[0])):
            error = observation[i] if observation[i] > 0.0 else 0.5 * observation[i]
            raw[i] = min(max(theta[i] * error, -1.0), 1.0)

It may use ``for`` and ``if`` over numbers that all rollouts share (``parameters``), ``a if test else b`` over others,
`math`, ``min``, ``max``, ``abs`` and other such functions. `read` converts it to NumPy, `lane_form` to the kernel
language, and the symbols of `sysid_evo.controllers.program` to a program.
"""

from __future__ import annotations

import ast
import functools
import inspect
import math
import textwrap
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from types import CodeType, FunctionType, ModuleType, SimpleNamespace
from typing import Any, Literal

import numpy as np

from sysid_evo.errors import InvalidArgument
from sysid_evo.kernels import LANES, QUARTER, KernelSource, nearest
from sysid_evo.types import Array

RENAMED = {
    "acos": "arccos", "asin": "arcsin", "atan": "arctan", "atan2": "arctan2", "acosh": "arccosh", "asinh": "arcsinh",
    "atanh": "arctanh", "pow": "power",
}  # fmt: skip
"""Functions of `math` that have another name in NumPy."""
SOURCE = "__sysid_evo_source__"
"""The attribute of a function that holds its source, see `keep_source`."""
LOGICAL = {"and": np.logical_and, "or": np.logical_or, "not": np.logical_not}


@dataclass(frozen=True, eq=False)
class LawReading:
    """The meaning of the elements of a law: a choice, minimum and maximum, tests, a function, a named value."""

    where: Callable[[Any, Any, Any], Any]
    least: Callable[[Any, Any], Any]
    most: Callable[[Any, Any], Any]
    logical: Mapping[str, Callable[..., Any]]
    function: Callable[[Any], Any]
    named: Callable[[str, Any], Any]
    branches: bool = False
    """Whether ``if`` is allowed, over numbers that all rollouts share."""


def array_form(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return ``function`` for arrays that are broadcast. Raises `InvalidArgument` if that is impossible."""
    return read(function, ARRAYS)


@functools.cache
def read(function: Callable[..., Any], reading: LawReading) -> Callable[..., Any]:
    """Return ``function`` with the meaning of its elements given by ``reading``. Raises `InvalidArgument`."""
    plain = getattr(function, "py_func", function)
    try:
        tree = ast.parse(source_of(plain)).body[0]
    except (OSError, TypeError, SyntaxError) as error:
        raise InvalidArgument(
            f"function {plain.__qualname__}: its source cannot be read ({error}); write it with def in a file"
        ) from error
    if not isinstance(tree, ast.FunctionDef):
        raise InvalidArgument(f"function {plain.__qualname__}: expected a def, got {type(tree).__name__}")
    tree.decorator_list, tree.returns, tree.name = [], None, plain.__name__
    for argument in tree.args.args:
        argument.annotation = None
    module = ast.Module([_ElementWise(plain.__qualname__, reading.branches).visit(tree)], type_ignores=[])
    code = compile(ast.fix_missing_locations(module), inspect.getfile(plain), "exec")
    body = next(constant for constant in code.co_consts if isinstance(constant, CodeType))
    closure = inspect.getclosurevars(plain)
    scope = {**plain.__globals__, **closure.nonlocals}
    names = {name: _meaning(scope[name], reading) for name in body.co_names if name in scope}
    own = {
        "min": lambda *values: functools.reduce(reading.least, values),
        "max": lambda *values: functools.reduce(reading.most, values),
        "_where": reading.where,
        "_test": reading.logical,
        "_named": reading.named,
    }
    return FunctionType(body, {**own, **names}, plain.__name__)


def keep_source(function: FunctionType) -> None:
    """Attach the source of ``function`` to it, if it can be read, so that a process without its file can read it."""
    with suppress(OSError, TypeError):
        function.__dict__[SOURCE] = inspect.getsource(function)


def source_of(function: Callable[..., Any]) -> str:
    """Return the source of ``function`` without indentation. Raises `OSError` or `TypeError`."""
    return textwrap.dedent(vars(function).get(SOURCE) or inspect.getsource(function))


def _meaning(value: Any, reading: LawReading) -> Any:
    """Return the replacement of a ``value`` from the function's module."""
    if value is math:
        return SimpleNamespace(**{name: _meaning(getattr(math, name), reading) for name in dir(math) if name[0] != "_"})
    if value is nearest or getattr(value, "__module__", "") == "math":
        return reading.function(value)
    if isinstance(value, ModuleType):
        return value
    if isinstance(getattr(value, "py_func", value), FunctionType):
        return read(value, reading)
    return value


def _of_arrays(function: Any) -> Any:
    return np.rint if function is nearest else getattr(np, RENAMED.get(function.__name__, function.__name__), function)


ARRAYS = LawReading(np.where, np.minimum, np.maximum, LOGICAL, _of_arrays, lambda _, value: value)
ROLLOUTS = replace(ARRAYS, branches=True)
"""As `ARRAYS`, for a law with some numbers that all rollouts share."""


def together(values: Sequence[Array | float], grid: tuple[int, ...]) -> Array:
    """Return the elements that a law wrote as one new array (*grid, n)."""
    found = np.empty((*grid, len(values)))
    for i, value in enumerate(values):
        found[..., i] = value
    return found


class _ElementWise(ast.NodeTransformer):
    """Replaces tests of single numbers."""

    def __init__(self, name: str, branches: bool) -> None:
        self.name, self.branches = name, branches

    def visit_IfExp(self, node: ast.IfExp) -> ast.expr:  # ast's own naming
        parts = [self.visit(part) for part in (node.test, node.body, node.orelse)]
        return ast.Call(ast.Name("_where", ast.Load()), parts, [])

    def visit_BoolOp(self, node: ast.BoolOp) -> ast.expr:  # ast's own naming
        name = "and" if isinstance(node.op, ast.And) else "or"
        return functools.reduce(lambda a, b: _logical(name, a, b), [self.visit(value) for value in node.values])

    def visit_UnaryOp(self, node: ast.UnaryOp) -> ast.expr:  # ast's own naming
        inner = self.visit(node.operand)
        return _logical("not", inner) if isinstance(node.op, ast.Not) else ast.UnaryOp(node.op, inner)

    def visit_Compare(self, node: ast.Compare) -> ast.expr:  # ast's own naming
        sides = [self.visit(side) for side in (node.left, *node.comparators)]
        found: ast.expr = ast.Compare(sides[0], node.ops[:1], sides[1:2])
        for left, op, right in zip(sides[1:-1], node.ops[1:], sides[2:], strict=True):
            found = _logical("and", found, ast.Compare(left, [op], [right]))
        return found

    def visit_Assign(self, node: ast.Assign) -> ast.stmt:  # ast's own naming
        value = self.visit(node.value)
        if len(node.targets) == 1 and isinstance(node.targets[0], ast.Name):
            value = ast.Call(ast.Name("_named", ast.Load()), [ast.Constant(node.targets[0].id), value], [])
        return ast.Assign([self.visit(target) for target in node.targets], value)

    def visit_Return(self, node: ast.Return) -> ast.AST:  # ast's own naming
        return self.generic_visit(without_array(node))

    def visit_AugAssign(self, node: ast.AugAssign) -> ast.stmt:  # ast's own naming
        """Replace an augmented assignment by a new array, because others may refer to the old one."""
        return self.visit(_written_out(node))

    def visit_If(self, node: ast.If) -> ast.AST:  # ast's own naming
        if self.branches:
            return self.generic_visit(node)
        raise self._unusable(node, "if", "a if test else b")

    def visit_While(self, node: ast.While) -> ast.AST:  # ast's own naming
        raise self._unusable(node, "while", "for i in range(n)")

    def _unusable(self, node: ast.stmt, word: str, instead: str) -> InvalidArgument:
        return InvalidArgument(
            f"function {self.name}, line {node.lineno} of it: {word!r} applies to a whole batch, whose rows differ; "
            f"write {instead!r}"
        )


def _written_out(node: ast.AugAssign) -> ast.Assign:
    """Return ``x = x + y`` for ``x += y``."""
    before = ast.parse(ast.unparse(node.target), mode="eval").body
    return ast.copy_location(ast.Assign([node.target], ast.BinOp(before, node.op, node.value)), node)


def without_array(node: ast.Return) -> ast.Return:
    """Return ``return a, b`` for ``return [a, b]`` and ``return np.array([a, b])``, else ``node`` itself."""
    value = node.value
    if isinstance(value, ast.Call) and isinstance(value.func, ast.Attribute) and len(value.args) == 1:
        value = value.args[0] if value.func.attr in ("array", "asarray", "stack") else value
    if isinstance(value, (ast.List, ast.Tuple)):
        return ast.copy_location(ast.Return(ast.Tuple(value.elts, ast.Load())), node)
    return node


def _logical(name: str, *arguments: ast.expr) -> ast.expr:
    place = ast.Subscript(ast.Name("_test", ast.Load()), ast.Constant(name), ast.Load())
    return ast.Call(place, list(arguments), [])


@dataclass(frozen=True)
class ScalarLaw(KernelSource):
    """A law as the source of a kernel; its arguments ``rows`` hold an element for each rollout.

    Without rows it is a function of numbers that another law calls. With rows it processes a quarter of the lanes at a
    time, which keeps named values in registers, or with the ``width`` of a row all of them, which is better for few
    named values.
    """

    rows: tuple[str, ...] = ()
    width: Literal["quarter", "row"] = "quarter"

    __hash__ = KernelSource.__hash__


def lane_form(tree: ast.FunctionDef, law: ScalarLaw) -> ast.FunctionDef:
    """Return the definition of ``law`` in the kernel language. Raises `InvalidArgument` if that is impossible."""
    found: ast.FunctionDef = _Lanes(law).visit(tree)
    if law.rows and law.width == "quarter":
        loop = f"for {FIRST} in range(0, {LANES}, {QUARTER}): pass"
        (each,) = ast.parse(loop).body
        assert isinstance(each, ast.For)
        each.body, found.body = found.body, [each]
    return found


FIRST = "first_of_quarter"
CHOICES = {
    ast.Lt: ("where_less", False), ast.LtE: ("where_at_most", False), ast.Gt: ("where_less", True),
    ast.GtE: ("where_at_most", True),
}  # fmt: skip
"""The kernel word for a choice by a comparison, and whether its sides are swapped."""


class _Lanes(ast.NodeTransformer):
    """Rewrites elements of rows and choices."""

    def __init__(self, law: ScalarLaw) -> None:
        self.law, self.end = law, "_quarter" if law.width == "quarter" else ""

    def visit_Name(self, node: ast.Name) -> ast.expr:  # ast's own naming
        if node.id in self.law.rows:
            raise self._unusable(node, node.id, f"{node.id}[i], one element at a time")
        return ast.Name("splat" + self.end, node.ctx) if node.id == "splat" else node

    def visit_Subscript(self, node: ast.Subscript) -> ast.expr:  # ast's own naming
        if self._is_element(node):
            return _call("load" + self.end, *self._place(node))
        return ast.Subscript(self.visit(node.value), self.visit(node.slice), node.ctx)

    def visit_Assign(self, node: ast.Assign) -> ast.stmt:  # ast's own naming
        (target,) = node.targets
        if self._is_element(target):
            return ast.Expr(_call("store", *self._place(target), self.visit(node.value)))
        return ast.Assign([self.visit(target)], self.visit(node.value))

    def visit_AugAssign(self, node: ast.AugAssign) -> ast.stmt:  # ast's own naming
        return self.visit_Assign(_written_out(node))

    def visit_If(self, node: ast.If) -> ast.AST:  # ast's own naming
        if any(isinstance(part, ast.expr) and self._is_element(part) for part in ast.walk(node.test)):
            raise self._unusable(node.test, f"if {ast.unparse(node.test)}", "a if test else b")
        return self.generic_visit(node)

    def visit_Call(self, node: ast.Call) -> ast.AST:  # ast's own naming
        """Replace ``min`` and ``max`` by those of two arguments."""
        called = self.generic_visit(node)
        if isinstance(node.func, ast.Name) and node.func.id in ("min", "max") and len(node.args) > 2:
            return functools.reduce(functools.partial(_call, node.func.id), node.args)
        return called

    def visit_IfExp(self, node: ast.IfExp) -> ast.expr:  # ast's own naming
        test = node.test
        if not isinstance(test, ast.Compare) or len(test.ops) > 1 or type(test.ops[0]) not in CHOICES:
            raise self._unusable(test, ast.unparse(test), "one comparison: < <= > >=")
        word, swapped = CHOICES[type(test.ops[0])]
        sides = [test.left, test.comparators[0]]
        return _call(word, *map(self.visit, [*(reversed(sides) if swapped else sides), node.body, node.orelse]))

    def _is_element(self, node: ast.expr) -> bool:
        return isinstance(node, ast.Subscript) and isinstance(node.value, ast.Name) and node.value.id in self.law.rows

    def _place(self, node: Any) -> tuple[ast.expr, ast.expr]:
        """Return the array and the start of the lanes of an element in it."""
        row = ast.BinOp(self.visit(node.slice), ast.Mult(), ast.Constant(LANES))
        name = ast.Name(node.value.id, ast.Load())
        return name, row if self.law.width == "row" else ast.BinOp(row, ast.Add(), ast.Name(FIRST, ast.Load()))

    def _unusable(self, node: ast.expr, text: str, instead: str) -> InvalidArgument:
        name = self.law.function.__qualname__
        return InvalidArgument(
            f"law {name}, line {node.lineno} of it: {text!r} cannot be compiled for lanes; write {instead}"
        )


def _call(word: str, *arguments: ast.expr) -> ast.expr:
    return ast.Call(ast.Name(word, ast.Load()), list(arguments), [])
