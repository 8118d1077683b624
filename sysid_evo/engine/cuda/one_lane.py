"""What lane functions mean where a row is a number: plain Python, as the simulator runs it and Numba reads it."""

from __future__ import annotations


def load(array, offset):
    """Return the number at ``offset``."""
    return array[offset]


def store(array, offset, row):
    """Write a number to ``offset``."""
    array[offset] = row


def splat(number):
    """Return the number."""
    return number


def where_less(a, b, x, y):
    """Return x if a < b, else y."""
    return x if a < b else y


def where_at_most(a, b, x, y):
    """Return x if a <= b, else y."""
    return x if a <= b else y


def where_bits(bits, x, y):
    """Return x if the only bit is set, else y."""
    return x if bits & 1 else y


def lanes_less(a, b):
    """Return 1 if a < b, else 0."""
    return 1 if a < b else 0


def lanes_at_most(a, b):
    """Return 1 if a <= b, else 0."""
    return 1 if a <= b else 0


def lanes_differ(a, b):
    """Return 1 if two numbers differ, else 0; what is no number differs from all."""
    return 1 if a != b else 0


def first_lane(bits):
    """Return the only lane."""
    return 0


def lane_of_lowest(row):
    """Return the only lane."""
    return 0


def pick(row, lane):
    """Return the number."""
    return row


load_quarter, splat_quarter, lowest = load, splat, splat
