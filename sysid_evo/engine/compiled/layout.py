"""What the numbers at the head of a kernel's parameters mean, said once.

A kernel gets one flat array. Its first numbers have names, the rest is its own::

    HEAD = Layout("nx", "dt")

    def predict(x, u, p, y, scratch):
        nx, dt, weights = int(p[HEAD.nx]), p[HEAD.dt], view(p, HEAD.size)

    parameters = HEAD.pack(weights, nx=3, dt=0.05)

In a kernel function ``HEAD.nx`` is the number 0 and ``HEAD.size`` the number 2.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from sysid_evo.arrays import Array
from sysid_evo.errors import InvalidArgument

CACHE_LINE = 16
"""Numbers of float32 in a cache line: what begins at a multiple of it stays aligned."""


class Layout:
    """The names of the first numbers of a parameter array, in order; ``layout.name`` is where ``name`` stands.

    ``size`` is how many numbers the head takes: as many as there are names, or more to a multiple of ``align``.
    """

    size: int

    def __init__(self, *names: str, align: int = 1) -> None:
        repeated = sorted({name for name in names if names.count(name) > 1 or name == "size"})
        if repeated or align < 1:
            raise InvalidArgument(f"layout: expected different names, none of them 'size', got {', '.join(names)}")
        self.names = names
        self.size = -(-len(names) // align) * align

    def __getattr__(self, name: str) -> int:
        names: tuple[str, ...] = self.__dict__.get("names", ())
        if name not in names:
            raise AttributeError(f"layout: no {name!r}; its names are {', '.join(names)}")
        return names.index(name)

    def pack(self, *rest: Any, **values: float) -> Array:
        """Return the named values in their order, then ``rest``, flat. Raises `InvalidArgument` for other names."""
        if values.keys() != set(self.names):
            raise InvalidArgument(f"layout: expected {', '.join(self.names)}, got {', '.join(values) or 'nothing'}")
        head = np.zeros(self.size)
        head[: len(self.names)] = [values[name] for name in self.names]
        return np.concatenate([head, *(np.ravel(part) for part in rest)]).astype(np.float64)

    def integers(self, **values: int) -> npt.NDArray[np.int64]:
        """Return the named values in their order as whole numbers."""
        return self.pack(**values).astype(np.int64)


def padded(array: Array, align: int = CACHE_LINE) -> Array:
    """Return ``array`` with zeros after it, up to a multiple of ``align`` numbers."""
    return np.pad(array, (0, -len(array) % align))
