"""Plain functions of other packages, compiled, against the interpreter."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from sysid_evo.engine.compiled.plain import compile_plain
from sysid_evo.errors import InvalidArgument

LIMIT = 3
SPRING = SimpleNamespace(stiffness=2, damping=0.5, name="spring", end=SimpleNamespace(mass=4.0))


def clipped(value):
    """A function that another one calls."""
    return min(value, LIMIT)


def pull(state, law):
    forces = []
    forces.append(clipped(law.stiffness * state[0]))
    forces.append(law.damping * math.tanh(state[1]))
    return -(forces[0] + forces[1]) / law.end.mass


def oscillate(state, dt, steps):
    for _ in range(steps):
        state = state + dt * np.array([state[1], equations(list(state), spring)])
    return state


def test_compiled_functions_give_the_numbers_of_the_interpreter():
    compiled = compile_plain(oscillate, {"equations": pull, "spring": SPRING})
    state = np.array([2.5, -0.3])
    expected = state
    for _ in range(50):
        expected = expected + 0.01 * np.array([expected[1], pull(list(expected), SPRING)])
    np.testing.assert_array_equal(compiled(state, 0.01, 50), expected)
    np.testing.assert_array_equal(state, [2.5, -0.3])


def test_other_numbers_of_an_object_give_another_function():
    stiff = SimpleNamespace(**{**vars(SPRING), "stiffness": 3})
    soft, hard = (compile_plain(oscillate, {"equations": pull, "spring": one}) for one in (SPRING, stiff))
    state = np.array([0.5, 0.0])
    assert soft(state, 0.01, 5)[1] > hard(state, 0.01, 5)[1]


def named(state):
    return {"x": state}[KEY]


@pytest.mark.parametrize(
    ("function", "bindings", "message"),
    [
        (named, {"KEY": "x"}, "KEY: expected a function, a number or an object of numbers, got 'x'"),
        (math.sin, {}, "its source cannot be read"),
    ],
)
def test_what_cannot_be_compiled_is_refused_with_the_reason(function, bindings, message):
    with pytest.raises(InvalidArgument, match=message):
        compile_plain(function, bindings)
