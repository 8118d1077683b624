"""Compiled form of k_neighbours: a plane through the nearest points.

The search runs lane by lane through the buckets of a k-d tree, as in `sysid_evo.models.kernels.neighbours`; weights,
Gram matrix and Cholesky factor are computed for sixteen lanes at once. With many points the boxes of groups of sixteen
buckets are tested first.
"""

from __future__ import annotations

import math

import numpy as np

from sysid_evo.errors import ShapeError
from sysid_evo.kernels import (
    LANES,
    QUARTER,
    Layout,
    Predictor,
    first_lane,
    lanes_less,
    load_quarter,
    lowest,
    splat_quarter,
    store,
    view,
    where_less,
)
from sysid_evo.models.kernels.neighbours import BUCKET, FAR, boxes_around, packed, split
from sysid_evo.types import Array, check_shape

HEAD = Layout("n_carry", "n_control", "n_out", "count", "groups", "around", "ridge")
UNREACHED = FAR**2
FIRST = 2
MANY = 30_000
"""Number of points from which the boxes of groups are tested first."""


def plane_predictor(
    points: Array, values: Array, metric: Array, *, count: int, ridge: float, n_carry: int
) -> Predictor:
    """Return a predictor of the value at the query of the plane through ``count`` neighbours.

    ``points`` (N, n) are (carry, control) times ``metric`` (n,), ``values`` (N, n_out) the changes of the state there.
    """
    n, n_out, many = len(metric), values.shape[1], len(points) >= MANY
    check_shape("points", points, (None, n))
    check_shape("values", values, (len(points), n_out))
    if not (1 <= count <= len(points) and 0 <= n_carry <= n):
        raise ShapeError(f"neighbours: expected 1 to {len(points)} of them, one for each point, got {count}")
    whole = BUCKET * BUCKET if many else BUCKET
    boxes, near, value = packed(points, values, split(points, np.arange(len(points)), whole=whole))
    around = boxes_around(boxes) if many else np.empty((n, 2, 0))
    groups = boxes.shape[2] // BUCKET
    flat = HEAD.pack(
        metric,
        boxes,
        near,
        value,
        around,
        n_carry=n_carry,
        n_control=n - n_carry,
        n_out=n_out,
        count=count,
        groups=groups,
        around=around.shape[2] // BUCKET,
        ridge=ridge,
    )
    of_a_lane = n + 2 * count + 3 * BUCKET + (around if many else boxes).shape[2]
    of_a_quarter = n + count * (1 + n + n_out) + n_out + 2 * n + n * (n + 1) // 2
    rows = -(-(of_a_lane + of_a_quarter * QUARTER) // LANES)
    reads = (n_carry, n - n_carry)
    return Predictor(plane_through_neighbours, flat, n_scratch=rows, reads=reads, writes=n_out)


def plane_through_neighbours(x, u, p, y, scratch):
    """Write the change of the state (a predictor, see `sysid_evo.models.kernels.stepping`)."""
    n_carry, n_control, n_out = int(p[HEAD.n_carry]), int(p[HEAD.n_control]), int(p[HEAD.n_out])
    count, groups, around = int(p[HEAD.count]), int(p[HEAD.groups]), int(p[HEAD.around])
    n = n_carry + n_control
    metric, boxes = view(p, HEAD.size), view(p, HEAD.size + n)
    near = view(boxes, 2 * n * groups * BUCKET)
    values = view(near, n * groups * BUCKET * BUCKET)
    outer = view(values, n_out * groups * BUCKET * BUCKET)
    query, square, found = scratch, view(scratch, n), view(scratch, n + count)
    room = view(found, count)
    bound = view(room, 3 * BUCKET)
    queries = view(bound, (around if around > 0 else groups) * BUCKET)
    nearness = view(queries, n * QUARTER)
    offset = view(nearness, count * QUARTER)
    target = view(offset, count * n * QUARTER)
    work = view(target, count * n_out * QUARTER)
    for first in range(0, LANES, QUARTER):
        for i in range(n_carry):
            scale(view(x, i * LANES + first), metric[i], view(queries, i * QUARTER))
        for i in range(n_control):
            scale(view(u, i * LANES + first), metric[n_carry + i], view(queries, (n_carry + i) * QUARTER))
        for lane in range(QUARTER):
            for i in range(n):
                query[i] = queries[i * QUARTER + lane]
            if around > 0:
                nearest_of_many(query, n, boxes, near, outer, groups, around, count, bound, room, square, found)
            else:
                nearest_points(query, n, boxes, near, groups, count, bound, room, square, found)
            for k in range(count):
                winner = int(found[k])
                nearness[k * QUARTER + lane] = square[k]
                there = view(near, (winner // BUCKET) * n * BUCKET + winner % BUCKET)
                for i in range(n):
                    offset[(k * n + i) * QUARTER + lane] = there[i * BUCKET] - query[i]
                for row in range(n_out):
                    target[(k * n_out + row) * QUARTER + lane] = values[winner * n_out + row]
        weigh(nearness, count, work)
        plane(nearness, offset, target, n, n_out, count, p[HEAD.ridge], work)
        for row in range(n_out):
            within(view(target, row * QUARTER), count, n_out, view(work, row * QUARTER))
            store(view(y, row * LANES + first), 0, load_quarter(work, row * QUARTER))


def scale(row, factor, scaled):
    """Write a quarter of a row, scaled."""
    store(scaled, 0, load_quarter(row, 0) * splat_quarter(factor))


def nearest_points(query, n, boxes, near, groups, count, bound, room, square, found):
    """Write the squared distances of the ``count`` nearest points, nearest first, and their numbers."""
    forget(square, found, count)
    for side in range(n):
        box_distance(query[side], view(boxes, side * 2 * groups * BUCKET), bound, groups, side)
    for _ in range(FIRST + count // BUCKET):
        bucket = nearest_bucket(bound, groups, room)
        if bound[bucket] < square[count - 1]:
            look_through(query, n, near, bucket, count, room, square, found)
        bound[bucket] = UNREACHED
    for bucket in range(groups * BUCKET):
        if bound[bucket] < square[count - 1]:
            look_through(query, n, near, bucket, count, room, square, found)


def nearest_of_many(query, n, boxes, near, outer, groups, around, count, bound, room, square, found):
    """Do the same as `nearest_points`, from groups to buckets to points.

    The nearest group gives a bound on the distance; all groups within this bound are then searched.
    """
    for side in range(n):
        box_distance(query[side], view(outer, side * 2 * around * BUCKET), bound, around, side)
    forget(square, found, count)
    first = min(nearest_bucket(bound, around, room), groups - 1)
    look_through_group(query, n, boxes, near, groups, first, count, UNREACHED, room, square, found)
    limit = square[count - 1]
    forget(square, found, count)
    for start in range(0, around * BUCKET, BUCKET):
        reached = 65535 - lanes_less(splat_quarter(limit), load_quarter(bound, start))
        while reached != 0:
            group = start + first_lane(reached)
            reached &= reached - 1
            if group < groups:
                look_through_group(query, n, boxes, near, groups, group, count, limit, room, square, found)


def look_through_group(query, n, boxes, near, groups, group, count, limit, room, square, found):
    """Search the buckets of a group that are within ``limit`` and nearer than the last of the list."""
    zero = splat_quarter(0.0)
    total = zero
    for side in range(n):
        here, sides = splat_quarter(query[side]), view(boxes, side * 2 * groups * BUCKET)
        below = load_quarter(sides, group * BUCKET) - here
        above = here - load_quarter(sides, (groups + group) * BUCKET)
        off = where_less(below, above, above, below)
        off = where_less(off, zero, zero, off)
        total = total + off * off
    reached = 65535 - lanes_less(splat_quarter(limit), total)
    distances = view(room, BUCKET)
    store(distances, 0, total)
    while reached != 0:
        bucket = first_lane(reached)
        reached &= reached - 1
        if distances[bucket] < square[count - 1]:
            look_through(query, n, near, group * BUCKET + bucket, count, room, square, found)


def forget(square, found, count):
    """Empty the list of neighbours."""
    for k in range(count):
        square[k] = UNREACHED
        found[k] = 0.0


def nearest_bucket(bound, groups, room):
    """Return the bucket whose box is nearest."""
    nearest, column_group = view(room, BUCKET), view(room, 2 * BUCKET)
    least, which = load_quarter(bound, 0), splat_quarter(0.0)
    for group in range(1, groups):
        there = load_quarter(bound, group * BUCKET)
        which = where_less(there, least, splat_quarter(float(group)), which)
        least = where_less(there, least, there, least)
    store(nearest, 0, least)
    store(column_group, 0, which)
    closest, column = lowest(least), 0
    while column < BUCKET - 1 and nearest[column] != closest:  # a nan distance is equal to nothing
        column += 1
    return int(column_group[column]) * BUCKET + column


def look_through(query, n, near, bucket, count, distance, square, found):
    """Sort the points of a bucket that are nearer than the last of the list into it."""
    points = view(near, bucket * n * BUCKET)
    total = splat_quarter(0.0)
    for side in range(n):
        off = load_quarter(points, side * BUCKET) - splat_quarter(query[side])
        total = total + off * off
    if lowest(total) < square[count - 1]:
        store(distance, 0, total)
        for i in range(BUCKET):
            put_in(distance[i], float(bucket * BUCKET + i), count, square, found)


def put_in(here, number, count, square, found):
    """Insert a point into the list if it is nearer than its last, behind those of equal distance."""
    if here < square[count - 1]:
        place = count - 1
        while place > 0 and square[place - 1] > here:
            square[place] = square[place - 1]
            found[place] = found[place - 1]
            place -= 1
        square[place] = here
        found[place] = number


def weigh(nearness, count, work):
    """Replace squared distances by the roots of weights whose sum is one."""
    farthest, total = view(nearness, (count - 1) * QUARTER), view(work, QUARTER)
    for lane in range(QUARTER):
        reach = 1.05 * math.sqrt(farthest[lane]) + 1e-12
        work[lane] = 1.0 / (reach * reach)
        total[lane] = 0.0
    for k in range(count):
        here = view(nearness, k * QUARTER)
        for lane in range(QUARTER):
            root = 1.0 - here[lane] * work[lane]
            here[lane] = root
            total[lane] += root * root
    for lane in range(QUARTER):
        total[lane] = 1.0 / math.sqrt(total[lane])
    for k in range(count):
        here = view(nearness, k * QUARTER)
        for lane in range(QUARTER):
            here[lane] *= total[lane]


def plane(root, offset, target, n, n_out, count, ridge, work):
    """Write the value at the query of the weighted plane: mean - centre (A' W A + ridge)^-1 A' W (target - mean).

    A are the offsets from their centre; the symmetric system is solved once, for the centre.
    """
    mean, centre = work, view(work, n_out * QUARTER)
    inverse = view(centre, n * QUARTER)
    gram = view(inverse, n * QUARTER)
    for row in range(n_out):
        weighted_mean(root, view(target, row * QUARTER), count, n_out, view(mean, row * QUARTER))
    for i in range(n):
        column = view(offset, i * QUARTER)
        weighted_mean(root, column, count, n, view(centre, i * QUARTER))
        middle = load_quarter(centre, i * QUARTER)
        for k in range(count):
            away = load_quarter(column, k * n * QUARTER) - middle
            store(column, k * n * QUARTER, away * load_quarter(root, k * QUARTER))
        own = view(gram, i * (i + 1) // 2 * QUARTER)
        for j in range(i + 1):
            other = view(offset, j * QUARTER)
            total = splat_quarter(ridge if i == j else 0.0)
            for k in range(count):
                total = total + load_quarter(column, k * n * QUARTER) * load_quarter(other, k * n * QUARTER)
            store(own, j * QUARTER, total)
    solve(gram, centre, inverse, n)
    for k in range(count):
        share = splat_quarter(0.0)
        for i in range(n):
            share = share + load_quarter(offset, (k * n + i) * QUARTER) * load_quarter(centre, i * QUARTER)
        store(root, k * QUARTER, share * load_quarter(root, k * QUARTER))
    for row in range(n_out):
        middle = load_quarter(mean, row * QUARTER)
        total = middle
        for k in range(count):
            away = load_quarter(target, (k * n_out + row) * QUARTER) - middle
            total = total - load_quarter(root, k * QUARTER) * away
        store(mean, row * QUARTER, total)


def weighted_mean(root, column, count, stride, mean):
    """Write the mean of every ``stride``-th row, weighted by the squares of ``root``."""
    total = splat_quarter(0.0)
    for k in range(count):
        weight = load_quarter(root, k * QUARTER)
        total = total + weight * weight * load_quarter(column, k * stride * QUARTER)
    store(mean, 0, total)


def solve(gram, x, inverse, n):
    """Solve gram y = x in place by Cholesky's factor L, whose rows replace those of the lower triangle."""
    for i in range(n):
        own = view(gram, i * (i + 1) // 2 * QUARTER)
        total = load_quarter(x, i * QUARTER)
        for j in range(i + 1):
            other = view(gram, j * (j + 1) // 2 * QUARTER)
            rest = load_quarter(own, j * QUARTER)
            for m in range(j):
                rest = rest - load_quarter(own, m * QUARTER) * load_quarter(other, m * QUARTER)
            if j < i:
                rest = rest * load_quarter(inverse, j * QUARTER)
                total = total - rest * load_quarter(x, j * QUARTER)
            store(own, j * QUARTER, rest)
        pivot, diagonal = view(own, i * QUARTER), view(inverse, i * QUARTER)
        for lane in range(QUARTER):
            diagonal[lane] = 1.0 / math.sqrt(pivot[lane])
        store(x, i * QUARTER, total * load_quarter(inverse, i * QUARTER))
    for i in range(n - 1, -1, -1):
        total = load_quarter(x, i * QUARTER)
        for j in range(i + 1, n):
            below = view(gram, (j * (j + 1) // 2 + i) * QUARTER)
            total = total - load_quarter(below, 0) * load_quarter(x, j * QUARTER)
        store(x, i * QUARTER, total * load_quarter(inverse, i * QUARTER))


def within(target, count, stride, value):
    """Clip a value to the range of the neighbours' values."""
    low, high = load_quarter(target, 0), load_quarter(target, 0)
    for k in range(1, count):
        there = load_quarter(target, k * stride * QUARTER)
        low = where_less(there, low, there, low)
        high = where_less(high, there, there, high)
    here = load_quarter(value, 0)
    here = where_less(here, low, low, here)
    store(value, 0, where_less(high, here, high, here))


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
