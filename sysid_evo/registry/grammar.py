"""The grammar that names everything that has a name: ``label=NAME(parameter=value, ...)``."""

from __future__ import annotations

import ast
import itertools
import keyword
import re
import sys
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from sysid_evo.errors import InvalidArgument

PIECE = re.compile(r"(?:(?P<label>[A-Za-z_][\w.-]*)\s*=\s*)?(?P<name>[A-Za-z_]\w*)\s*(?P<arguments>\(.*\))?", re.DOTALL)
SHORTHAND = re.compile(r"(?P<name>[A-Za-z_]\w*):(?P<seed>\d{1,18})")
WORDS: dict[str, Any] = {"true": True, "false": False, "none": None}
OPEN, CLOSE, QUOTES = "([{", ")]}", "'\""
STRUCTURE = re.compile(r"""'(?:\\.|[^'\\])*'|"(?:\\.|[^"\\])*"|[][(){}'",]""", re.DOTALL)
"""A quoted text, which may hold escaped quotes; a bracket, a comma, or a quote that is not closed."""
LONGEST = 100_000
"""Characters of a text; the longest that the program writes, a list of candidates, has some thousands."""
DEEPEST = 12
"""Lists, tables and things inside each other; with every thing inside another its text may double for its quotes."""
SHOWN = 200
"""Characters of a text that a message repeats."""


@dataclass(frozen=True)
class Spec:
    """A registered name, the parameters to make it with, and what it is called where several stand side by side.

    The text of a spec is ``NAME(parameter=value, ...)``, before it ``label=`` if it has a label of its own.
    Values are numbers, text (quotes may be left out around a word), true, false, none, lists and tables; a
    parameter that is itself a registered thing is written in the same grammar and handed over as text.
    ``NAME:SEED`` stands for ``NAME(seed=SEED)``.
    """

    name: str
    parameters: Mapping[str, Any] = field(default_factory=dict)
    label: str = ""

    def __post_init__(self) -> None:
        if not self.label:
            object.__setattr__(self, "label", self.name)

    def __hash__(self) -> int:
        return hash(str(self))

    @classmethod
    def parse(cls, text: str) -> Spec:
        """Read one spec. Raises `InvalidArgument` that says what cannot be read."""
        pieces = split_specs(text)
        if len(pieces) != 1:
            raise InvalidArgument(f"expected one NAME(parameter=value, ...), got {_short(text)}")
        return _parse(pieces[0])

    @classmethod
    def parse_many(cls, text: str) -> tuple[Spec, ...]:
        """Read specs separated by commas. Raises `InvalidArgument`, also if two have the same label."""
        return check_labels(tuple(_parse(piece) for piece in split_specs(text)))

    @property
    def text(self) -> str:
        """The spec without its label: what decides what is made."""
        if not self.parameters:
            return self.name
        inside = ", ".join(f"{name}={_written(value)}" for name, value in self.parameters.items())
        return f"{self.name}({inside})"

    def __str__(self) -> str:
        if self.label == self.name or SHORTHAND.fullmatch(self.label):
            return self.text
        return f"{self.label}={self.text}"

    def with_parameters(self, **parameters: Any) -> Spec:
        """Return this spec with further parameters; those it names already keep their values."""
        return Spec(self.name, {**parameters, **self.parameters}, self.label)


def spec_of(given: Spec | str) -> Spec:
    """Return ``given``, its text read."""
    return Spec.parse(given) if isinstance(given, str) else given


def check_labels(specs: tuple[Spec, ...]) -> tuple[Spec, ...]:
    """Return ``specs`` if their labels differ, else raise `InvalidArgument`."""
    labels = Counter(spec.label for spec in specs)
    repeated = min((label for label, count in labels.items() if count > 1), default=None)
    if repeated is not None:
        raise InvalidArgument(
            f"{repeated!r} is given {labels[repeated]} times; give each a label of its own, "
            f"such as a={repeated}, b={repeated}(...)"
        )
    return specs


def split_specs(text: str) -> list[str]:
    """Split at the commas outside brackets and quotes. Raises `InvalidArgument` for empty parts and long texts."""
    if len(text) > LONGEST:
        raise InvalidArgument(
            f"expected NAME(parameter=value, ...) of at most {LONGEST} characters, got {len(text)}: {_short(text)}"
        )
    if any("\ud800" <= character <= "\udfff" for character in text):
        raise InvalidArgument(f"{_short(text)} cannot be read: it holds bytes that are no text in UTF-8")
    cuts, depth = [-1], 0
    for found in STRUCTURE.finditer(text):
        character = found[0]
        if character in OPEN:
            depth += 1
        elif character in CLOSE:
            depth -= 1
        elif character == "," and depth == 0:
            cuts.append(found.start())
        elif character in QUOTES:
            depth = 1
            break
    if depth:
        raise InvalidArgument(
            f"expected NAME(parameter=value, ...), got {_short(text)}: a bracket or quote is not closed"
        )
    stripped = [text[first + 1 : last].strip() for first, last in itertools.pairwise([*cuts, len(text)])]
    if not any(stripped):
        raise InvalidArgument("expected NAME or NAME(parameter=value, ...), got an empty text")
    if not all(stripped):
        raise InvalidArgument(f"expected something before and after every comma, got {_short(text)}")
    return stripped


def _parse(piece: str) -> Spec:
    shorthand = SHORTHAND.fullmatch(piece)
    if shorthand:
        return Spec(shorthand["name"], {"seed": int(shorthand["seed"])}, piece)
    found = PIECE.fullmatch(piece)
    if found is None:
        path = "no such file, and no " if "/" in piece or piece.endswith(".json") else "expected "
        raise InvalidArgument(f"{path}NAME(parameter=value, ...), with label=NAME(...) for a label: {_short(piece)}")
    try:
        call = ast.parse(f"f{found['arguments'] or '()'}", mode="eval").body
    except (SyntaxError, ValueError) as error:
        why = error.msg if isinstance(error, SyntaxError) else error
        raise InvalidArgument(f"{_short(piece)} cannot be read: {why}") from error
    except (RecursionError, MemoryError):  # how Python's parser gives up
        raise _too_deep(piece) from None
    return Spec(found["name"], _arguments(piece, call, 1), found["label"] or "")


def _arguments(piece: str, call: ast.expr, depth: int) -> dict[str, Any]:
    plain = isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and not call.args
    if not isinstance(call, ast.Call) or not plain or any(argument.arg is None for argument in call.keywords):
        raise InvalidArgument(f"{_short(piece)}: expected parameter=value between the brackets, separated by commas")
    found: dict[str, Any] = {}
    for argument in call.keywords:
        assert argument.arg is not None
        if argument.arg in found:
            raise InvalidArgument(f"{_short(piece)}: {argument.arg} is given twice")
        found[argument.arg] = _value(piece, argument.value, depth)
    return found


def _value(piece: str, node: ast.expr, depth: int) -> Any:
    if depth > DEEPEST:
        raise _too_deep(piece)
    if isinstance(node, ast.Name):
        return WORDS.get(node.id.lower(), node.id)
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
        return Spec(node.func.id, _arguments(piece, node, depth + 1)).text
    if isinstance(node, (ast.List, ast.Tuple)):
        return [_value(piece, item, depth + 1) for item in node.elts]
    if isinstance(node, ast.Dict) and all(isinstance(key, (ast.Name, ast.Constant)) for key in node.keys):
        items = zip(node.keys, node.values, strict=True)
        return {str(_key(key)): _value(piece, item, depth + 1) for key, item in items}
    try:
        value = ast.literal_eval(node)
    except (ValueError, TypeError, RecursionError):
        value = ...
    plain = isinstance(value, (bool, int, float, str, type(None)))
    if not plain or (isinstance(value, (int, float)) and not abs(value) <= sys.float_info.max):
        raise InvalidArgument(
            f"{_short(piece)}: {_said(node)} is no value; expected a number, text, true, false, none or a list"
        )
    return value


def _too_deep(piece: str) -> InvalidArgument:
    return InvalidArgument(f"{_short(piece)} cannot be read: expected at most {DEEPEST} brackets inside each other")


def _short(text: str) -> str:
    """Return ``text`` in quotes, its middle left out if it is long."""
    return repr(text if len(text) <= SHOWN else f"{text[: SHOWN // 2]} ... {text[-SHOWN // 2 :]}")


def _said(node: ast.expr) -> str:
    """Return how a value was written, as far as it can be."""
    try:
        return _short(ast.unparse(node))
    except (RecursionError, ValueError):
        return "this value"


def _key(node: ast.expr | None) -> Any:
    return node.id if isinstance(node, ast.Name) else getattr(node, "value", "")


def _written(value: Any) -> str:
    if isinstance(value, str):
        plain = value.isascii() and value.isidentifier() and not keyword.iskeyword(value) and value.lower() not in WORDS
        return value if plain else repr(value)
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key!r}: {_written(item)}" for key, item in value.items()) + "}"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(_written, value)) + "]"
    return {True: "true", False: "false", None: "none"}[value] if isinstance(value, (bool, type(None))) else repr(value)
