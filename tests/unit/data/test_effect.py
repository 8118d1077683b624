"""Stretches without an effect of commands are left out where the same commands move the body elsewhere."""

import numpy as np
import pytest

from evaluation.cells.data import HoldOut
from sysid_evo.data import Dataset
from sysid_evo.data.response import without_dead_stretches
from sysid_evo.motion import PlanarBody
from sysid_evo.system import Channel, System

DT = 0.05
CAR = System(
    (Channel("forward", "m/s"), Channel("yaw_rate", "rad/s")),
    (Channel("drive", low=-1.0, high=1.0), Channel("steer", low=-1.0, high=1.0)),
    DT,
    motion=PlanarBody("forward", None, "yaw_rate"),
)


def driven(seed, blocked=(), *, drive=(-1.0, 0.0, 1.0), seconds=20.0):
    """Return states and controls of a car without reverse, ``blocked`` from the first to the second step."""
    rng, steps = np.random.default_rng(seed), round(seconds / DT)
    controls = np.repeat(np.stack([rng.choice(drive, steps), rng.uniform(-1.0, 1.0, steps)], axis=1), 40, axis=0)[
        :steps
    ]
    controls[-40:, 0] = 0.0
    states = np.zeros((steps + 1, 2))
    for k, (push, turn) in enumerate(controls):
        speed = max(0.0, states[k, 0] + DT * (3.0 * push - 2.0 * states[k, 0]))
        free = not (blocked and blocked[0] <= k < blocked[1])
        states[k + 1] = (speed, 2.0 * speed * turn) if free else (0.0, 0.0)
    return states + 0.002 * rng.standard_normal(states.shape), controls


def recording(*episodes, system=CAR):
    states, controls = zip(*episodes, strict=True)
    return Dataset.from_arrays(system, list(states), list(controls))


FREE = [driven(seed) for seed in range(6)]
ALWAYS = (0, 400)


def test_an_episode_under_commands_that_move_the_body_in_others_is_left_out_with_a_note():
    whole = recording(*FREE, driven(9, ALWAYS, drive=(1.0, 0.0)))
    found = without_dead_stretches(whole)
    assert found.names == whole.names[:-1]
    assert found.notes[-1].startswith(f"20 s of 140 s are left out, in {whole.names[-1]}: the robot did not move")


def test_a_stop_within_an_episode_that_moves_otherwise_is_kept():
    whole = recording(*FREE, driven(9, (200, 400), drive=(1.0,), seconds=30.0))
    assert without_dead_stretches(whole) is whole


@pytest.mark.parametrize("drive", [(-1.0,), (0.0,), (0.0, -1.0)])
def test_rest_without_a_command_or_under_one_that_never_moves_the_body_is_kept(drive):
    whole = recording(*FREE, driven(9, drive=drive))
    assert without_dead_stretches(whole) is whole


def test_nothing_is_left_out_where_all_episodes_move_or_none_does_or_the_system_is_no_body():
    blocked = [driven(seed, ALWAYS) for seed in range(3)]
    for whole in (recording(*FREE), recording(*blocked)):
        assert without_dead_stretches(whole) is whole
    plain = System(CAR.states, CAR.controls, DT)
    whole = recording(*FREE, driven(9, ALWAYS, drive=(1.0, 0.0)), system=plain)
    assert without_dead_stretches(whole) is whole


def test_a_comparison_leaves_them_out_before_data_are_held_out_unless_test_episodes_are_named():
    whole = recording(*FREE, driven(9, ALWAYS, drive=(1.0, 0.0)))
    parts = HoldOut(None, 0.25).of(whole)
    assert parts.training.n_steps + parts.test.n_steps <= 6 * 400
    assert any("are left out" in note for note in parts.training.notes)
    named = HoldOut((whole.names[0],), 0.0).of(whole)
    assert named.training.n_steps + named.test.n_steps == 7 * 400
