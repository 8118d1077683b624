"""The grammar of specifications of registered things: ``label=NAME(parameter=value, ...)``."""

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

SPEC = re.compile(r"(?:(?P<label>[A-Za-z_][\w.-]*)\s*=\s*)?(?P<name>[A-Za-z_]\w*)\s*(?P<arguments>\(.*\))?", re.DOTALL)
SHORTHAND = re.compile(r"(?P<name>[A-Za-z_]\w*):(?P<seed>\d{1,18})")
WORDS: dict[str, Any] = {"true": True, "false": False, "none": None}
OPEN, CLOSE, QUOTES = "([{", ")]}", "'\""
STRUCTURE = re.compile(r"""'(?:\\.|[^'\\])*'|"(?:\\.|[^"\\])*"|[][(){}'",]""", re.DOTALL)
"""A quoted text, which may hold escaped quotes; a bracket, a comma, or a quote that is not closed."""
LONGEST = 100_000
"""Largest number of characters; the longest text that the program writes, a list of candidates, has a few thousand."""
DEEPEST = 12
"""Largest depth of nested lists, tables and specs; each level may double the length of the text by its quotes."""
SHOWN = 200
"""Largest number of characters of a text that a message quotes."""


@dataclass(frozen=True)
class Spec:
    """A registered name with parameters, and a label that distinguishes it from others in tables.

    The text of a spec is ``NAME(parameter=value, ...)``, with ``label=`` before it if the label differs from the name.
    Values are numbers, text (quotes around a word are optional), true, false, none, lists and tables. A parameter that
    is itself a registered thing is written in the same grammar and passed on as text. ``NAME:SEED`` is short for
    ``NAME(seed=SEED)``.
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
        """Return the spec in ``text``. Raises `InvalidArgument` with the part that cannot be read."""
        parts = split_specs(text)
        if len(parts) != 1:
            raise InvalidArgument(f"expected one NAME(parameter=value, ...), got {_short(text)}")
        return _parse(parts[0])

    @classmethod
    def parse_many(cls, text: str) -> tuple[Spec, ...]:
        """Return the specs separated by commas. Raises `InvalidArgument`, also if two have the same label."""
        return check_labels(tuple(_parse(part) for part in split_specs(text)))

    @property
    def text(self) -> str:
        """The spec without its label, which determines the thing that is made."""
        if not self.parameters:
            return self.name
        inside = ", ".join(f"{name}={_written(value)}" for name, value in self.parameters.items())
        return f"{self.name}({inside})"

    @property
    def shown(self) -> str:
        """The text with long texts among its parameters left out, for readers."""
        short = {
            name: "..." if isinstance(value, str) and len(value) > SHOWN else value
            for name, value in self.parameters.items()
        }
        return Spec(self.name, short).text

    def __str__(self) -> str:
        if self.label == self.name or SHORTHAND.fullmatch(self.label):
            return self.text
        return f"{self.label}={self.text}"

    def with_parameters(self, **parameters: Any) -> Spec:
        """Return this spec with further parameters; existing ones keep their values."""
        return Spec(self.name, {**parameters, **self.parameters}, self.label)


def spec_of(given: Spec | str) -> Spec:
    """Return ``given`` as a `Spec`."""
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
    """Return the parts between commas outside brackets and quotes. Raises `InvalidArgument` for empty or long texts."""
    if len(text) > LONGEST:
        raise InvalidArgument(
            f"expected NAME(parameter=value, ...) of at most {LONGEST} characters, got {len(text)}: {_short(text)}"
        )
    if any("\ud800" <= character <= "\udfff" for character in text):
        raise InvalidArgument(f"{_short(text)} cannot be read: it contains bytes that are not UTF-8")
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


def _parse(part: str) -> Spec:
    shorthand = SHORTHAND.fullmatch(part)
    if shorthand:
        return Spec(shorthand["name"], {"seed": int(shorthand["seed"])}, part)
    found = SPEC.fullmatch(part)
    if found is None:
        form = "NAME(parameter=value, ...), with label=NAME(...) for a label"
        if "/" in part or part.endswith(".json"):
            raise InvalidArgument(f"{_short(part)}: there is no such file, and a name has the form {form}")
        raise InvalidArgument(f"expected {form}: {_short(part)}")
    try:
        call = ast.parse(f"f{found['arguments'] or '()'}", mode="eval").body
    except (SyntaxError, ValueError) as error:
        why = error.msg if isinstance(error, SyntaxError) else error
        raise InvalidArgument(f"{_short(part)} cannot be read: {why}") from error
    except (RecursionError, MemoryError):  # raised by Python's parser
        raise _too_deep(part) from None
    return Spec(found["name"], _arguments(part, call, 1), found["label"] or "")


def _arguments(part: str, call: ast.expr, depth: int) -> dict[str, Any]:
    plain = isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and not call.args
    if not isinstance(call, ast.Call) or not plain or any(argument.arg is None for argument in call.keywords):
        raise InvalidArgument(f"{_short(part)}: expected parameter=value between the brackets, separated by commas")
    found: dict[str, Any] = {}
    for argument in call.keywords:
        assert argument.arg is not None
        if argument.arg in found:
            raise InvalidArgument(f"{_short(part)}: {argument.arg} is given twice")
        found[argument.arg] = _value(part, argument.value, depth)
    return found


def _value(part: str, node: ast.expr, depth: int) -> Any:
    if depth > DEEPEST:
        raise _too_deep(part)
    if isinstance(node, ast.Name):
        return WORDS.get(node.id.lower(), node.id)
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
        return Spec(node.func.id, _arguments(part, node, depth + 1)).text
    if isinstance(node, (ast.List, ast.Tuple)):
        return [_value(part, item, depth + 1) for item in node.elts]
    if isinstance(node, ast.Dict) and all(isinstance(key, (ast.Name, ast.Constant)) for key in node.keys):
        keys = (key.id if isinstance(key, ast.Name) else getattr(key, "value", "") for key in node.keys)
        return {str(key): _value(part, item, depth + 1) for key, item in zip(keys, node.values, strict=True)}
    try:
        value = ast.literal_eval(node)
    except (ValueError, TypeError, RecursionError):
        value = ...
    plain = isinstance(value, (bool, int, float, str, type(None)))
    if not plain or (isinstance(value, (int, float)) and not abs(value) <= sys.float_info.max):
        raise InvalidArgument(
            f"{_short(part)}: {_source(node)} is no value; expected a number, text, true, false, none or a list"
        )
    return value


def _too_deep(part: str) -> InvalidArgument:
    return InvalidArgument(f"{_short(part)} cannot be read: expected at most {DEEPEST} nested brackets")


def _short(text: str) -> str:
    """Return ``text`` in quotes; the middle of a long text is left out."""
    return repr(text if len(text) <= SHOWN else f"{text[: SHOWN // 2]} ... {text[-SHOWN // 2 :]}")


def _source(node: ast.expr) -> str:
    """Return the source text of a value, if Python can write it."""
    try:
        return _short(ast.unparse(node))
    except (RecursionError, ValueError):
        return "this value"


def _written(value: Any) -> str:
    if isinstance(value, str):
        plain = value.isascii() and value.isidentifier() and not keyword.iskeyword(value) and value.lower() not in WORDS
        return value if plain else repr(value)
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key!r}: {_written(item)}" for key, item in value.items()) + "}"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(_written, value)) + "]"
    return {True: "true", False: "false", None: "none"}[value] if isinstance(value, (bool, type(None))) else repr(value)
