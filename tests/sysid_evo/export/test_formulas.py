"""What an exported controller says of its observations is what the task shows."""

import math
import re

import numpy as np
import pytest

from hardware.robot import find_robot
from sysid_evo import make_controller, make_task
from sysid_evo.evolution import Champion
from sysid_evo.export import law_of, python_text
from sysid_evo.system import Channel, System

CLOCK = System(
    states=(Channel("hour", "h", period=24.0, neutral=6.0), Channel("level", "m", low=-1.0, high=3.0), Channel("flow")),
    controls=(Channel("valve", low=0.0, high=1.0),),
    dt=1.0,
)
CASES = (
    ("set_point(channels=[temperature], low=30, high=60)", "thermal"),
    ("set_point(channels=[hour, level, flow], tolerance=[1, 0.5, 0.1], low=0, high=2)", "clock"),
    ("track_reference(channels=angular_speed)", "pendulum"),
    ("swing_up", "pendulum"),
    ("environment(id='CartPole-v1')", "gymnasium(id='CartPole-v1')"),
    ("environment(id='MountainCar-v0')", "gymnasium(id='MountainCar-v0')"),
)


@pytest.mark.parametrize("spec, robot", CASES, ids=[spec for spec, _ in CASES])
def test_each_formula_gives_what_the_task_shows(spec, robot):
    system = CLOCK if robot == "clock" else find_robot(robot).system
    task = make_task(spec).bind(system)
    trials = task.begin(np.arange(3, dtype=np.uint64))
    state = trials.state + np.random.default_rng(1).uniform(-2.0, 2.0, trials.state.shape)
    shown = task.observe(trials, state)
    targets = {target.channel.name: target.values[0] for target in task.scene(trials, 0).targets}
    formulas = task.formulas()
    units = "|".join(re.escape(channel.unit) for channel in system.states if channel.unit)
    assert set(formulas) <= {channel.name for channel in task.observations}
    for place, channel in enumerate(task.observations):
        formula = formulas.get(channel.name, channel.name)
        known = dict(zip(system.state_names, state[0], strict=True))
        known["bias"] = 1.0
        known["target"] = next((targets[name] for name in targets if f"{name}_error" in channel.name), math.nan)
        formula = formula.partition(",")[0]
        plain = re.sub(rf"(\d) (?:{units})(?=\W|$)", r"\1", formula) if units else formula
        plain = re.sub(r"^(sin|cos)\(([\d.]+) (.*)\)$", r"\1(\2 * \3)", plain)
        value = eval(plain, {"sin": math.sin, "cos": math.cos}, known)
        assert value == pytest.approx(shown[0, place], abs=1e-8), f"{channel.name}: {formula}"


def test_the_formulas_stand_in_the_head_of_the_file():
    system, task = find_robot("thermal").system, "set_point(low=30, high=60, tolerance=1)"
    n = make_controller("linear").bind_to(make_task(task).bind(system)).n_parameters
    champion = Champion(
        "warm", np.ones(n), ("a",), "min", 0, np.zeros((1, 3)), task=task, controller="linear", system=system
    )
    text = python_text(law_of(champion))
    assert "1  temperature        (temperature - 50 degC) / (50 degC)\n" in text
    assert "2  temperature_error  (target - temperature) / (10 degC)\n" in text
    assert "0  heater  -, 0 to 1\n" in text
