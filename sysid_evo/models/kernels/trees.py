"""Sums of binary decision trees over lanes: one kernel for every forest and every boosted ensemble.

**Top.** The first nodes of a tree, or all of a small tree, are computed in every lane, from the leaves to the root: a
node is one comparison and one choice between two rows, so that thirty nodes cost as much as two levels of a search.

**Below.** Each lane descends through blocks of seven nodes, three levels deep. The seven comparisons are one vector
instruction, and their bits lead to one of eight children: a block or a leaf. Lanes that have reached a leaf leave the
list of those that descend.
"""

# mypy: allow-untyped-defs, allow-untyped-calls
from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sysid_evo.errors import InvalidArgument, ShapeError
from sysid_evo.kernels import (
    LANES,
    QUARTER,
    Layout,
    Predictor,
    lanes_less,
    load,
    load_quarter,
    padded,
    splat,
    store,
    view,
    where_less,
)
from sysid_evo.models.kernels.networks import own
from sysid_evo.models.kernels.stepping import copy
from sysid_evo.types import Array, BoolArray, IntArray, check_shape

WHOLE, TOP = 160, 15
"""Nodes up to which a whole tree is computed in every lane, and nodes of the top of a larger one."""
SIDE = 8
"""Children of a block, and the place of its thresholds: inputs, thresholds and children are eight numbers each."""
BLOCK = 3 * SIDE
EXACT_INTEGERS = 2**24

HEAD = Layout("n_carry", "n_control", "n_out", "n_trees", "pages", "place", "stack")
TREE = Layout("length", "singles", "pairs", "others", "root", "leaves", "output", "n_values")


@dataclass(frozen=True)
class Tree:
    """A binary tree of N nodes, parents before children, the root first.

    An inner node goes to ``left`` if input number ``feature`` is at most ``threshold``, else to ``right``; in a leaf
    ``left`` is -1. The ``values`` (N, n) of the leaf are added to the outputs from number ``output`` on. Inputs
    are rounded to single precision before they are compared. nan goes left.
    """

    feature: IntArray
    threshold: Array
    left: IntArray
    right: IntArray
    values: Array
    output: int = 0

    @property
    def inner(self) -> BoolArray:
        """Which nodes (N,) are no leaves."""
        found: BoolArray = self.left >= 0
        return found

    def at(self, output: int) -> Tree:
        """Return this tree with its values added to the outputs from number ``output`` on."""
        return replace(self, output=output)

    def check(self, n_inputs: int, n_out: int) -> None:
        """Raise `ShapeError` unless the arrays are those of a tree with these inputs and outputs."""
        count = len(self.left)
        for name in ("feature", "threshold", "right"):
            check_shape(f"tree: {name}", getattr(self, name), (count,))
        check_shape("tree: values", self.values, (count, None))
        inner, places = self.inner, np.arange(count)
        children = np.concatenate([self.left[inner], self.right[inner]])
        if (
            count == 0
            or not np.array_equal(np.sort(children), places[1:])
            or (children <= np.tile(places[inner], 2)).any()
        ):
            raise ShapeError(f"tree: expected {count} nodes that form one tree, parents before children")
        if ((self.feature[inner] < 0) | (self.feature[inner] >= n_inputs)).any() or np.isnan(
            self.threshold[inner]
        ).any():
            raise ShapeError(f"tree: expected thresholds of inputs 0 to {n_inputs - 1}, got others")
        if not 0 <= self.output <= n_out - self.values.shape[1] or not np.isfinite(self.values).all():
            raise ShapeError(f"tree: expected finite values of at most {n_out} outputs, got {self.values.shape[1]}")


def tree_predictor(trees: Sequence[Tree], start: Array, n_carry: int, n_control: int) -> Predictor:
    """Return a predictor of ``start`` (n_out,) plus the values of all ``trees``.

    Their inputs are ``n_carry`` rows of the carry, then ``n_control`` of the control. Raises `ShapeError` for arrays
    that are no trees.
    """
    inputs, n_out = n_carry + n_control, len(start)
    for tree in trees:
        tree.check(inputs, n_out)
    packs = [packed(tree) for tree in trees]
    pages = -(-inputs // QUARTER)
    place = inputs + QUARTER * pages
    parameters = HEAD.pack(
        start,
        *(parameters for parameters, _ in packs),
        n_carry=n_carry,
        n_control=n_control,
        n_out=n_out,
        n_trees=len(trees),
        pages=pages,
        place=place * LANES,
        stack=(place + 2) * LANES,
    )
    n_scratch = place + 2 + max((rows for _, rows in packs), default=0)
    return Predictor(summed_trees, parameters, n_scratch, reads=(n_carry, n_control), writes=n_out)


def packed(tree: Tree) -> tuple[Array, int]:
    """Return the parameters of one tree, and the number of rows in which its top is computed.

    The head is followed by the single leaves of the top; for each node above two leaves input, threshold and leaves;
    for each other node of the top input, threshold and the rows of its children, children first; then blocks; then
    values. A leaf of the top is its value if the tree has one output and no blocks, else a place: where its values or a
    block begin.
    """
    inner, direct = tree.inner, tree.values.shape[1] == 1
    top = inner if np.count_nonzero(inner) <= WHOLE else first_nodes(tree, TOP)
    ends = np.zeros(len(inner), dtype=bool)
    ends[[0, *tree.left[top], *tree.right[top]]] = True
    ends &= ~top
    above_two = ends[tree.left] & ends[tree.right]
    pairs, others = np.flatnonzero(top & above_two), np.flatnonzero(top & ~above_two)[::-1]
    children = np.stack([tree.left[others], tree.right[others]], axis=1).ravel()
    singles = children[ends[children]] if top.any() else np.zeros(1, dtype=np.int64)
    row = np.zeros(len(inner), dtype=np.int64)
    row[pairs], row[singles] = np.arange(len(pairs)), len(pairs) + np.arange(len(singles))
    for node in others:
        row[node] = row[tree.left[node]]

    first_block = -(-(TREE.size + len(singles) + 4 * (len(pairs) + len(others))) // QUARTER) * QUARTER
    below, blocks = blocks_of(tree, np.flatnonzero(ends & inner))
    direct &= len(below) == 0
    leaves, first_leaf = np.flatnonzero(~inner), first_block + blocks.size
    goal = tree.values[:, 0].copy()
    if not direct:
        goal[leaves] = first_leaf + tree.values.shape[1] * np.arange(len(leaves))
        goal[below] = first_block + BLOCK * np.arange(len(below))
        blocks[:, 2 * SIDE :] = goal[blocks[:, 2 * SIDE :].astype(np.int64)]
    threshold = between_singles(tree.threshold)
    columns = [
        np.stack([LANES * tree.feature, threshold, of_left, of_right], axis=1)
        for of_left, of_right in (
            (goal[tree.left], goal[tree.right]),
            (LANES * row[tree.left], LANES * row[tree.right]),
        )
    ]
    program = np.concatenate([goal[singles], columns[0][pairs].ravel(), columns[1][others].ravel()])
    parts = [np.pad(program, (0, first_block - TREE.size - len(program))), blocks.ravel()]
    parts += [] if direct else [padded(tree.values[leaves].ravel(), QUARTER)]
    size = TREE.size + sum(map(len, parts))
    if size >= EXACT_INTEGERS:
        raise InvalidArgument(f"tree: its compiled form takes {size} numbers and addresses {EXACT_INTEGERS}: prune it")
    parameters = TREE.pack(
        *parts,
        length=size,
        singles=len(singles),
        pairs=len(pairs),
        others=len(others),
        root=LANES * row[0],
        leaves=0 if direct else first_leaf,
        output=tree.output,
        n_values=tree.values.shape[1],
    )
    return parameters, len(pairs) + len(singles)


def first_nodes(tree: Tree, count: int) -> BoolArray:
    """Return which nodes (N,) are the first ``count`` inner ones from the root, level by level."""
    found, level = np.zeros(len(tree.left), dtype=bool), np.zeros(1, dtype=np.int64)
    while len(level) and count > 0:
        level = level[tree.left[level] >= 0][:count]
        found[level], count = True, count - len(level)
        level = np.stack([tree.left[level], tree.right[level]], axis=1).ravel()
    return found


def blocks_of(tree: Tree, roots: IntArray) -> tuple[IntArray, Array]:
    """Return the nodes (B,) at which blocks begin, and their blocks (B, 24), whose children are nodes of the tree.

    A block is numbered like a heap: the children of node i are 2 i and 2 i + 1, the root is 1. A leaf that is reached
    early is carried down to the left.
    """
    begun, blocks, threshold = [np.empty(0, dtype=np.int64)], [np.empty((0, BLOCK))], between_singles(tree.threshold)
    while len(roots):
        heap, block = np.zeros((len(roots), 2 * SIDE), dtype=np.int64), np.zeros((len(roots), BLOCK))
        heap[:, 1], block[:, SIDE] = roots, np.inf
        for place in range(1, SIDE):
            node = heap[:, place]
            inner = tree.left[node] >= 0
            heap[:, 2 * place] = np.where(inner, tree.left[node], node)
            heap[:, 2 * place + 1] = np.where(inner, tree.right[node], node)
            block[:, place] = np.where(inner, tree.feature[node], 0)
            block[:, SIDE + place] = np.where(inner, threshold[node], np.inf)
        children = heap[:, SIDE:]
        block[:, 2 * SIDE :] = children
        begun.append(roots)
        blocks.append(block)
        roots = children[tree.left[children] >= 0]
    return np.concatenate(begun), np.concatenate(blocks)


def between_singles(numbers: Array) -> Array:
    """Return thresholds for which x, rounded to single precision, is at most ``numbers`` if x itself is at most these.

    They lie just below the middle between the largest number of single precision that is not above the threshold, to
    which they are rounded in single precision, and the next one.
    """
    with np.errstate(over="ignore"):
        single = numbers.astype(np.float32)
        lower = np.where(single > numbers, np.nextafter(single, np.float32(-np.inf)), single)
        gap = np.nextafter(lower, np.float32(np.inf)).astype(np.float64) - lower
    return lower + np.where(np.isfinite(gap), (0.5 - 2.0**-20) * gap, 0.0)


def summed_trees(x, u, p, y, scratch):
    """Write the sum of all trees (a predictor, see `stepping`)."""
    n_carry, n_control, pages = int(p[HEAD.n_carry]), int(p[HEAD.n_control]), int(p[HEAD.pages])
    n_out, inputs = int(p[HEAD.n_out]), n_carry + n_control
    by_lane = view(scratch, inputs * LANES)
    place, stack = view(scratch, int(p[HEAD.place])), view(scratch, int(p[HEAD.stack]))
    copy(x, scratch, n_carry * LANES)
    copy(u, view(scratch, n_carry * LANES), n_control * LANES)
    for lane in range(LANES):
        for i in range(inputs):
            view(by_lane, lane * pages * QUARTER)[i] = view(scratch, i * LANES)[lane]
    for i in range(n_out):
        store(y, i * LANES, splat(p[HEAD.size + i]))
    tree = view(p, HEAD.size + n_out)
    for _ in range(int(p[HEAD.n_trees])):
        compute_top(scratch, tree, stack)
        found, total = view(stack, int(tree[TREE.root])), view(y, int(tree[TREE.output]) * LANES)
        if tree[TREE.leaves] == 0.0:
            store(total, 0, load(total, 0) + load(found, 0))
        else:
            copy(found, place, LANES)
            descend(by_lane, pages, tree, tree[TREE.leaves], place, view(place, LANES))
            n_values = int(tree[TREE.n_values])
            for lane in range(LANES):
                values = view(tree, int(place[lane]))
                for i in range(n_values):
                    view(total, i * LANES)[lane] += values[i]
        tree = view(tree, int(tree[TREE.length]))


def compute_top(inputs, tree, stack):
    """Write the row of the root: for each lane the value or the place of the end of the top that it reaches."""
    singles, pairs = int(tree[TREE.singles]), int(tree[TREE.pairs])
    node = view(tree, TREE.size)
    for i in range(singles):
        store(stack, (pairs + i) * LANES, splat(node[i]))
    node = view(node, singles)
    for i in range(pairs):
        store(stack, i * LANES, where_less(node[1], load(inputs, int(node[0])), node[3], node[2]))
        node = view(node, 4)
    for _ in range(int(tree[TREE.others])):
        left, right = int(node[2]), int(node[3])
        chosen = where_less(node[1], load(inputs, int(node[0])), load(stack, right), load(stack, left))
        store(stack, left, chosen)
        node = view(node, 4)


def descend(by_lane, pages, tree, leaves, place, active):
    """Move every lane from the end of the top to its leaf; ``active`` lists the lanes that are still at a block."""
    count = 0
    for lane in range(LANES):
        active[count] = float(lane)
        count += 1 if place[lane] < leaves else 0
    while count > 0:
        left = 0
        for i in range(count):
            number = active[i]
            lane = int(number)
            block = view(tree, int(place[lane]))
            seen = own(view(by_lane, lane * pages * QUARTER), load_quarter(block, 0), pages)
            bits = lanes_less(load_quarter(block, SIDE), seen)
            node = 2 + ((bits >> 1) & 1)
            node = 2 * node + ((bits >> node) & 1)
            node = 2 * node + ((bits >> node) & 1)
            child = view(block, SIDE)[node]
            place[lane], active[left] = child, number
            left += 1 if child < leaves else 0
        count = left
