"""Exact nearest neighbour over lanes: one k-d tree of small buckets for each command.

For every query the squared distances to the boxes of all buckets are computed, sixteen at once, and
the nearest box is searched; the distance of its best point excludes most other boxes. The remaining boxes are
searched in a second pass over the block of queries, because branch mispredictions are cheaper there. The result is
exact.

For large tables the boxes of groups of sixteen buckets are tested first (`neighbours_of_many`), so that the cost of a
query hardly grows with the number of points.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sysid_evo.errors import InvalidArgument
from sysid_evo.kernels import (
    LANES,
    KernelSource,
    Layout,
    Predictor,
    first_lane,
    lane_of_lowest,
    lanes_less,
    load_quarter,
    lowest,
    pick,
    splat_quarter,
    store,
    view,
    where_less,
)
from sysid_evo.models.kernels.networks import check_cells, command_cells
from sysid_evo.models.kernels.stepping import copy
from sysid_evo.types import Array, IntArray, check_shape

BUCKET = 16
GROUPS_AT_ONCE = 4
ALL_BOXES = 2**BUCKET - 1
MANY = 4_000
"""In tables with more points, the boxes of groups are tested first."""
FAR = 1e15
EXACT_INTEGERS = 2**24

HEAD = Layout("n_states", "n_exact", "n_out", "n_controls", "cells", "most_groups")
TABLE = Layout("groups", "place")


def neighbour_predictor(
    tables: Sequence[tuple[Array, Array]],
    serving: IntArray,
    midpoints: Sequence[Array],
    exact: Sequence[int],
    n_states: int,
) -> Predictor:
    """Return a predictor of the values of the nearest point under the same command.

    ``tables`` holds points (N, n_states + len(exact)) and their values (N, n_out) for each table;
    ``serving`` (cells,) is the table for each command cell; cells are numbered like an odometer over the
    intervals between the ``midpoints`` of each control; ``exact`` lists the controls that are part of a query.
    """
    n_out = tables[0][1].shape[1]
    n_control = check_cells(serving, len(tables), midpoints, exact)
    for points, values in tables:
        check_shape("points", points, (None, n_states + len(exact)))
        check_shape("values", values, (len(points), n_out))
    least = numbers_taken([len(points) for points, _ in tables], n_states + len(exact), n_out)
    if least >= EXACT_INTEGERS:
        raise too_many(least)
    lookup = [float(i) for i in exact]
    for between in midpoints:
        lookup += [len(between), *between]
    where_cells = HEAD.size + len(lookup)
    where_tables = where_cells + len(serving)
    begin = place = -(-(where_tables + TABLE.size * len(tables)) // BUCKET) * BUCKET
    listed: list[Array] = []
    blocks: list[Array] = []
    many = max(len(points) for points, _ in tables) >= MANY
    whole = BUCKET * BUCKET if many else BUCKET
    packs = [packed(points, values, split(points, np.arange(len(points)), whole=whole)) for points, values in tables]
    most = max(near.shape[0] // BUCKET for _, near, _ in packs)
    for sides_first, near, value in packs:
        boxes = by_group(sides_first)
        listed.append(TABLE.pack(groups=len(boxes), place=place))
        around = by_group(boxes_around(sides_first)) if many else np.empty(0)
        place += boxes.size + near.size + value.size + around.size
        blocks += [boxes.ravel(), near.ravel(), value.ravel(), around.ravel()]
    if place >= EXACT_INTEGERS:
        raise too_many(place)
    head = HEAD.pack(
        lookup,
        [where_tables + TABLE.size * table for table in serving],
        *listed,
        n_states=n_states,
        n_exact=len(exact),
        n_out=n_out,
        n_controls=len(midpoints),
        cells=where_cells,
        most_groups=most,
    )
    parameters = np.concatenate([np.pad(head, (0, begin - len(head))), *blocks])
    sides = n_states + len(exact)
    room = -(-(most + BUCKET) // LANES) if many else -(-most * BUCKET // LANES) + most
    source = KernelSource(neighbours_of_many if many else neighbours, {"SIDES": sides})
    reads = (n_states, n_control)
    return Predictor(source, parameters, n_scratch=1 + sides + room, reads=reads, writes=n_out)


def too_many(numbers: int) -> InvalidArgument:
    """Return the error for tables with this many numbers."""
    return InvalidArgument(
        f"nearest neighbour: its tables take {numbers} numbers, {8 * numbers / 1e9:.2f} GB; the compiled form "
        f"addresses {EXACT_INTEGERS}: use fewer points"
    )


def numbers_taken(counts: Sequence[int], sides: int, n_out: int) -> int:
    """Return the least number of values in tables with ``counts`` points of ``sides`` coordinates, with padding."""
    return sum(-(-count // BUCKET**2) for count in counts) * BUCKET * (2 * sides + BUCKET * (sides + n_out))


def split(points: Array, rows: IntArray, *, whole: int = BUCKET) -> list[IntArray]:
    """Return buckets of at most 16 points, made by repeatedly halving ``rows`` along the widest side.

    As long as there are more than ``whole`` points, one half holds a multiple of ``whole``, so that the 16 buckets of a
    group are neighbours.
    """
    if len(rows) <= BUCKET:
        return [rows]
    chosen = points[rows]
    side = int(np.argmax(np.ptp(chosen, axis=0)))
    unit = whole if len(rows) > whole else BUCKET
    full = unit * max(1, round(len(rows) / 2 / unit))
    half = full if full < len(rows) else len(rows) // 2
    order = rows[np.argsort(chosen[:, side], kind="stable")]
    return split(points, order[:half], whole=whole) + split(points, order[half:], whole=whole)


def packed(points: Array, values: Array, buckets: Sequence[IntArray]) -> tuple[Array, Array, Array]:
    """Return boxes (sides, 2, buckets), points (buckets, sides, 16), values (buckets, 16, n_out).

    The number of buckets is a multiple of 16; empty ones are placed far away.
    """
    sides, count = points.shape[1], -(-len(buckets) // BUCKET) * BUCKET
    boxes = np.full((sides, 2, count), FAR)
    near = np.full((count, sides, BUCKET), FAR)
    value = np.zeros((count, BUCKET, values.shape[1]))
    for number, rows in enumerate(buckets):
        boxes[:, 0, number], boxes[:, 1, number] = points[rows].min(axis=0), points[rows].max(axis=0)
        near[number, :, : len(rows)] = points[rows].T
        value[number, : len(rows)] = values[rows]
    return boxes, near, value


def boxes_around(boxes: Array) -> Array:
    """Return the boxes (sides, 2, groups) around sixteen boxes each of (sides, 2, buckets), a multiple of 16.

    Boxes without points are ignored; padding boxes are placed far away.
    """
    sixteen = boxes.reshape(len(boxes), 2, -1, BUCKET)
    groups = sixteen.shape[2]
    around = np.full((len(boxes), 2, -(-groups // BUCKET) * BUCKET), FAR)
    around[:, 0, :groups] = sixteen[:, 0].min(axis=2)
    around[:, 1, :groups] = np.where(sixteen[:, 1] < FAR, sixteen[:, 1], -FAR).max(axis=2)
    return around


def by_group(boxes: Array) -> Array:
    """Return boxes (sides, 2, 16 groups) as (groups, sides, 2, 16)."""
    return boxes.reshape(boxes.shape[0], 2, -1, BUCKET).transpose(2, 0, 1, 3)


def neighbours(x, u, p, y, scratch):
    """Write the values of the nearest point under the same command (a predictor, see `stepping`).

    SIDES is a compile-time constant, because unrolled loops take half the time.
    """
    n_states, n_exact, n_out = int(p[HEAD.n_states]), int(p[HEAD.n_exact]), int(p[HEAD.n_out])
    cells, queries = scratch, view(scratch, LANES)
    command_cells(u, view(p, HEAD.size + n_exact), int(p[HEAD.n_controls]), cells)
    copy(x, queries, n_states * LANES)
    for row in range(n_exact):
        copy(view(u, int(p[HEAD.size + row]) * LANES), view(queries, (n_states + row) * LANES), LANES)
    serving = view(p, int(p[HEAD.cells]))
    marks = view(queries, SIDES * LANES)
    bounds = view(marks, int(p[HEAD.most_groups]) * LANES)
    for lane in range(LANES):
        table = view(p, int(serving[int(cells[lane])]))
        groups, boxes = int(table[TABLE.groups]), view(p, int(table[TABLE.place]))
        mark_boxes(view(queries, lane), SIDES, groups, boxes, bounds, view(marks, lane))
    for lane in range(LANES):
        table = view(p, int(serving[int(cells[lane])]))
        groups = int(table[TABLE.groups])
        points = view(p, int(table[TABLE.place]) + groups * SIDES * 2 * BUCKET)
        winner = nearest(view(queries, lane), SIDES, groups, points, view(marks, lane))
        value = view(points, groups * BUCKET * SIDES * BUCKET + winner * n_out)
        for row in range(n_out):
            y[row * LANES + lane] = value[row]


def neighbours_of_many(x, u, p, y, scratch):
    """Do the same as `neighbours` for large tables, where the boxes of groups are tested first."""
    n_states, n_exact, n_out = int(p[HEAD.n_states]), int(p[HEAD.n_exact]), int(p[HEAD.n_out])
    cells, queries = scratch, view(scratch, LANES)
    command_cells(u, view(p, HEAD.size + n_exact), int(p[HEAD.n_controls]), cells)
    copy(x, queries, n_states * LANES)
    for row in range(n_exact):
        copy(view(u, int(p[HEAD.size + row]) * LANES), view(queries, (n_states + row) * LANES), LANES)
    serving = view(p, int(p[HEAD.cells]))
    bounds = view(queries, SIDES * LANES)
    for lane in range(LANES):
        table = view(p, int(serving[int(cells[lane])]))
        groups, boxes = int(table[TABLE.groups]), view(p, int(table[TABLE.place]))
        points = view(boxes, groups * SIDES * 2 * BUCKET)
        values = view(points, groups * BUCKET * SIDES * BUCKET)
        around = view(values, groups * BUCKET * BUCKET * n_out)
        winner = nearest_of_many(view(queries, lane), SIDES, groups, boxes, points, around, bounds)
        value = view(values, winner * n_out)
        for row in range(n_out):
            y[row * LANES + lane] = value[row]


def nearest_of_many(query, sides, groups, boxes, points, around, bounds):
    """Return the index of the point nearest to a query: from groups to buckets to points.

    The first bucket is the nearest one of the nearest group; boxes farther away than its best point are skipped.
    """
    least, which = splat_quarter(FAR * FAR), splat_quarter(0.0)
    for start in range(0, groups, BUCKET):
        bound = box_distances(query, sides, view(around, start * sides * 2))
        store(bounds, start, bound)
        which = where_less(bound, least, splat_quarter(float(start)), which)
        least = where_less(bound, least, bound, least)
    column = lane_of_lowest(least)
    first = min(int(pick(which, column)) + column, groups - 1)
    first = first * BUCKET + lane_of_lowest(box_distances(query, sides, view(boxes, first * sides * 2 * BUCKET)))
    limit = splat_quarter(lowest(point_distances(query, sides, view(points, first * sides * BUCKET))))
    best, bucket = splat_quarter(FAR * FAR), splat_quarter(0.0)
    for start in range(0, groups, BUCKET):
        pending = ALL_BOXES - lanes_less(limit, load_quarter(bounds, start))
        while pending != 0:
            group = start + first_lane(pending)
            pending &= pending - 1
            near = 0
            if group < groups:
                bound = box_distances(query, sides, view(boxes, group * sides * 2 * BUCKET))
                near = ALL_BOXES - lanes_less(limit, bound)
            while near != 0:
                number = group * BUCKET + first_lane(near)
                near &= near - 1
                distance = point_distances(query, sides, view(points, number * sides * BUCKET))
                bucket = where_less(distance, best, splat_quarter(float(number)), bucket)
                best = where_less(distance, best, distance, best)
    column = lane_of_lowest(best)
    return int(pick(bucket, column)) * BUCKET + column


def mark_boxes(query, sides, groups, boxes, bounds, marks):
    """Write a bit mask for each group of boxes: those that may hold the nearest point."""
    least, which = splat_quarter(FAR * FAR), splat_quarter(0.0)
    for group in range(groups):
        bound = box_distances(query, sides, view(boxes, group * sides * 2 * BUCKET))
        store(bounds, group * BUCKET, bound)
        which = where_less(bound, least, splat_quarter(float(group)), which)
        least = where_less(bound, least, bound, least)
    column = lane_of_lowest(least)
    first = int(pick(which, column)) * BUCKET + column
    points = view(boxes, groups * sides * 2 * BUCKET)
    limit = splat_quarter(lowest(point_distances(query, sides, view(points, first * sides * BUCKET))))
    for group in range(groups):
        farther = lanes_less(limit, load_quarter(bounds, group * BUCKET))
        marks[group * LANES] = float(ALL_BOXES - farther)


def nearest(query, sides, groups, points, marks):
    """Return the index of the point nearest to a query in the marked buckets."""
    best, bucket = splat_quarter(FAR * FAR), splat_quarter(0.0)
    for start in range(0, groups, GROUPS_AT_ONCE):
        near = 0
        for group in range(start, min(start + GROUPS_AT_ONCE, groups)):
            near |= int(marks[group * LANES]) << ((group - start) * BUCKET)
        while near != 0:
            number = start * BUCKET + first_lane(near)
            near &= near - 1
            distance = point_distances(query, sides, view(points, number * sides * BUCKET))
            bucket = where_less(distance, best, splat_quarter(float(number)), bucket)
            best = where_less(distance, best, distance, best)
    column = lane_of_lowest(best)
    return int(pick(bucket, column)) * BUCKET + column


def box_distances(query, sides, box):
    """Return the squared distances from a query to sixteen boxes."""
    zero = splat_quarter(0.0)
    total = zero
    for side in range(sides):
        here = splat_quarter(query[side * LANES])
        below = load_quarter(box, side * 2 * BUCKET) - here
        above = here - load_quarter(box, (side * 2 + 1) * BUCKET)
        off = where_less(below, above, above, below)
        off = where_less(off, zero, zero, off)
        total = total + off * off
    return total


def point_distances(query, sides, near):
    """Return the squared distances from a query to the sixteen points of a bucket."""
    total = splat_quarter(0.0)
    for side in range(sides):
        off = load_quarter(near, side * BUCKET) - splat_quarter(query[side * LANES])
        total = total + off * off
    return total
