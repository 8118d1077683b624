"""Monomials over lanes, each an earlier one times a variable."""

from __future__ import annotations

from sysid_evo.engine.compiled.lanes import LANES, load, splat, store


class Chain:
    """Monomials in an order in which each is an earlier one times a variable; 0 is the constant 1."""

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


def raise_powers(z, chain, count, monomials):
    """Write the constant 1 and ``count`` monomials, each an earlier one times a variable."""
    store(monomials, 0, splat(1.0))
    for link in range(count):
        parent, variable = int(chain[2 * link]), int(chain[2 * link + 1])
        store(monomials, (link + 1) * LANES, load(monomials, parent * LANES) * load(z, variable * LANES))
