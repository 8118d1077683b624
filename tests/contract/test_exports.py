"""A controller exported to C drives in the 20 Hz loop as the product itself does."""

import ctypes
import subprocess

import numpy as np
import pytest

from hardware.driving.trials import RobotRunner
from sysid_evo.controllers import Controller
from sysid_evo.controllers.controller import make_controller
from sysid_evo.errors import InvalidArgument
from sysid_evo.export import c_text, law_of
from sysid_evo.randomness import trial_seeds
from sysid_evo.registry import make_robot
from sysid_evo.tasks import PointToPoint
from tests.fixtures.exports import champion_of
from tests.system.rig.build import WARNINGS, compiler

REAL = ctypes.POINTER(ctypes.c_double)


class Compiled(Controller):
    """The step of a C file; its structure of memory is an array of numbers, which stands in the memory here."""

    n_parameters = 1

    def __init__(self, law, step):
        self.law, self.step = law, step
        self.n_memory = sum(value.size for value in law.program.remembered.values())

    def bind(self, n_observations, n_outputs):
        return self

    def act(self, parameters, memory, view):
        after, controls = memory.copy(), np.zeros((*view.observation.shape[:2], self.law.system.nu))
        for place in np.ndindex(*controls.shape[:2]):
            rows = (np.ascontiguousarray(array[place]) for array in (after, view.observation, controls))
            held = list(rows)
            self.step(*(row.ctypes.data_as(REAL) for row in held))
            after[place], controls[place] = held[0], held[2]
        return self.law.system.raw_of(controls), after


def test_the_c_file_drives_the_emulated_car_in_the_loop_as_the_product_does(tmp_path):
    robot = make_robot("emulated_car")
    champion = champion_of("recurrent", robot.system)
    law = law_of(champion)
    source, library = tmp_path / "law.c", tmp_path / "law.so"
    source.write_text(c_text(law))
    try:
        command = [compiler(), *WARNINGS, "-shared", "-fPIC", str(source), "-lm", "-o", str(library)]
    except InvalidArgument as error:
        pytest.skip(f"the C file is not compiled: {error}")
    subprocess.run(command, check=True)
    step = getattr(ctypes.CDLL(str(library)), f"{law.name}_step")
    task, seeds = PointToPoint(horizon=80), trial_seeds(1, 2)
    driven = [
        RobotRunner(robot, seed=1).run(controller, parameters, task, seeds).trajectories
        for controller, parameters in (
            (make_controller(champion.controller), champion.parameters[None]),
            (Compiled(law, step), np.zeros((1, 1))),
        )
    ]
    for ours, in_c in zip(*driven, strict=True):
        assert len(np.unique(ours.controls, axis=0)) > 2
        np.testing.assert_array_equal(in_c.controls, ours.controls)
        np.testing.assert_array_equal(in_c.states, ours.states)
