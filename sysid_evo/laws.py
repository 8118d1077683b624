"""A function of plain numbers for whole arrays: the same lines, element by element.

Kernels are written for one number at a time (`sysid_evo.engine.compiled.language`). Here such a function is read once
more and turned into NumPy: ``a if test else b`` becomes `where`, ``and``, ``or``, ``not`` and chains of comparisons
become their logical functions, ``math`` the functions of NumPy of the same meaning, ``min`` and ``max`` the
element-wise ones, and functions that it calls are turned likewise.
"""

from __future__ import annotations

import ast
import functools
import inspect
import math
import textwrap
from collections.abc import Callable
from types import CodeType, FunctionType, ModuleType, SimpleNamespace
from typing import Any

import numpy as np

from sysid_evo.errors import InvalidArgument

RENAMED = {
    "acos": "arccos", "asin": "arcsin", "atan": "arctan", "atan2": "arctan2", "acosh": "arccosh", "asinh": "arcsinh",
    "atanh": "arctanh", "pow": "power",
}  # fmt: skip
"""Functions of `math` that NumPy calls otherwise."""
LOGICAL = {"and": np.logical_and, "or": np.logical_or, "not": np.logical_not}


@functools.cache
def array_form(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return ``function`` for arrays, broadcast together. Raises `InvalidArgument` for what has no such form."""
    plain = getattr(function, "py_func", function)
    try:
        tree = ast.parse(textwrap.dedent(inspect.getsource(plain))).body[0]
    except (OSError, TypeError, SyntaxError) as error:
        raise InvalidArgument(
            f"function {plain.__qualname__}: its source cannot be read ({error}); write it with def in a file"
        ) from error
    if not isinstance(tree, ast.FunctionDef):
        raise InvalidArgument(f"function {plain.__qualname__}: expected a def, got {type(tree).__name__}")
    tree.decorator_list, tree.returns, tree.name = [], None, plain.__name__
    for argument in tree.args.args:
        argument.annotation = None
    module = ast.Module([_ElementWise(plain.__qualname__).visit(tree)], type_ignores=[])
    code = compile(ast.fix_missing_locations(module), inspect.getfile(plain), "exec")
    body = next(constant for constant in code.co_consts if isinstance(constant, CodeType))
    closure = inspect.getclosurevars(plain)
    scope = {**plain.__globals__, **closure.nonlocals}
    names = {name: _of_arrays(scope[name]) for name in body.co_names if name in scope}
    own = {
        "min": lambda *values: functools.reduce(np.minimum, values),
        "max": lambda *values: functools.reduce(np.maximum, values),
        "_where": np.where,
        "_test": LOGICAL,
    }
    return FunctionType(body, {**own, **names}, plain.__name__)


def _of_arrays(value: Any) -> Any:
    """Return what stands for a name of the function's module."""
    if value is math:
        return SimpleNamespace(**{name: _of_arrays(getattr(math, name)) for name in dir(math) if name[0] != "_"})
    if isinstance(value, ModuleType):
        return value
    if getattr(value, "__module__", "") == "math":
        return getattr(np, RENAMED.get(value.__name__, value.__name__), value)
    if isinstance(getattr(value, "py_func", value), FunctionType):
        return array_form(value)
    return value


class _ElementWise(ast.NodeTransformer):
    """Rewrites what asks whether one number is true."""

    def __init__(self, name: str) -> None:
        self.name = name

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

    def visit_If(self, node: ast.If) -> ast.AST:  # ast's own naming
        raise self._unusable(node, "if", "a if test else b")

    def visit_While(self, node: ast.While) -> ast.AST:  # ast's own naming
        raise self._unusable(node, "while", "for i in range(n)")

    def _unusable(self, node: ast.stmt, word: str, instead: str) -> InvalidArgument:
        return InvalidArgument(
            f"function {self.name}, line {node.lineno} of it: {word!r} chooses for all rows of a batch at once, which "
            f"differ; write {instead!r}"
        )


def _logical(name: str, *arguments: ast.expr) -> ast.expr:
    place = ast.Subscript(ast.Name("_test", ast.Load()), ast.Constant(name), ast.Load())
    return ast.Call(place, list(arguments), [])
