"""A law written once gives the same results as arrays, in lanes of either width, and as a program."""

import math

import numpy as np
import pytest

from sysid_evo.controllers.program import SYMBOLS, elements, observation, program_of, remembered
from sysid_evo.engine.compiled.language import generate
from sysid_evo.errors import InvalidArgument
from sysid_evo.kernels import CONTROLLER, LANES, nearest, splat, view
from sysid_evo.laws import ROLLOUTS, ScalarLaw, read
from tests.fixtures.lanes import PRECISIONS, RTOL, call_block

ROWS = ("theta", "memory", "observation", "raw", "scratch")
TABLE = np.array([2.0, 1.5, -0.5])
INPUTS, OUTPUTS = 4, 2


def bends(value, most):
    return value - most if value >= most else value + 0.25 * nearest(value)


def everything(theta, memory, observation, raw, parameters, scratch):
    """Every construct once."""
    strength = math.exp(min(theta[0], 1.0))
    own = view(parameters, 1)
    for i in range(int(parameters[0])):
        seen = observation[i] * own[i]
        scratch[0] = -seen if observation[2] < seen else math.sin(seen)
        before = scratch[0]
        scratch[0] += 1.0
        side = 1.0 if before <= 0.5 else before
        if own[i] > 0.0:
            side += 0.125
        else:
            side -= 0.125
        raw[i] = strength * bends(side, 0.75) - max(abs(observation[3]), 0.2, before) / (1.0 + memory[i] * memory[i])
        memory[i] += math.sqrt(abs(scratch[0]))
    memory[2] = splat(own[1])


@pytest.fixture
def rollouts():
    """Parameters, memory and observations of 64 rollouts, one column each."""
    rng = np.random.default_rng(3)
    return [rng.normal(size=(n, LANES)) for n in (1, 3, INPUTS)]


@pytest.fixture
def expected(rollouts):
    """Results of the plain function for one rollout after the other: memory and outputs."""
    theta, memory, seen = (array.copy() for array in rollouts)
    raw = np.zeros((OUTPUTS, LANES))
    for lane in range(LANES):
        everything(theta[:, lane], memory[:, lane], seen[:, lane], raw[:, lane], TABLE, np.zeros(1))
    return memory, raw


def test_for_arrays_it_gives_the_same_and_leaves_what_it_reads_alone(rollouts, expected):
    theta, memory, seen = ([*array.copy()] for array in rollouts)
    raw = [0.0] * OUTPUTS
    read(everything, ROLLOUTS)(theta, memory, seen, raw, TABLE.tolist(), [0.0])
    np.testing.assert_allclose(np.stack(raw), expected[1], rtol=1e-12)
    np.testing.assert_allclose(np.stack([memory[0], memory[1]]), expected[0][:2], rtol=1e-12)
    assert memory[2] == TABLE[2]
    np.testing.assert_array_equal(theta, rollouts[0])
    np.testing.assert_array_equal(seen, rollouts[2])


@pytest.mark.parametrize("width", ["quarter", "row"])
@pytest.mark.parametrize("precision", PRECISIONS)
def test_in_lanes_of_either_width_it_gives_the_same(rollouts, expected, precision, width):
    blocks = [*rollouts, np.zeros((OUTPUTS, LANES)), TABLE, np.zeros((1, LANES))]
    law = ScalarLaw(everything, rows=ROWS, width=width)
    _, memory, _, raw, *_ = call_block(law, CONTROLLER, precision, blocks)
    np.testing.assert_allclose(memory, expected[0], rtol=RTOL[precision], atol=1e-6)
    np.testing.assert_allclose(raw, expected[1], rtol=RTOL[precision], atol=1e-5)


def test_as_a_program_it_gives_the_same_step_after_step(rollouts):
    for lane in range(8):
        theta, _, seen = (array[:, lane].copy() for array in rollouts)
        raw, after, before = [0.0] * OUTPUTS, elements(remembered("memory", 3)), np.zeros(3)
        read(everything, SYMBOLS)(theta.tolist(), after, elements(observation(INPUTS)), raw, TABLE.tolist(), [0.0])
        program = program_of(raw, {"memory": after})
        names = [statement.name for statement in program.statements]
        assert len(set(names)) == len(names)
        state = program.begin()
        for _ in range(3):
            outputs = np.zeros(OUTPUTS)
            everything(theta, before, seen, outputs, TABLE, np.zeros(1))
            found, state = program.run(seen, state)
            np.testing.assert_allclose(found, outputs, rtol=1e-12)
            np.testing.assert_allclose(state["memory"], before, rtol=1e-12)


def two_tests(theta, memory, observation, raw, parameters, scratch):
    raw[0] = 1.0 if observation[0] > 0.0 and theta[0] > 0.0 else 0.0


def whole_rows(theta, memory, observation, raw, parameters, scratch):
    raw[0] = abs(observation)[0]


def branches(theta, memory, observation, raw, parameters, scratch):
    if observation[0] > theta[0]:
        raw[0] = theta[0]


def cosine(theta, memory, observation, raw, parameters, scratch):
    raw[0] = math.cos(theta[0]) * math.cos(observation[0])


@pytest.mark.parametrize(
    "law, said",
    [
        (two_tests, r"law two_tests, line 2 of it: 'observation\[0\] > 0.0 and .*; write one comparison: < <= > >="),
        (
            whole_rows,
            r"law whole_rows, line 2 of it: 'observation' cannot be compiled for lanes; write observation\[i\]",
        ),
        (branches, r"law branches, line 2 of it: 'if observation\[0\] > theta\[0\]' cannot .*; write a if test else b"),
    ],
)
def test_what_has_no_form_for_lanes_is_refused_with_its_line_and_what_to_write(law, said):
    with pytest.raises(InvalidArgument, match=said):
        generate(ScalarLaw(law, rows=ROWS), CONTROLLER, "float32")


def test_a_function_that_other_languages_do_not_get_is_refused_unless_it_is_of_numbers():
    with pytest.raises(InvalidArgument, match="program: cos of an observation is not supported, only tanh, abs, round"):
        read(cosine, SYMBOLS)([0.3], [], elements(observation(1)), [0.0], [], [])


def test_a_program_does_not_branch_on_what_it_is_shown():
    with pytest.raises(InvalidArgument, match="a test of an observation must be written as 'a if test else b'"):
        read(branches, SYMBOLS)([0.3], [], elements(observation(1)), [0.0], [], [])
