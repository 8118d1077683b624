"""Predictors around predictors.

A turning frame (`turning_frame`), clipped inputs (`within`), changes added to states (`on_top`), sines and cosines of
periodic states (`with_angles`), elementary functions of inputs (`of_functions`); scaled outputs, the sum of two
predictors, and two in a row.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from sysid_evo.angles import TURN
from sysid_evo.errors import ShapeError
from sysid_evo.kernels import CACHE_LINE, LANES, KernelSource, Layout, Predictor, load, splat, store, view
from sysid_evo.models.kernels.stepping import copy
from sysid_evo.system import System
from sysid_evo.types import Array, BoolArray, check_shape

FRAME = Layout("nx", "per_dt", "contained", "frame", "limits", "own", align=CACHE_LINE)


def turning_frame(rate: Predictor, system: System, *, bounds: Array | None = None) -> Predictor | None:
    """Return a predictor of dx/dt = rate + w(x), where w is the effect of the motion's turning frame on the state.

    ``bounds`` (5, nx) are lowest and highest state, 1 / margin, lowest and highest rate. The rate is clipped. Outside
    the bounds of a state, rates that lead further out are reduced to 0 over the margin, and the excess decays with the
    time constant dt. None if the system's motion has no compiled form.
    """
    motion = system.motion_kernel()
    if motion is None:
        return None
    limits = np.empty(0) if bounds is None else np.ravel(check_shape("bounds", bounds, (5, system.nx)))
    rate.check(n_out=system.nx)
    parameters = FRAME.pack(
        nx=system.nx,
        per_dt=1.0 / system.dt,
        contained=len(limits) > 0,
        frame=motion.parameters,
        limits=limits,
        own=rate.parameters,
    )
    return Predictor(
        KernelSource(turned, {**rate.bindings, "turn": motion.turn, "NX": system.nx}),
        parameters,
        rate.n_scratch,
        prepare=KernelSource(prepare_own, {**rate.bindings, "OWN": FRAME.own}),
        reads=rate.reads,
        writes=system.nx,
    )


def turned(x, u, p, y, scratch):
    """Write rate + w(x), with bounds if there are any."""
    predict(x, u, view(p, int(p[FRAME.own])), y, scratch)
    if p[FRAME.contained] > 0.0:
        slowest, fastest = view(p, int(p[FRAME.limits]) + 3 * NX), view(p, int(p[FRAME.limits]) + 4 * NX)
        for row in range(NX):
            store(y, row * LANES, min(max(load(y, row * LANES), slowest[row]), fastest[row]))
    turn(x, y, view(p, int(p[FRAME.frame])))
    if p[FRAME.contained] > 0.0:
        limits, back = view(p, int(p[FRAME.limits])), p[FRAME.per_dt]
        for row in range(NX):
            per_margin, here, total = limits[2 * NX + row], load(x, row * LANES), load(y, row * LANES)
            above, below = max(here - limits[NX + row], 0.0), max(limits[row] - here, 0.0)
            up = max(total, 0.0) * max(1.0 - above * per_margin, 0.0)
            down = min(total, 0.0) * max(1.0 - below * per_margin, 0.0)
            store(y, row * LANES, up + down - back * (above - below))


CLIP = Layout("n_carry", "n_control", "low", "high", "own", align=CACHE_LINE)


def within(inner: Predictor, low: Array, high: Array, n_carry: int) -> Predictor:
    """Return a predictor whose carry and control are clipped to ``low`` and ``high`` (n_carry + nu,)."""
    inputs = len(low)
    if not 0 <= n_carry <= inputs:
        raise ShapeError(f"low: expected at least {n_carry} numbers, one for each of the carry, got {inputs}")
    inner.check(n_carry, inputs - n_carry)
    parameters = CLIP.pack(
        n_carry=n_carry,
        n_control=inputs - n_carry,
        low=low,
        high=check_shape("high", high, (inputs,)),
        own=inner.parameters,
    )
    return Predictor(
        KernelSource(clipped, {**inner.bindings, "N_CARRY": n_carry, "N_CONTROL": inputs - n_carry}),
        parameters,
        inputs + inner.n_scratch,
        prepare=KernelSource(prepare_clipped, inner.bindings),
        reads=(n_carry, inputs - n_carry),
        writes=inner.writes,
    )


def prepare_clipped(u, p, scratch):
    """Clip the control and prepare with it; the scratch begins with the control, then the carry."""
    n_carry, n_control = int(p[CLIP.n_carry]), int(p[CLIP.n_control])
    low, high = view(p, int(p[CLIP.low]) + n_carry), view(p, int(p[CLIP.high]) + n_carry)
    clip_rows(u, low, high, n_control, scratch)
    prepare(scratch, view(p, int(p[CLIP.own])), view(scratch, (n_carry + n_control) * LANES))


def clipped(x, u, p, y, scratch):
    """Clip the carry, and predict from it and the clipped control."""
    carry = view(scratch, N_CONTROL * LANES)
    clip_rows(x, view(p, int(p[CLIP.low])), view(p, int(p[CLIP.high])), N_CARRY, carry)
    predict(carry, scratch, view(p, int(p[CLIP.own])), y, view(scratch, (N_CARRY + N_CONTROL) * LANES))


def clip_rows(x, low, high, count, y):
    """y = x clipped, row by row."""
    for row in range(count):
        store(y, row * LANES, min(max(load(x, row * LANES), low[row]), high[row]))


ON_TOP = Layout("nx", "added", "low", "high", "own", align=CACHE_LINE)


def on_top(inner: Predictor, added: BoolArray, *, low: Array | None = None, high: Array | None = None) -> Predictor:
    """Return a predictor of the next state, where ``inner`` predicts the change of the states in ``added`` (nx,).

    With ``low`` and ``high`` (nx,), the change is added to the present state clipped to them.
    """
    nx = len(added)
    least, most = np.full(nx, -np.inf) if low is None else low, np.full(nx, np.inf) if high is None else high
    inner.check(n_out=nx)
    least, most = check_shape("low", least, (nx,)), check_shape("high", most, (nx,))
    return Predictor(
        KernelSource(put_on_top, inner.bindings),
        ON_TOP.pack(nx=nx, added=added, low=least, high=most, own=inner.parameters),
        inner.n_scratch,
        prepare=KernelSource(prepare_own, {**inner.bindings, "OWN": ON_TOP.own}),
        reads=inner.reads,
        writes=nx,
    )


def put_on_top(x, u, p, y, scratch):
    """Predict, and add changes to their states."""
    predict(x, u, view(p, int(p[ON_TOP.own])), y, scratch)
    added, low, high = view(p, int(p[ON_TOP.added])), view(p, int(p[ON_TOP.low])), view(p, int(p[ON_TOP.high]))
    for row in range(int(p[ON_TOP.nx])):
        if added[row] > 0.0:
            inside = min(max(load(x, row * LANES), low[row]), high[row])
            store(y, row * LANES, load(y, row * LANES) + inside)


ANGLES = Layout("n_carry", "n_seen", "own", align=CACHE_LINE)


def with_angles(inner: Predictor, system: System, lags: tuple[int, int] = (0, 0)) -> Predictor:
    """Return a predictor that passes each periodic state to ``inner`` as sine and cosine, see `regressors`.

    The carry holds the state, ``lags[0]`` earlier states and ``lags[1]`` earlier controls.
    """
    if not system.periods:
        return inner
    per_state = [TURN / system.periods[i] if i in system.periods else 0.0 for i in range(system.nx)]
    per_row = np.array([*per_state * (1 + lags[0]), *[0.0] * (system.nu * lags[1])])
    n_seen = len(per_row) + int(np.count_nonzero(per_row))
    inner.check(n_seen)
    return Predictor(
        KernelSource(seen_as_angles, inner.bindings),
        ANGLES.pack(per_row, n_carry=len(per_row), n_seen=n_seen, own=inner.parameters),
        n_seen + inner.n_scratch,
        prepare=KernelSource(prepare_inner, inner.bindings),
        reads=(len(per_row), inner.reads[1] if inner.reads else system.nu),
        writes=inner.writes,
    )


def prepare_inner(u, p, scratch):
    """Prepare the inner predictor; its scratch follows its inputs."""
    prepare(u, view(p, int(p[ANGLES.own])), view(scratch, int(p[ANGLES.n_seen]) * LANES))


def seen_as_angles(x, u, p, y, scratch):
    """Predict from the sines and cosines."""
    row = 0
    for i in range(int(p[ANGLES.n_carry])):
        factor, here, there = p[ANGLES.size + i], view(x, i * LANES), view(scratch, row * LANES)
        if factor > 0.0:
            for lane in range(LANES):
                there[lane] = math.sin(factor * here[lane])
                there[LANES + lane] = math.cos(factor * here[lane])
            row += 2
        else:
            copy(here, there, LANES)
            row += 1
    predict(scratch, u, view(p, int(p[ANGLES.own])), y, view(scratch, int(p[ANGLES.n_seen]) * LANES))


FUNCTIONS = Layout("n_carry", "n_control", "of_control", "own", align=CACHE_LINE)

NUMBERS = 6
PLAIN, ABS, SIGN, SIN, COS, TANH, EXP, SQRT_ABS, X_ABS = range(9)

CODES = {
    "": PLAIN,
    "abs": ABS,
    "sign": SIGN,
    "sin": SIN,
    "cos": COS,
    "tanh": TANH,
    "exp": EXP,
    "sqrt_abs": SQRT_ABS,
    "x_abs": X_ABS,
}


class SeenRow(NamedTuple):
    """``function`` ("" for none) of ``factor`` times a row without its ``offset``, within ``low`` and ``high``."""

    function: str
    place: int
    factor: float
    offset: float
    low: float
    high: float


def of_functions(inner: Predictor, of_carry: Sequence[SeenRow], of_control: Sequence[SeenRow]) -> Predictor:
    """Return a predictor that passes functions of rows of the carry and of the control to ``inner``."""
    flat = [[CODES[row.function], *row[1:]] for row in (*of_carry, *of_control)]
    inner.check(len(of_carry), len(of_control))
    parameters = FUNCTIONS.pack(
        flat,
        n_carry=len(of_carry),
        n_control=len(of_control),
        of_control=FUNCTIONS.size + NUMBERS * len(of_carry),
        own=inner.parameters,
    )
    return Predictor(
        KernelSource(seen_as_functions, inner.bindings),
        parameters,
        len(of_carry) + len(of_control) + inner.n_scratch,
        prepare=KernelSource(prepare_functions, inner.bindings),
        reads=(
            1 + max((row.place for row in of_carry), default=-1),
            1 + max((row.place for row in of_control), default=-1),
        ),
        writes=inner.writes,
    )


def prepare_functions(u, p, scratch):
    """Write the functions of the control to the head of the scratch and prepare with them."""
    n_control = int(p[FUNCTIONS.n_control])
    write_functions(u, view(p, int(p[FUNCTIONS.of_control])), n_control, scratch)
    prepare(scratch, view(p, int(p[FUNCTIONS.own])), view(scratch, (n_control + int(p[FUNCTIONS.n_carry])) * LANES))


def seen_as_functions(x, u, p, y, scratch):
    """Write the functions of the carry after those of the control, and predict from both."""
    n_control, n_carry = int(p[FUNCTIONS.n_control]), int(p[FUNCTIONS.n_carry])
    seen = view(scratch, n_control * LANES)
    write_functions(x, view(p, FUNCTIONS.size), n_carry, seen)
    predict(seen, scratch, view(p, int(p[FUNCTIONS.own])), y, view(scratch, (n_control + n_carry) * LANES))


def write_functions(x, rows, count, y):
    """y = a function of a row of x, row by row, within a range."""
    for row in range(count):
        about = view(rows, row * NUMBERS)
        kind, factor, offset, low, high = int(about[0]), about[2], about[3], about[4], about[5]
        here, there = view(x, int(about[1]) * LANES), view(y, row * LANES)
        for lane in range(LANES):
            there[lane] = factor * (here[lane] - offset)
        if kind == ABS:
            for lane in range(LANES):
                there[lane] = abs(there[lane])
        elif kind == SIGN:
            for lane in range(LANES):
                there[lane] = (1.0 if there[lane] > 0.0 else 0.0) - (1.0 if there[lane] < 0.0 else 0.0)
        elif kind == SIN:
            for lane in range(LANES):
                there[lane] = math.sin(there[lane])
        elif kind == COS:
            for lane in range(LANES):
                there[lane] = math.cos(there[lane])
        elif kind == TANH:
            for lane in range(LANES):
                there[lane] = math.tanh(there[lane])
        elif kind == EXP:
            for lane in range(LANES):
                there[lane] = math.exp(there[lane])
        elif kind == SQRT_ABS:
            for lane in range(LANES):
                there[lane] = math.sqrt(abs(there[lane]))
        elif kind == X_ABS:
            for lane in range(LANES):
                there[lane] = there[lane] * abs(there[lane])
        for lane in range(LANES):
            there[lane] = min(max(there[lane], low), high)


SCALED = Layout("n_out", "factor", "offset", "own", align=CACHE_LINE)


def scaled_outputs(inner: Predictor, factor: Array, offset: Array) -> Predictor:
    """Return a predictor of ``factor`` (n_out,) times the outputs of ``inner``, plus ``offset`` (n_out,)."""
    n_out = len(factor)
    inner.check(n_out=n_out)
    return Predictor(
        KernelSource(scale, inner.bindings),
        SCALED.pack(n_out=n_out, factor=factor, offset=check_shape("offset", offset, (n_out,)), own=inner.parameters),
        inner.n_scratch,
        prepare=KernelSource(prepare_own, {**inner.bindings, "OWN": SCALED.own}),
        reads=inner.reads,
        writes=n_out,
    )


def prepare_own(u, p, scratch):
    """Prepare the inner predictor, whose parameters begin at the place in number OWN."""
    prepare(u, view(p, int(p[OWN])), scratch)


def scale(x, u, p, y, scratch):
    """Predict, then scale and shift every output."""
    factor, offset = view(p, int(p[SCALED.factor])), view(p, int(p[SCALED.offset]))
    predict(x, u, view(p, int(p[SCALED.own])), y, scratch)
    for row in range(int(p[SCALED.n_out])):
        store(y, row * LANES, splat(factor[row]) * load(y, row * LANES) + splat(offset[row]))


TWO = Layout("rows", "second_room", "sum_room", "first", "second", align=CACHE_LINE)


def added(first: Predictor, second: Predictor, nx: int) -> Predictor:
    """Return a predictor of the sum of two, each with its own scratch."""
    second.check(n_out=nx)
    return replace(of_two(add, first, second, nx), n_scratch=first.n_scratch + second.n_scratch + nx)


def concatenated(first: Predictor, second: Predictor) -> Predictor:
    """Return a predictor of the outputs of ``first``, followed by those of ``second``. Both must state their rows."""
    assert first.writes is not None
    assert second.writes is not None
    return replace(of_two(predict_both, first, second, first.writes), writes=first.writes + second.writes)


def of_two(function: Callable[..., Any], first: Predictor, second: Predictor, rows: int) -> Predictor:
    """Return a predictor by a ``function`` that calls ``one`` and ``other``, each with its own scratch."""
    one, other, room = first.bindings, second.bindings, first.n_scratch + second.n_scratch
    parameters = TWO.pack(
        rows=rows, second_room=first.n_scratch, sum_room=room, first=first.parameters, second=second.parameters
    )
    return Predictor(
        KernelSource(function, {"one": one["predict"], "other": other["predict"]}),
        parameters,
        room,
        prepare=KernelSource(prepare_two, {"prepare_one": one["prepare"], "prepare_other": other["prepare"]}),
        reads=(max(a[0], b[0]), max(a[1], b[1])) if (a := first.reads) and (b := second.reads) else None,
        writes=first.writes,
    )


def prepare_two(u, p, scratch):
    """Prepare both."""
    prepare_one(u, view(p, int(p[TWO.first])), scratch)
    prepare_other(u, view(p, int(p[TWO.second])), view(scratch, int(p[TWO.second_room]) * LANES))


def add(x, u, p, y, scratch):
    """Write the sum; the second prediction is in the last rows of the scratch."""
    more = view(scratch, int(p[TWO.sum_room]) * LANES)
    one(x, u, view(p, int(p[TWO.first])), y, scratch)
    other(x, u, view(p, int(p[TWO.second])), more, view(scratch, int(p[TWO.second_room]) * LANES))
    for row in range(int(p[TWO.rows])):
        store(y, row * LANES, load(y, row * LANES) + load(more, row * LANES))


def predict_both(x, u, p, y, scratch):
    """Write the outputs of both."""
    one(x, u, view(p, int(p[TWO.first])), y, scratch)
    own, room = view(p, int(p[TWO.second])), view(scratch, int(p[TWO.second_room]) * LANES)
    other(x, u, own, view(y, int(p[TWO.rows]) * LANES), room)
