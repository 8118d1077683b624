"""The kernel language: functions for compiled code, and the records that contain kernels.

**Lanes.** Compiled code runs 64 rollouts at once. Every quantity is an array of rows of 64 numbers, one for each
rollout, its *lane*: number i of lane l is at ``i * LANES + l``. A kernel is a plain Python function over one such
block. Its innermost loop is over the lanes, and the compiler turns that loop into vector instructions, eight or sixteen
lanes at a time::

    def decay(carry, control, noise, parameters, scratch):
        for row in range(3):
            here = view(carry, row * LANES)
            for lane in range(LANES):
                here[lane] *= parameters[row]

For this to work:

- The innermost loop has no branches that differ between lanes: write ``a if test else b``, ``min``, ``max``.
- ``view(array, n)`` is the array from element n on. A slice would count references in the loop, and an index
  ``start + lane`` would be tested for its sign; both prevent vectorisation.
- A sum over many rows is kept in registers with ``load``, ``splat`` and ``store``, which move a whole row;
  ``load_quarter`` and ``splat_quarter`` make rows of sixteen. They also speed up short operations on several arrays,
  because a loop over lanes first tests whether its arrays overlap.
- For a search, ``lowest`` and ``lane_of_lowest`` reduce a row, ``pick`` returns one lane of it, and ``lanes_less``
  marks lanes as the bits of an integer, whose lowest set bit is ``first_lane``.
- Real numbers are written with a point: ``2 * x`` turns a float32 number into float64. All literals, and functions such
  as ``math.sin``, are converted to the precision of the kernel (float32 by default).
- Nothing is allocated. A kernel declares its number of ``scratch`` rows.

**Parameters.** A kernel gets one flat array. `Layout` names the numbers at its head. The arguments of each kind of
kernel are `DYNAMICS`, `CONTROLLER`, `OBSERVE` and `ADVANCE`, each a `Signature`.

**Three kinds of kernels for models**, the shortest first: a predictor of the kernel library (networks, polynomials,
neighbours) in `stepping_kernel`; the step of a single sample in `ScalarStep`; your own block function. Integration and
the rotation of the body frame are part of the system's motion. If the motion has no compiled form, wrappers return
None, and the model runs in NumPy.

**Costs.** The first call compiles (about a second, cached on disk). Fewer than 64 rollouts cost as much as 64. Results
do not depend on the number of threads.

This module needs no compiler. Each word is a function with its meaning for a single lane, where a row is a number; the
engine knows the words by identity (`WORDS`) and compiles their meaning for 64 lanes. Laws, kernels and the classes that
return them therefore import no heavy package.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, ClassVar, Generic, Literal, Protocol, TypeAlias, TypeVar

import numpy as np
import numpy.typing as npt

from sysid_evo.errors import InvalidArgument, ShapeError
from sysid_evo.types import Array

Precision: TypeAlias = Literal["float32", "float64"]

LANES = 64
QUARTER = LANES // 4


def view(array: Any, first: int) -> Any:
    """Return ``array`` from element ``first`` on, without length or ownership: never store it.

    The compiler knows that a loop counter is not negative, but tests an index ``start + i``, which prevents
    vectorisation; a slice would count references in the loop.
    """
    return array[first:]


def load(array: Any, offset: int) -> Any:
    """Return the row of ``array`` that begins at ``offset``."""
    return array[offset]


def load_quarter(array: Any, offset: int) -> Any:
    """Return a quarter of a row of ``array`` that begins at ``offset``."""
    return array[offset]


def splat(number: Any) -> Any:
    """Return a row with ``number`` in every lane."""
    return number


def splat_quarter(number: Any) -> Any:
    """Return a quarter of a row with ``number`` in every lane."""
    return number


def store(array: Any, offset: int, row: Any) -> None:
    """Write ``row`` to ``array`` from ``offset`` on."""
    array[offset] = row


def where_less(a: Any, b: Any, x: Any, y: Any) -> Any:
    """Return x in the lanes where a < b, else y; rows, numbers or both."""
    return x if a < b else y


def where_at_most(a, b, x, y):
    """Return x in the lanes where a <= b, else y; rows, numbers or both."""
    return x if a <= b else y


def where_bits(bits, x, y):
    """Return x in the lanes whose bit is set, else y; for a quarter, the lowest sixteen bits are used."""
    return x if bits & 1 else y


def lanes_less(a, b):
    """Return an integer whose bit i is set if a < b in lane i of two rows or quarters."""
    return 1 if a < b else 0


def lanes_at_most(a, b):
    """Return an integer whose bit i is set if a <= b in lane i of two rows or quarters."""
    return 1 if a <= b else 0


def lanes_differ(a, b):
    """Return an integer whose bit i is set if lane i of two rows differs; nan differs from everything."""
    return 1 if a != b else 0


def lowest(row):
    """Return the smallest number of a row (or of a quarter); none may be nan."""
    return row


def lane_of_lowest(row):
    """Return the first lane of a quarter that holds its smallest number; the last lane if none compares."""
    return 0


def first_lane(bits):
    """Return the index of the lowest bit that is set; there must be one."""
    return (bits & -bits).bit_length() - 1


def pick(row, lane):
    """Return the number in one lane of a row."""
    return row


def look_up(table, place):
    """Return for each lane of a quarter the number of ``table`` (another quarter) at ``place``, from 0.0 to 15.0."""
    raise TypeError("look_up: a single lane has no quarter to look in")


def power_of_two(exponent):
    """Return 2 to the power of a whole number, or of a row of them, given as real numbers."""
    return 2.0**exponent


WORDS: Mapping[Callable[..., Any], str] = {
    word: word.__name__
    for word in (
        first_lane, lane_of_lowest, lanes_at_most, lanes_differ, lanes_less, load, load_quarter, look_up, lowest,
        pick, power_of_two, splat, splat_quarter, store, view, where_at_most, where_bits, where_less,
    )
}  # fmt: skip
"""The words that the engine replaces by their compiled meaning."""


def nearest(x):
    """Return the whole number nearest to x, for |x| up to 2^51; an ordinary kernel function, compiled per precision."""
    return (x + 6755399441055744.0) - 6755399441055744.0


CACHE_LINE = 16
"""Number of float32 numbers in a cache line; arrays that begin at a multiple of it are aligned."""


class Layout:
    """The names of the first numbers of a parameter array, in order; ``layout.name`` is the index of ``name``.

    A kernel gets one flat array, in which only the first numbers have names::

        HEAD = Layout("nx", "dt")

        def predict(x, u, p, y, scratch):
            nx, dt, weights = int(p[HEAD.nx]), p[HEAD.dt], view(p, HEAD.size)

        parameters = HEAD.pack(weights, nx=3, dt=0.05)

    In a kernel function ``HEAD.nx`` is the number 0 and ``HEAD.size`` the number 2. ``size`` is the length of the
    head: the number of names, rounded up to a multiple of ``align``.
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

    def pack(self, *rest: Any, **values: npt.ArrayLike) -> Array:
        """Return the named values in their order, then ``rest``, flat. Raises `InvalidArgument` for other names.

        An array among the values follows at the next multiple of `CACHE_LINE`, and its name is that place.
        """
        if values.keys() != set(self.names):
            raise InvalidArgument(f"layout: expected {', '.join(self.names)}, got {', '.join(values) or 'nothing'}")
        flat = np.concatenate([np.zeros(self.size), *(np.ravel(part) for part in rest)]).astype(np.float64)
        for place, name in enumerate(self.names):
            value = values[name]
            if np.ndim(value):
                flat = padded(flat)
                flat, value = np.concatenate([flat, np.ravel(value)]), len(flat)
            flat[place] = value
        return flat

    def integers(self, **values: int) -> npt.NDArray[np.int64]:
        """Return the named values in their order as whole numbers."""
        return self.pack(**values).astype(np.int64)


class Arrays(Layout):
    """The names of several arrays that a loop gets as one argument, all of one kind."""

    def __init__(self, *names: str, kind: ArgumentKind | None = None) -> None:
        super().__init__(*names)
        self.kind = kind or REALS

    def chosen(self, arrays: Mapping[str, Any]) -> tuple[Any, ...]:
        """Return the ``arrays`` with these names, in order, as the argument."""
        return tuple(arrays[name] for name in self.names)


def padded(array: Array, align: int = CACHE_LINE) -> Array:
    """Return ``array`` with zeros after it, up to a multiple of ``align`` numbers."""
    return np.pad(array, (0, -len(array) % align))


class ArgumentKind(Enum):
    """The kind of an argument, as text for a generated file."""

    REALS = "R"
    WHOLES = "I"
    NUMBER = "types.int64"


REALS, INTEGERS, INTEGER = ArgumentKind.REALS, ArgumentKind.WHOLES, ArgumentKind.NUMBER


class Signature:
    """Named arguments in order, without a result; each is an `ArgumentKind`, a `Layout`, or a function's signature.

    ``REALS`` is an array of the kernel's own precision, ``INTEGERS`` one of int64, ``INTEGER`` an int64. In a loop a
    `Layout` is an array of int64 whose numbers have names, and `Arrays` are several: ``sizes.nx``, ``work.carry``.
    """

    def __init__(self, **arguments: Argument) -> None:
        self.arguments = arguments

    @classmethod
    def of(cls, function: Callable[..., Any], **others: Argument) -> Signature:
        """Return the signature of ``function``, whose arguments are ``REALS`` except for the ``others``."""
        names = tuple(inspect.signature(function).parameters)
        unknown = [name for name in others if name not in names]
        if unknown:
            raise InvalidArgument(f"signature of {function.__qualname__}: no argument is called {', '.join(unknown)}")
        return cls(**{name: others.get(name, REALS) for name in names})

    def ordered(self, **given: Any) -> tuple[Any, ...]:
        """Return the values ``given`` by name in the order of the arguments. Raises `InvalidArgument` for others."""
        if given.keys() != self.arguments.keys():
            missing = ", ".join(self.arguments.keys() - given.keys()) or "none"
            unknown = ", ".join(given.keys() - self.arguments.keys()) or "none"
            raise InvalidArgument(f"call of a kernel: missing arguments: {missing}; unknown ones: {unknown}")
        return tuple(given[name] for name in self.arguments)

    def check(self, function: Callable[..., Any]) -> None:
        """Raise `InvalidArgument` if ``function`` takes another number of arguments."""
        names = tuple(inspect.signature(function).parameters)
        if len(names) != len(self.arguments):
            raise InvalidArgument(
                f"kernel function {function.__module__}.{function.__qualname__}: expected {len(self.arguments)} "
                f"arguments ({', '.join(self.arguments)}), got {len(names)} ({', '.join(names)})"
            )

    def __str__(self) -> str:
        """Return the type as the text of a generated file."""
        return f"types.void({', '.join(_text(kind) for kind in self.arguments.values())})"

    def of_pointers(self) -> str:
        """Return the type, as text for a generated file, of a function that is passed, with addresses of its arrays."""
        others = [name for name, kind in self.arguments.items() if kind not in (REALS, INTEGERS)]
        if others:
            raise InvalidArgument(
                f"a kernel that is passed must only have arrays as arguments, got {', '.join(others)}"
            )
        return f"types.void({', '.join(f'types.CPointer({_text(kind)}.dtype)' for kind in self.arguments.values())})"

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Signature) and list(self.arguments.items()) == list(other.arguments.items())

    def __hash__(self) -> int:
        return hash(tuple(self.arguments.items()))


Argument: TypeAlias = ArgumentKind | Layout | Signature


def _text(argument: Argument) -> str:
    if isinstance(argument, ArgumentKind):
        return argument.value
    if isinstance(argument, Arrays):
        return f"types.UniTuple({argument.kind.value}, {len(argument.names)})"
    if isinstance(argument, Layout):
        return ArgumentKind.WHOLES.value
    return f"types.FunctionType({argument.of_pointers()})"


@dataclass(frozen=True)
class KernelSource:
    """A kernel function, and the bindings of its free names (functions or further sources)."""

    function: Callable[..., Any]
    bindings: Mapping[str, Any] = field(default_factory=dict)

    def __hash__(self) -> int:
        return hash((self.function, tuple(sorted((name, hash(bound)) for name, bound in self.bindings.items()))))


class GeneratedSource(Protocol):
    """A function and the text of another one around it."""

    @property
    def function(self) -> Callable[..., Any]:
        """The wrapped function."""
        ...

    @property
    def bindings(self) -> Mapping[str, Any]:
        """The bindings of its free names."""
        ...

    def write(self, inner: str, name: str) -> str:
        """Return the text of the function ``name`` around the one called ``inner``."""
        ...

    def __hash__(self) -> int: ...


Scalars: TypeAlias = Sequence[float]
"""Numbers of one rollout: arguments and result of a scalar kernel function, a tuple in compiled code."""


@dataclass(frozen=True)
class ScalarStep:
    """A scalar step ``f(x, u, p) -> tuple``, or ``f(x, u, w, p)`` with noise, repeated over the lanes.

    ``x``, ``u`` and ``w`` are tuples of ``n_carry``, ``nu`` and ``n_noise`` numbers, ``p`` is the flat
    parameter array; the result has ``n_carry`` numbers.
    """

    function: Callable[..., Any]
    n_carry: int
    nu: int
    n_noise: int = 0

    bindings: ClassVar[Mapping[str, Any]] = {}

    def write(self, inner: str, name: str) -> str:
        """Return the text of the block kernel around the scalar function called ``inner``."""
        x, u, w = (
            "(" + "".join(f"{array}[{i} * LANES + lane], " for i in range(count)) + ")"
            for array, count in (("carry", self.n_carry), ("control", self.nu), ("noise", self.n_noise))
        )
        arguments = [x, u, *([w] if self.n_noise else []), "parameters"]
        lines = [
            f"def {name}(carry, control, noise, parameters, scratch):",
            "    for lane in range(LANES):",
            f"        y = {inner}({', '.join(arguments)})",
            *(f"        carry[{i} * LANES + lane] = y[{i}]" for i in range(self.n_carry)),
        ]
        return "\n".join(lines)


@dataclass(frozen=True)
class ScalarFunction:
    """A function of single numbers as a function of ``x`` and ``u``, with ``arguments`` such as ``x[0]``."""

    function: Callable[..., Any]
    arguments: tuple[str, ...]

    bindings: ClassVar[Mapping[str, Any]] = {}

    def write(self, inner: str, name: str) -> str:
        """Return the text of the function ``name(x, u)`` around the one called ``inner``."""
        return f"def {name}(x, u):\n    return {inner}({', '.join(self.arguments)})"


Source: TypeAlias = KernelSource | GeneratedSource


DYNAMICS = Signature(carry=REALS, control=REALS, noise=REALS, parameters=REALS, scratch=REALS)
"""Overwrite ``carry`` with the next one."""
CONTROLLER = Signature(theta=REALS, memory=REALS, observation=REALS, raw=REALS, parameters=REALS, scratch=REALS)
"""Write ``raw``, overwrite ``memory``."""
OBSERVE = Signature(task=REALS, state=REALS, observation=REALS, parameters=REALS)
"""Write ``observation``."""
ADVANCE = Signature(
    task=REALS, before=REALS, after=REALS, control=REALS, trials=INTEGERS, trial_data=REALS, parameters=REALS
)
"""Overwrite ``task``, and optionally ``after``.

Row 0 of ``task`` is the fitness, row 1 is 1.0 while the trial is alive; ``trials`` (64,) is the trial
of each lane, whose data begin at ``trials[l] * len(trial_data) / E``.
"""


@dataclass(frozen=True)
class DynamicsKernel:
    """The compiled form of `Dynamics.step`; ``precision`` is the lowest that is exact enough."""

    source: Source
    parameters: Array = field(default_factory=lambda: np.zeros(1))
    n_scratch: int = 0
    precision: Precision = "float32"

    def of_candidates(self, own: Array) -> Array:
        """Return the flat parameters (P, n) of this kernel for candidates whose predictors have ``own`` (P, m)."""
        shell = self.parameters[: len(self.parameters) - own.shape[1]]
        return np.concatenate([np.tile(shell, (len(own), 1)), own], axis=1)


@dataclass(frozen=True)
class ControllerKernel:
    """The compiled form of `Controller.act`.

    With ``before_tanh``, tanh is not yet applied to ``raw``. The loop applies it for continuous controls; a switch at b
    becomes one at artanh b.
    """

    source: Source
    parameters: Array = field(default_factory=lambda: np.zeros(1))
    n_scratch: int = 0
    before_tanh: bool = False


State = TypeVar("State")
"""The state of a task, `sysid_evo.tasks.TaskState`, which is in a higher layer."""


@dataclass(frozen=True)
class TaskKernel(Generic[State]):
    """The compiled form of a bound task.

    ``rows`` converts the state of E trials to task rows (rows, E); ``state`` converts the rows of B
    trials (rows, B), tiled from those, back. ``trial_data`` (E, n) are constants of the trials.
    ``pose_row`` is the first of ``n_pose`` rows with the pose.
    """

    observe: Source
    advance: Source
    rows: Callable[[State], Array]
    trial_data: Callable[[State], Array]
    state: Callable[[State, Array], State]
    parameters: Array = field(default_factory=lambda: np.zeros(1))
    pose_row: int = 2
    n_pose: int = 0


@dataclass(frozen=True)
class Predictor:
    """The compiled form of `next_state` or `acceleration`: a block function, its parameters, its rows of scratch.

    ``function(x, u, p, y, scratch)`` reads rows of the carry ``x`` and of the control ``u``, its own parameters ``p``,
    and writes ``nx`` rows to ``y``; ``scratch`` is its own memory. ``prepare(u, p, scratch)`` may fill the head of
    that memory once per step, before an integrator calls the function several times under the same control. ``reads``
    are the numbers of rows of carry and control that it reads, ``writes`` that of rows that it writes; wrappers refuse
    a predictor that would exceed the arrays.
    """

    function: Any
    parameters: Array
    n_scratch: int
    prepare: Any = None
    reads: tuple[int, int] | None = None
    writes: int | None = None

    def check(self, n_carry: int | None = None, n_control: int | None = None, n_out: int | None = None) -> None:
        """Raise `ShapeError` if it reads more rows than these, or writes another number; None is any number."""
        found = (*(self.reads or (None, None)), self.writes)
        wanted = (n_carry, n_control, n_out)
        beyond = [a > b for a, b in zip(found, wanted, strict=True) if a is not None and b is not None]
        if any(beyond) or (n_out is not None and self.writes not in (None, n_out)):
            raise ShapeError(
                f"kernel: expected a predictor that reads and writes (carry, control, result) {wanted} rows, got "
                f"{found}: the learned arrays do not fit the system or the kernel that calls it"
            )

    @property
    def bindings(self) -> dict[str, Any]:
        """The bindings of a wrapper: ``predict`` and ``prepare``."""
        return {"predict": self.function, "prepare": self.prepare or nothing_to_prepare}


def nothing_to_prepare(u, p, scratch):
    """Do not use the scratch."""
    return


@dataclass(frozen=True)
class MotionKernel:
    """Three block functions over lanes, and their common flat ``parameters`` ``p``.

    - ``integrate(state, after, nx, dt, p)``: ``after`` holds an acceleration and becomes the state dt later;
    - ``turn(state, rate, p)``: add w(x) to ``rate``;
    - ``move(pose, before, after, dt, p)``: ``pose`` becomes that after dt, angles in (-pi, pi].
    """

    integrate: Callable[..., Any]
    turn: Callable[..., Any]
    move: Callable[..., Any]
    parameters: Array = field(default_factory=lambda: np.zeros(1))
