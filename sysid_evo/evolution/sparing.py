"""Which candidates are run on which models, so that the best of them are known exactly, and nothing else is run."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from sysid_evo.arrays import Array, IntArray

TOGETHER = 64
"""Rollouts that the compiled engine takes side by side: fewer cost as much."""


def run_leading(
    run: Callable[[int, IntArray], Array], *, candidates: int, models: int, needed: int, trials: int
) -> Array:
    """Run candidates on one model after the other until the ``needed`` best of them have been run on all.

    ``run(i, who)`` runs the candidates ``who`` on model i, after the models before it, and returns the most that
    each can become, which is what it is after the last. Returned are these bounds (candidates,): what is still
    open is below all of the ``needed`` best, also of those that are as good as the last of them. The best-first
    search: nobody is run who is not among the ``needed`` highest bounds, as their worst is at least that of the best.
    Only where a block of `TOGETHER` rollouts would not be full, the next ones fill it.
    """
    if models == 1:
        return run(0, np.arange(candidates))
    bounds, done = np.full(candidates, np.inf), np.zeros(candidates, dtype=np.int64)
    while True:
        level = np.partition(bounds, -needed)[-needed]
        due = (bounds >= level) & (done < models)
        if not due.any():
            return bounds
        model = int(done[due].min())
        blocks = -(-int((done[due] == model).sum()) * trials // TOGETHER)
        waiting = np.flatnonzero(done == model)
        highest_first = waiting[np.argsort(-bounds[waiting], kind="stable")]
        chosen = np.sort(highest_first[: blocks * TOGETHER // trials])
        bounds[chosen] = run(model, chosen)
        done[chosen] += 1
