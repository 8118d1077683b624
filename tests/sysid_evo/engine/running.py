"""How the tests of the engine call kernel functions: from Python, on arrays of 64 lanes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest

from sysid_evo.engine.compiled.compiler import compile_kernel
from sysid_evo.engine.compiled.workspace import aligned
from sysid_evo.kernels import DYNAMICS, LANES, KernelSource, Precision, Signature
from sysid_evo.models.kernels import Predictor
from sysid_evo.types import Array

PRECISIONS: tuple[Precision, ...] = ("float64", "float32")
EXACT_FIRST = ("float64", pytest.param("float32", marks=pytest.mark.nightly))
"""For functions that are compiled at length: the tighter tolerance always, the other precision with --nightly."""
RTOL: Mapping[str, float] = {"float64": 1e-9, "float32": 2e-4}


def compile_for_python(
    function: Callable[..., Any], signature: Signature, precision: Precision, bindings: Mapping[str, Any] | None = None
) -> Any:
    """Return ``function`` compiled, to be called from Python."""
    return compile_kernel(KernelSource(function, bindings or {}), signature, precision, pointer=False)


def call_block(
    function: Callable[..., Any],
    signature: Signature,
    precision: Precision,
    arguments: list[Any],
    bindings: Mapping[str, Any] | None = None,
) -> list[Any]:
    """Call a block function on copies of ``arguments``, flat; return them as they are afterwards."""
    flat = [
        aligned(np.ravel(a) if np.asarray(a).dtype == np.int64 else np.ravel(a).astype(precision)) for a in arguments
    ]
    compile_for_python(function, signature, precision, bindings)(*flat)
    return [after[: np.size(a)].reshape(np.shape(a)) for after, a in zip(flat, arguments, strict=True)]


def ask(x, u, p, y, scratch):  # type: ignore[no-untyped-def]  # read by Numba
    """Prepare and predict once."""
    prepare(u, p, scratch)  # type: ignore[name-defined]  # noqa: F821  # bound later
    predict(x, u, p, y, scratch)  # type: ignore[name-defined]  # noqa: F821  # bound later


def predictions(predictor: Predictor, x: Array, u: Array, n_out: int, precision: Precision) -> Array:
    """Return what ``predictor`` says (64, n_out) for carries (64, n) and controls (64, nu)."""
    guard = 7.0
    y = np.full((n_out, LANES), np.nan)
    scratch = np.full((predictor.n_scratch + 1, LANES), guard)
    arguments = [x.T, u.T, predictor.parameters, y, scratch]
    after = call_block(ask, DYNAMICS, precision, arguments, predictor.bindings)
    assert (after[4][-1] == guard).all(), "it writes beyond the room it asked for"
    np.testing.assert_array_equal(after[0], np.asarray(x.T, dtype=precision))
    np.testing.assert_array_equal(after[1], np.asarray(u.T, dtype=precision))
    return np.asarray(after[3], dtype=np.float64).T
