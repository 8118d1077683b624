"""The weak form of a differential equation: tested with smooth functions instead of differentiated."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array

from model_zoo.sparse.libraries import WeakForm
from sysid_evo.arrays import IntArray
from sysid_evo.errors import InvalidData


def testing_functions(sample: IntArray, dt: float, weak: WeakForm) -> csr_array:
    """Return the weights (M, N) with which M test functions sum N steps, each of norm 1.

    With phi(s) = (1 - s^2)^p on a window, sum phi_k (x_{k+1} - x_k) = -sum (phi_k - phi_{k-1}) x_k: the difference
    moves from the noisy states to the smooth phi (summation by parts; Messenger and Bortz 2021, and pysindy's
    WeakPDELibrary), while controls stay held over every step. ``sample`` (N,) numbers the steps: those of a window
    follow each other without a gap. Raises `InvalidData` if there is no such window.
    """
    width = max(2, 2 * round(weak.H_xt / dt))
    rises = np.diff(sample) == 1
    unbroken = np.concatenate([[0], np.cumsum(~rises)])
    starts = np.arange(len(sample) - width + 1)
    starts = starts[unbroken[starts + width - 1] == unbroken[starts]] if len(starts) > 0 else starts
    if not len(starts):
        raise InvalidData(f"weak form: no {width} steps follow each other; take a shorter H_xt than {weak.H_xt:g} s")
    count = len(starts) if weak.K is None else min(weak.K, len(starts))
    step = max(1, width // 4)
    chosen = starts[::step] if weak.K is None else starts[np.linspace(0, len(starts) - 1, count).astype(np.int64)]
    s = (np.arange(width) + 0.5) * 2.0 / width - 1.0
    phi = (1.0 - s**2) ** weak.p
    phi /= np.linalg.norm(phi)
    rows = np.repeat(np.arange(len(chosen)), width)
    columns = (chosen[:, None] + np.arange(width)).ravel()
    return csr_array((np.tile(phi, len(chosen)), (rows, columns)), shape=(len(chosen), len(sample)))
