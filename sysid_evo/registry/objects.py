"""Objects from Python in specs: a text that names an object by its class and content, and the objects of this process.

A spec is text, so that it can be stored, sent and compared. An object that has no such text, such as a pipeline of
scikit-learn, is named by ``<Python object CLASS DIGEST>``. The digest identifies results; the object itself exists only
in the process that it was given to, and in worker processes, which get it with their cells.
"""

from __future__ import annotations

import copy
import hashlib
import pickle
import re
import sys
from collections.abc import Mapping
from typing import Any

import cloudpickle  # type: ignore[import-untyped]  # it has no types

from sysid_evo.errors import InvalidArgument
from sysid_evo.registry.plugins import source_digest

FORM = re.compile(r"<Python object \w+ [0-9a-f]{16}>")

_objects: dict[str, Any] = {}


def keep_object(thing: Any, content: Any = None) -> str:
    """Return the text that names ``thing`` in a spec; a copy of it is kept in this process.

    ``content`` determines the digest, ``thing`` itself by default. The version of its package is included, or the
    source code of a module without one.
    """
    name = re.sub(r"\W", "_", class_name(thing))
    origin = thing if isinstance(getattr(thing, "__name__", None), str) else type(thing)
    top = sys.modules.get(origin.__module__.partition(".")[0])
    source = getattr(top, "__version__", None) or source_digest(origin)
    digest = hashlib.sha256(repr((origin.__module__, origin.__qualname__, str(source))).encode())
    digest.update(_digest_of(thing if content is None else content).encode())
    text = f"<Python object {name} {digest.hexdigest()[:16]}>"
    if text not in _objects:
        _objects[text] = copy.deepcopy(thing)
    return text


def class_name(thing: Any) -> str:
    """Return the name of a function or class, or that of the class of an object."""
    return str(getattr(thing, "__name__", type(thing).__name__))


def kept_object(value: Any) -> Any:
    """Return the object that the text ``value`` names; anything else is returned unchanged.

    Raises `InvalidArgument` if the object was given to another process.
    """
    if not is_object_text(value):
        return value
    if value not in _objects:
        raise InvalidArgument(
            f"{value} was given in Python, and only its results are stored. Pass it again: "
            "compare(data, models={name: the object}, out=the run folder)"
        )
    return _objects[value]


def is_object_text(value: object) -> bool:
    """Whether ``value`` is a text that names an object from Python."""
    return isinstance(value, str) and FORM.fullmatch(value) is not None


def objects_named(sent: bytes) -> dict[str, Any]:
    """Return the objects of this process that a pickled cell names, by their texts."""
    texts = {found.group().decode() for found in re.finditer(FORM.pattern.encode(), sent)}
    return {text: _objects[text] for text in sorted(texts) if text in _objects}


def receive_objects(objects: Mapping[str, Any]) -> None:
    """Add ``objects`` that the parent process has sent."""
    _objects.update(objects)


def _digest_of(content: Any) -> str:
    import joblib

    try:
        return str(joblib.hash(content))
    except (pickle.PicklingError, AttributeError, TypeError):  # functions of a notebook, lambdas
        return hashlib.sha256(cloudpickle.dumps(content)).hexdigest()
