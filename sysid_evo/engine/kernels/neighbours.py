"""Exact nearest neighbour over lanes: one k-d tree of small buckets for each command.

For every query the squared distances to the boxes of all buckets are computed at once; the nearest
box is searched first, then only those nearer than the best point so far. The result is exact.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sysid_evo.arrays import Array, IntArray
from sysid_evo.engine.compiled.lanes import LANES, load_quarter, lowest, splat_quarter, store, view, where_less
from sysid_evo.engine.kernels.stepping import Predictor
from sysid_evo.errors import InvalidArgument

BUCKET = 16
FAR = 1e15
EXACT_INTEGERS = 2**24

N_STATES, N_EXACT, N_OUT, N_CONTROLS, CELLS, EXACT, MIDPOINTS = range(7)
GROUPS, BOXES, POINTS, VALUES, TABLE = range(5)


def neighbour_predictor(
    tables: Sequence[tuple[Array, Array]],
    serving: IntArray,
    midpoints: Sequence[Array],
    exact: Sequence[int],
    n_states: int,
) -> Predictor:
    """Return a predictor of the values of the nearest point under the same command.

    ``tables`` holds points (N, n_states + len(exact)) and their values (N, n_out) for each table;
    ``serving`` (cells,) is the table that answers for each command cell; a cell is counted like an
    odometer over the ``midpoints`` between the levels of each control; ``exact`` lists the controls
    that join the state in a query.
    """
    n_out = tables[0][1].shape[1]
    head = [n_states, len(exact), n_out, len(midpoints)]
    lookup = [float(i) for i in exact]
    for between in midpoints:
        lookup += [len(between), *between]
    where_cells = MIDPOINTS + len(lookup)
    where_tables = where_cells + len(serving)
    flat = [*head, where_cells, MIDPOINTS, *lookup, *(where_tables + TABLE * table for table in serving)]
    place = where_tables + TABLE * len(tables)
    blocks: list[Array] = []
    most = 0
    for points, values in tables:
        buckets = split(points, np.arange(len(points)))
        boxes, near, value = pack(points, values, buckets)
        flat += [boxes.shape[2] // BUCKET, place, place + boxes.size, place + boxes.size + near.size]
        place += boxes.size + near.size + value.size
        most = max(most, boxes.shape[2])
        blocks += [boxes.ravel(), near.ravel(), value.ravel()]
    if place >= EXACT_INTEGERS:
        raise InvalidArgument(
            f"nearest neighbour: its tables take {place} numbers; the compiled form addresses {EXACT_INTEGERS}: "
            "use fewer points"
        )
    parameters = np.concatenate([np.array(flat, dtype=np.float64), *blocks])
    return Predictor(neighbours, parameters, n_scratch=-(-(4 * BUCKET + most) // LANES))


def split(points: Array, rows: IntArray) -> list[IntArray]:
    """Halve ``rows`` along the widest side until every bucket holds at most 16 points."""
    if len(rows) <= BUCKET:
        return [rows]
    chosen = points[rows]
    side = int(np.argmax(np.ptp(chosen, axis=0)))
    full = BUCKET * max(1, round(len(rows) / 2 / BUCKET))
    half = full if full < len(rows) else len(rows) // 2
    order = rows[np.argsort(chosen[:, side], kind="stable")]
    return split(points, order[:half]) + split(points, order[half:])


def pack(points: Array, values: Array, buckets: Sequence[IntArray]) -> tuple[Array, Array, Array]:
    """Return boxes (sides, 2, buckets), points (buckets, sides, 16), values (buckets, 16, n_out).

    There are as many buckets as fill groups of 16; those without points stand far away.
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


def neighbours(x, u, p, y, scratch):
    """Write the values of the nearest point under the same command (a predictor, see `stepping`)."""
    n_states, n_exact, n_out = int(p[N_STATES]), int(p[N_EXACT]), int(p[N_OUT])
    n_controls, cells = int(p[N_CONTROLS]), view(p, int(p[CELLS]))
    sides = n_states + n_exact
    distance, nearest = scratch, view(scratch, BUCKET)
    column_group, bound = view(nearest, BUCKET), view(nearest, 2 * BUCKET)
    for lane in range(LANES):
        cell, place = 0, MIDPOINTS + n_exact
        for control in range(n_controls):
            count, level, value = int(p[place]), 0, u[control * LANES + lane]
            for i in range(count):
                level += 1 if p[place + 1 + i] < value else 0
            cell = cell * (count + 1) + level
            place += count + 1
        table = int(cells[cell])
        groups = int(p[table + GROUPS])
        boxes, points = view(p, int(p[table + BOXES])), view(p, int(p[table + POINTS]))
        values = view(p, int(p[table + VALUES]))
        for side in range(sides):
            if side < n_states:
                value = x[side * LANES + lane]
            else:
                value = u[int(p[MIDPOINTS + side - n_states]) * LANES + lane]
            box_distance(value, view(boxes, side * 2 * groups * BUCKET), bound, groups, side)
        least, which = load_quarter(bound, 0), splat_quarter(0.0)
        for group in range(1, groups):
            there = load_quarter(bound, group * BUCKET)
            which = where_less(there, least, splat_quarter(float(group)), which)
            least = where_less(there, least, there, least)
        store(nearest, 0, least)
        store(column_group, 0, which)
        closest, column = lowest(least), 0
        while column < BUCKET - 1 and nearest[column] != closest:  # the distance of a nan equals nothing
            column += 1
        first = int(column_group[column]) * BUCKET + column
        best, winner = search(x, u, p, n_states, sides, lane, points, first, distance, 1e30, 0)
        bound[first] = 1e30
        for column in range(BUCKET):
            if nearest[column] < best:
                for group in range(groups):
                    bucket = group * BUCKET + column
                    if bound[bucket] < best:
                        best, winner = search(x, u, p, n_states, sides, lane, points, bucket, distance, best, winner)
        for row in range(n_out):
            y[row * LANES + lane] = values[winner * n_out + row]


def box_distance(value, sides, bound, groups, side):
    """Add the squared distances along one side to the bounds of all boxes."""
    here, zero = splat_quarter(value), splat_quarter(0.0)
    for group in range(groups):
        below = load_quarter(sides, group * BUCKET) - here
        above = here - load_quarter(sides, (groups + group) * BUCKET)
        off = where_less(below, above, above, below)
        off = where_less(off, zero, zero, off)
        sofar = load_quarter(bound, group * BUCKET) if side > 0 else zero
        store(bound, group * BUCKET, sofar + off * off)


def search(x, u, p, n_states, sides, lane, points, bucket, distance, best, winner):
    """Look through one bucket; return the best squared distance and its point."""
    near = view(points, bucket * sides * BUCKET)
    total = splat_quarter(0.0)
    for side in range(sides):
        if side < n_states:
            value = x[side * LANES + lane]
        else:
            value = u[int(p[MIDPOINTS + side - n_states]) * LANES + lane]
        off = load_quarter(near, side * BUCKET) - splat_quarter(value)
        total = total + off * off
    closest = lowest(total)
    if closest < best:
        store(distance, 0, total)
        i = 0
        while distance[i] != closest:
            i += 1
        best, winner = closest, bucket * BUCKET + i
    return best, winner
