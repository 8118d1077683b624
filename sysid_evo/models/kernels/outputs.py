"""Predictors around predictors that concern their outputs: scaled ones, and those of two in a row."""

from __future__ import annotations

from sysid_evo.kernels import LANES, KernelSource, Layout, Predictor, load, padded, splat, store, view
from sysid_evo.types import Array, check_shape

SCALED = Layout("n_out", "own")


def scaled_outputs(inner: Predictor, factor: Array, offset: Array) -> Predictor:
    """Return a predictor of ``factor`` (n_out,) times the outputs of ``inner``, plus ``offset`` (n_out,)."""
    n_out = len(factor)
    inner.check(n_out=n_out)
    rows = padded(factor), padded(check_shape("offset", offset, (n_out,)))
    parameters = SCALED.pack(*rows, inner.parameters, n_out=n_out, own=SCALED.size + sum(map(len, rows)))
    return Predictor(
        KernelSource(scale, inner.bindings),
        parameters,
        inner.n_scratch,
        prepare=KernelSource(prepare_scaled, inner.bindings),
        reads=inner.reads,
        writes=n_out,
    )


def prepare_scaled(u, p, scratch):
    """Prepare the inner predictor."""
    prepare(u, view(p, int(p[SCALED.own])), scratch)


def scale(x, u, p, y, scratch):
    """Predict, then scale and shift every output."""
    n_out, own = int(p[SCALED.n_out]), int(p[SCALED.own])
    predict(x, u, view(p, own), y, scratch)
    offset = view(p, SCALED.size + (own - SCALED.size) // 2)
    for row in range(n_out):
        store(y, row * LANES, splat(p[SCALED.size + row]) * load(y, row * LANES) + splat(offset[row]))


BOTH = Layout("n_first", "second", "second_room")


def concatenated(first: Predictor, second: Predictor) -> Predictor:
    """Return a predictor of the outputs of ``first``, followed by those of ``second``. Both must state their rows."""
    assert first.reads is not None
    assert first.writes is not None
    assert second.reads is not None
    assert second.writes is not None
    head = padded(first.parameters)
    parameters = BOTH.pack(
        head, second.parameters, n_first=first.writes, second=BOTH.size + len(head), second_room=first.n_scratch
    )
    one, other = first.bindings, second.bindings
    prepares = {"prepare_one": one["prepare"], "prepare_other": other["prepare"]}
    return Predictor(
        KernelSource(predict_both, {"one": one["predict"], "other": other["predict"]}),
        parameters,
        first.n_scratch + second.n_scratch,
        prepare=KernelSource(prepare_both, prepares),
        reads=(max(first.reads[0], second.reads[0]), max(first.reads[1], second.reads[1])),
        writes=first.writes + second.writes,
    )


def prepare_both(u, p, scratch):
    """Prepare both."""
    prepare_one(u, view(p, BOTH.size), scratch)
    prepare_other(u, view(p, int(p[BOTH.second])), view(scratch, int(p[BOTH.second_room]) * LANES))


def predict_both(x, u, p, y, scratch):
    """Write the outputs of both."""
    one(x, u, view(p, BOTH.size), y, scratch)
    own, room = view(p, int(p[BOTH.second])), view(scratch, int(p[BOTH.second_room]) * LANES)
    other(x, u, own, view(y, int(p[BOTH.n_first]) * LANES), room)
