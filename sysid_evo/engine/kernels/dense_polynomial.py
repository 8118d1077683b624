"""Polynomials of few states over lanes, all monomials up to a degree, nested as in Horner's rule.

    P(x1..xn, degree) = P(x2..xn, degree) + x1 P(x1..xn, degree - 1)

The number of states and the degree are compiled in, so that a polynomial is one expression without loops. Its
coefficients are polynomials in the control, found once a step: from a table where every lane's control is one of its
levels, as a controller's always is, else term by term.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from itertools import product

import numpy as np

from sysid_evo.arrays import Array, IntArray
from sysid_evo.engine.compiled.dialect import KernelSource
from sysid_evo.engine.compiled.lanes import (
    LANES,
    QUARTER,
    lanes_differ,
    load,
    load_quarter,
    look_up,
    splat,
    store,
    view,
)
from sysid_evo.engine.compiled.layout import CACHE_LINE, Layout, padded
from sysid_evo.engine.kernels.commands import command_cells
from sysid_evo.engine.kernels.monomials import Chain, raise_powers
from sysid_evo.engine.kernels.stepping import Predictor

HEAD = Layout("n_controls", "n_links", "links", "terms", "tabled", "boundaries", "levels", "table", align=CACHE_LINE)
PAGE = QUARTER
MOST_COEFFICIENTS = 120
"""Of all outputs together: what is compiled in is small."""
WORTH = 3
"""A dense polynomial of so many times as many coefficients takes as long as one of few terms."""


def nested_order(n_states: int, degree: int) -> list[tuple[int, ...]]:
    """Return the exponents of all monomials in the order in which `nested` reads their coefficients."""
    if n_states == 0 or degree == 0:
        return [(0,) * n_states]
    without = [(0, *rest) for rest in nested_order(n_states - 1, degree)]
    return without + [(first + 1, *rest) for first, *rest in nested_order(n_states, degree - 1)]


@cache
def nested(first: int, n_states: int, degree: int) -> KernelSource:
    """Return the function ``(x, c)`` for the polynomial of the rows from ``first`` to ``n_states`` of a quarter."""
    if first == n_states or degree == 0:
        return KernelSource(constant)
    bindings = {
        "without": nested(first + 1, n_states, degree),
        "within": nested(first, n_states, degree - 1),
        "ROW": first,
        "SKIPPED": math.comb(n_states - first - 1 + degree, degree),
    }
    return KernelSource(linked, bindings)


def constant(x, c):
    """Return the only coefficient."""
    return load_quarter(c, 0)


def linked(x, c):
    """Return what has no factor of this row, plus this row times the rest."""
    return without(x, c) + load_quarter(x, ROW * LANES) * within(x, view(c, SKIPPED * LANES))


def dense_polynomial_predictor(
    exponents: IntArray, coefficients: Array, n_carry: int, n_control: int, levels: Sequence[Array | None]
) -> Predictor | None:
    """Return a predictor as `polynomial_predictor`, or None where the monomials of all states are too many to pay.

    ``levels`` are those of each control, None of one that has none.
    """
    of_state, of_control = exponents[:, :n_carry], exponents[:, n_carry:]
    degree, n_out = int(of_state.sum(axis=1).max()), coefficients.shape[1]
    count = math.comb(n_carry + degree, degree)
    if count * n_out > MOST_COEFFICIENTS:
        return None
    place = {power: i for i, power in enumerate(nested_order(n_carry, degree))}
    controls = Chain(n_control)
    terms: list[list[tuple[int, float]]] = [[] for _ in range(n_out * count)]
    for power, held, row in zip(of_state.tolist(), of_control.tolist(), coefficients, strict=True):
        monomial = controls.place(tuple(held))
        for output in np.flatnonzero(row):
            terms[output * count + place[tuple(power)]].append((monomial, float(row[output])))
    if n_out * count > WORTH * sum(len(one) > 0 for one in terms):
        return None
    links = [number for link in controls.links for number in link]
    flat = [number for one in terms for number in (len(one), *(part for term in one for part in term))]
    boundaries, of_cell, table = _tables(levels, controls, terms)
    blocks = [padded(np.array(block, dtype=np.float64)) for block in (links, flat, boundaries, of_cell, table)]
    places = np.cumsum([HEAD.size, *(len(block) for block in blocks)])
    parameters = HEAD.pack(
        *blocks,
        n_controls=n_control,
        n_links=len(controls.links),
        tabled=len(table) > 0,
        **dict(zip(("links", "terms", "boundaries", "levels", "table"), places, strict=False)),
    )
    sizes = {"N_OUT": n_out, "COUNT": count}
    return Predictor(
        KernelSource(dense_polynomial, {**sizes, "polynomial": nested(0, n_carry, degree)}),
        parameters,
        n_scratch=n_out * count + max(2, 1 + len(controls.links)),
        prepare=KernelSource(find_coefficients, sizes, one_lane=find_coefficients_of_one),
    )


def _tables(
    levels: Sequence[Array | None], controls: Chain, terms: Sequence[Sequence[tuple[int, float]]]
) -> tuple[list[float], Array, Array]:
    """Return the boundaries between levels as `command_cells` reads them, the controls and coefficients of 16 cells.

    Empty where a control has no levels, or all of them together have more than sixteen.
    """
    known = [np.unique(level) for level in levels if level is not None]
    count = math.prod(len(level) for level in known)
    if len(known) < len(levels) or not known or count > QUARTER:
        return [], np.empty(0), np.empty(0)
    cells = np.array(list(product(*known)), dtype=np.float64)
    boundaries = [number for level in known for number in (len(level) - 1, *(0.5 * (level[1:] + level[:-1])))]
    of_cell = np.pad(cells.T, ((0, 0), (0, QUARTER - count)))
    monomials = [np.ones(QUARTER)]
    for parent, variable in controls.links:
        monomials.append(monomials[parent] * of_cell[variable])
    table = np.array([sum((c * monomials[held] for held, c in one), np.zeros(QUARTER)) for one in terms])
    return boundaries, of_cell.ravel(), table.ravel()


def find_coefficients(u, p, scratch):
    """Write the coefficients of every output, a row each."""
    cells = view(scratch, N_OUT * COUNT * LANES)
    if p[HEAD.tabled] > 0.0:
        n_controls, levels, table = int(p[HEAD.n_controls]), view(p, int(p[HEAD.levels])), view(p, int(p[HEAD.table]))
        command_cells(u, view(p, int(p[HEAD.boundaries])), n_controls, cells)
        other, level = 0, view(cells, LANES)
        for control in range(n_controls):
            of_level = load_quarter(levels, control * QUARTER)
            for lane in range(0, LANES, QUARTER):
                store(level, lane, look_up(of_level, load_quarter(cells, lane)))
            other |= lanes_differ(load(u, control * LANES), load(level, 0))
        if other == 0:
            for lane in range(0, LANES, QUARTER):
                cell, here = load_quarter(cells, lane), view(scratch, lane)
                for k in range(N_OUT * COUNT):
                    store(here, k * LANES, look_up(load_quarter(table, k * QUARTER), cell))
            return
    term_by_term(u, p, scratch, cells, N_OUT * COUNT)


def find_coefficients_of_one(u, p, scratch):
    """`find_coefficients` for a target of one lane."""
    cells = view(scratch, N_OUT * COUNT)
    if p[HEAD.tabled] > 0.0:
        n_controls, levels, table = int(p[HEAD.n_controls]), view(p, int(p[HEAD.levels])), view(p, int(p[HEAD.table]))
        command_cells(u, view(p, int(p[HEAD.boundaries])), n_controls, cells)
        other, cell = 0, int(cells[0])
        for control in range(n_controls):
            other += 1 if u[control] != levels[control * PAGE + cell] else 0
        if other == 0:
            for k in range(N_OUT * COUNT):
                scratch[k] = table[k * PAGE + cell]
            return
    term_by_term(u, p, scratch, cells, N_OUT * COUNT)


def term_by_term(u, p, scratch, monomials, count):
    """Write ``count`` coefficients, each a sum of monomials of the control."""
    raise_powers(u, view(p, int(p[HEAD.links])), int(p[HEAD.n_links]), monomials)
    rest = view(p, int(p[HEAD.terms]))
    for k in range(count):
        total, terms = splat(0.0), int(rest[0])
        for term in range(terms):
            total = total + splat(rest[2 + 2 * term]) * load(monomials, int(rest[1 + 2 * term]) * LANES)
        store(scratch, k * LANES, total)
        rest = view(rest, 1 + 2 * terms)


def dense_polynomial(x, u, p, y, scratch):
    """Write every output (a predictor, see `stepping`)."""
    for lane in range(0, LANES, QUARTER):
        here, coefficients = view(x, lane), view(scratch, lane)
        for output in range(N_OUT):
            store(y, output * LANES + lane, polynomial(here, view(coefficients, output * COUNT * LANES)))
