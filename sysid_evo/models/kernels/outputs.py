"""Predictors around predictors that concern their outputs: scaled ones, the sum of two, and those of two in a row."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from sysid_evo.kernels import CACHE_LINE, LANES, KernelSource, Layout, Predictor, load, splat, store, view
from sysid_evo.types import Array, check_shape

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
