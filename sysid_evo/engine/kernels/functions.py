"""A predictor that sees elementary functions of carry and control, each within a range, instead of these."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from sysid_evo.kernels import CACHE_LINE, LANES, KernelSource, Layout, Predictor, padded, view

HEAD = Layout("n_carry", "n_control", "of_control", "own", align=CACHE_LINE)
NUMBERS = 5
PLAIN, ABS, SIGN, SIN, COS, TANH, EXP, SQRT_ABS, X_ABS = range(9)
KINDS = {
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
    """``function`` ("" for none) of ``factor`` times a row, within ``low`` and ``high``."""

    function: str
    place: int
    factor: float
    low: float
    high: float


def of_functions(inner: Predictor, of_carry: Sequence[SeenRow], of_control: Sequence[SeenRow]) -> Predictor:
    """Return a predictor that shows ``inner`` functions of rows of the carry, and of the control."""
    flat = [[KINDS[row.function], *row[1:]] for row in (*of_carry, *of_control)]
    rows = padded(np.array(flat, dtype=np.float64).ravel())
    parameters = HEAD.pack(
        rows,
        inner.parameters,
        n_carry=len(of_carry),
        n_control=len(of_control),
        of_control=HEAD.size + NUMBERS * len(of_carry),
        own=HEAD.size + len(rows),
    )
    return Predictor(
        KernelSource(seen_as_functions, inner.bindings),
        parameters,
        len(of_carry) + len(of_control) + inner.n_scratch,
        prepare=KernelSource(prepare_functions, inner.bindings),
    )


def prepare_functions(u, p, scratch):
    """Write the functions of the control to the head of the scratch, and prepare with them."""
    n_control = int(p[HEAD.n_control])
    write_functions(u, view(p, int(p[HEAD.of_control])), n_control, scratch)
    prepare(scratch, view(p, int(p[HEAD.own])), view(scratch, (n_control + int(p[HEAD.n_carry])) * LANES))


def seen_as_functions(x, u, p, y, scratch):
    """Write the functions of the carry after those of the control, and predict from both."""
    n_control, n_carry = int(p[HEAD.n_control]), int(p[HEAD.n_carry])
    seen = view(scratch, n_control * LANES)
    write_functions(x, view(p, HEAD.size), n_carry, seen)
    predict(seen, scratch, view(p, int(p[HEAD.own])), y, view(scratch, (n_control + n_carry) * LANES))


def write_functions(x, rows, count, y):
    """y = a function of a row of x, row by row, within a range."""
    for row in range(count):
        about = view(rows, row * NUMBERS)
        kind, factor, low, high = int(about[0]), about[2], about[3], about[4]
        here, there = view(x, int(about[1]) * LANES), view(y, row * LANES)
        for lane in range(LANES):
            there[lane] = factor * here[lane]
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
