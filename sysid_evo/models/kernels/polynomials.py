"""Sparse polynomials over lanes, for controls that are held during a step.

Every output is a sum over monomials of the state whose factors are polynomials in the control. The
factors are computed once per step, the monomials in every evaluation of an integrator.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from sysid_evo.errors import InvalidArgument
from sysid_evo.kernels import LANES, Layout, Predictor, load, splat, store, view
from sysid_evo.types import Array, check_shape

HEAD = Layout("n_out", "n_state", "n_control", "n_factors", "after_chains")


class Chain:
    """Monomials in an order where each is an earlier one times a variable; number 0 is the constant 1."""

    def __init__(self, variables: int) -> None:
        self.known: dict[tuple[int, ...], int] = {(0,) * variables: 0}
        self.links: list[tuple[int, int]] = []

    def place(self, power: tuple[int, ...]) -> int:
        if power not in self.known:
            variable = max(i for i, exponent in enumerate(power) if exponent)
            parent = self.place((*power[:variable], power[variable] - 1, *power[variable + 1 :]))
            self.links.append((parent, variable))
            self.known[power] = len(self.links)
        return self.known[power]


def polynomial_predictor(powers: npt.ArrayLike, coefficients: Array, n_carry: int, n_control: int) -> Predictor:
    """Return a predictor of y_j = sum_t C_tj prod_i z_i^P_ti, where z are the carry's rows, then the control's.

    ``powers`` P is (terms, n_carry + n_control), ``coefficients`` C (terms, n_out), possibly sparse.

    Layout: the chains of state and control monomials (parent, variable); then for every output its
    number of factors, and for each factor its state monomial; then for each factor its number of
    terms, and control monomial and coefficient of each.
    """
    exponents = np.asarray(powers, dtype=np.int64)
    if exponents.ndim != 2 or exponents.shape[1] != n_carry + n_control or (exponents < 0).any():
        raise InvalidArgument(
            f"polynomial: expected exponents >= 0 of {n_carry} + {n_control} variables, got shape {exponents.shape}"
        )
    coefficients = check_shape("coefficients", coefficients, (len(exponents), None))
    states, controls = Chain(n_carry), Chain(n_control)
    factors: list[dict[int, list[tuple[int, float]]]] = []
    for output in range(coefficients.shape[1]):
        found: dict[int, list[tuple[int, float]]] = {}
        for term in np.flatnonzero(coefficients[:, output]):
            power = tuple(int(e) for e in exponents[term])
            place, held = states.place(power[:n_carry]), controls.place(power[n_carry:])
            found.setdefault(place, []).append((held, float(coefficients[term, output])))
        factors.append(found)
    chains = [number for chain in (states, controls) for link in chain.links for number in link]
    n_factors = sum(len(found) for found in factors)
    flat: list[float] = [*chains]
    for found in factors:
        flat += [len(found), *found]
    for found in factors:
        for terms in found.values():
            flat += [len(terms), *(number for term in terms for number in term)]
    rows = n_factors + max(len(states.links), len(controls.links)) + 1
    parameters = HEAD.pack(
        flat,
        n_out=coefficients.shape[1],
        n_state=len(states.links),
        n_control=len(controls.links),
        n_factors=n_factors,
        after_chains=HEAD.size + len(chains),
    )
    reads, writes = (n_carry, n_control), coefficients.shape[1]
    return Predictor(polynomial, parameters, n_scratch=rows, prepare=control_factors, reads=reads, writes=writes)


def control_factors(u, p, scratch):
    """Write the factor of every state monomial of every output: a polynomial in the control."""
    n_factors = int(p[HEAD.n_factors])
    monomials = view(scratch, n_factors * LANES)
    raise_powers(u, view(p, HEAD.size + 2 * int(p[HEAD.n_state])), int(p[HEAD.n_control]), monomials)
    rest = view(p, int(p[HEAD.after_chains]) + int(p[HEAD.n_out]) + n_factors)
    for factor in range(n_factors):
        total = splat(rest[2]) * load(monomials, int(rest[1]) * LANES)
        count = int(rest[0])
        for term in range(1, count):
            total = total + splat(rest[2 + 2 * term]) * load(monomials, int(rest[1 + 2 * term]) * LANES)
        store(scratch, factor * LANES, total)
        rest = view(rest, 1 + 2 * count)


def polynomial(x, u, p, y, scratch):
    """Write every output: the sum over its state monomials, each times its factor."""
    monomials = view(scratch, int(p[HEAD.n_factors]) * LANES)
    raise_powers(x, view(p, HEAD.size), int(p[HEAD.n_state]), monomials)
    rest, factors = view(p, int(p[HEAD.after_chains])), scratch
    for output in range(int(p[HEAD.n_out])):
        total, count = splat(0.0), int(rest[0])
        for i in range(count):
            total = total + load(factors, i * LANES) * load(monomials, int(rest[1 + i]) * LANES)
        store(y, output * LANES, total)
        rest, factors = view(rest, 1 + count), view(factors, count * LANES)


def raise_powers(z, chain, count, monomials):
    """Write the constant 1 and ``count`` monomials, each an earlier one times a variable."""
    store(monomials, 0, splat(1.0))
    for link in range(count):
        parent, variable = int(chain[2 * link]), int(chain[2 * link + 1])
        store(monomials, (link + 1) * LANES, load(monomials, parent * LANES) * load(z, variable * LANES))
