"""Elementary functions for float32 kernels, of numbers or rows, without branches so that LLVM vectorises them.

The polynomials are minimax fits (computed by ``python -m tests.benchmarks.elementary``). Largest errors in float32:
`tanh` 4e-7 relative; `sin` and `cos` 2e-7 absolute for |x| up to 1000; `atan2` 4e-7 absolute; `exp` 3e-7 relative for
|x| up to 87. Float64 kernels use the mathematics library.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from sysid_evo.kernels import nearest, power_of_two, where_less


def tanh(x):
    """tanh x as x P(x^2) / Q(x^2) on [-9, 9]; outside it is +-1 in float32."""
    x = min(max(x, -9.0), 9.0)
    s = x * x
    p = 1.3354474790875319e-08
    p = p * s + 2.060894420096881e-05
    p = p * s + 0.003495579692220922
    p = p * s + 0.13381018557647706
    p = p * s + 0.999999979465841
    q = 7.776480728209807e-07
    q = q * s + 0.00032856210305355675
    q = q * s + 0.025876950154945063
    q = q * s + 0.46714334153918774
    q = q * s + 1.0
    return x * p / q


def sin(x):
    """sin x: subtract the nearest multiple k of pi in three parts, then an odd polynomial of the remainder."""
    k = (x * 0.3183098861837907 + 12582912.0) - 12582912.0
    r = x - k * 3.140625
    r = r - k * 0.0009670257568359375
    r = r - k * 6.2771141529083252e-07
    odd = k - 2.0 * ((k * 0.5 + 12582912.0) - 12582912.0)
    s = r * r
    p = 2.6057804916075227e-06
    p = p * s - 0.00019809602839907225
    p = p * s + 0.008333066245300178
    p = p * s - 0.1666665955040028
    return (r + r * (s * p)) * (1.0 - 2.0 * abs(odd))


def cos(x):
    """cos x = sin(pi / 2 + x), with argument reduction of x: k + 1/2 is the nearest odd half."""
    k = (x * 0.3183098861837907 - 0.5 + 12582912.0) - 12582912.0
    h = k + 0.5
    r = x - h * 3.140625
    r = r - h * 0.0009670257568359375
    r = r - h * 6.2771141529083252e-07
    odd = k - 2.0 * ((k * 0.5 + 12582912.0) - 12582912.0)
    s = r * r
    p = 2.6057804916075227e-06
    p = p * s - 0.00019809602839907225
    p = p * s + 0.008333066245300178
    p = p * s - 0.1666665955040028
    return (r + r * (s * p)) * (2.0 * abs(odd) - 1.0)


def atan2(y, x):
    """The angle of (x, y) in (-pi, pi]; 0 at the origin."""
    a, b = abs(x), abs(y)
    large = max(a, b)
    t = min(a, b) / max(large, 1e-30)
    s = t * t
    p = 0.002920688673898838
    p = p * s - 0.016367914902204173
    p = p * s + 0.043211841371351506
    p = p * s - 0.07552212798338084
    p = p * s + 0.10666004017298925
    p = p * s - 0.14211055166035205
    p = p * s + 0.19993772819352648
    p = p * s - 0.33333152735467547
    angle = t + t * (s * p)
    angle = where_less(a, b, 1.5707963267948966 - angle, angle)
    angle = where_less(x, 0.0, 3.141592653589793 - angle, angle)
    return where_less(y, 0.0, -angle, angle)


def exp(x):
    """exp x for |x| up to 87: 2^k times a polynomial of the remainder, k the nearest multiple of ln 2."""
    x = min(max(x, -87.0), 87.0)
    k = (x * 1.4426950408889634 + 12582912.0) - 12582912.0
    r = x - k * 0.693359375
    r = r + k * 0.00021219444005469057
    p = 0.0013843653646800566
    p = p * r + 0.008374155401957243
    p = p * r + 0.04166800203822359
    p = p * r + 0.16666431261573103
    p = p * r + 0.4999999420901864
    p = p * r + 1.0000000321652702
    return power_of_two(k) * (1.0 + p * r)


def nearest_single(x):
    """`nearest` in float32, for |x| up to 2^22."""
    return (x + 12582912.0) - 12582912.0


FLOAT32: dict[Callable[..., float], Callable[..., float]] = {
    math.tanh: tanh,
    math.sin: sin,
    math.cos: cos,
    math.atan2: atan2,
    math.exp: exp,
    nearest: nearest_single,
}
"""Replacements of `math` functions and of `nearest` in float32 kernels."""
