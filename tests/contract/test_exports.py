"""One controller in two languages: each file gives the same controls, documents its inputs, and checks itself."""

import copy
import ctypes
import math
import re
import subprocess
import sys
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from hardware.driving.trials import RobotRunner
from hardware.robot import find_robot
from sysid_evo import make_controller, make_task
from sysid_evo.controllers import Controller
from sysid_evo.errors import InvalidArgument
from sysid_evo.evolution import Champion
from sysid_evo.evolution.champion import save_champion
from sysid_evo.export import c_text, exported_controller, python_text
from sysid_evo.models import save_model
from sysid_evo.models.base import make_model
from sysid_evo.randomness import trial_seeds
from sysid_evo.registry import controllers, make_robot
from sysid_evo.system import Channel, System
from sysid_evo.tasks import PointToPoint
from sysid_evo.testing.examples import continuous_car, switched_car
from tests.fixtures.exports import SPECS, champion_of, decided, stepped, wandering, write
from tests.system.rig.build import WARNINGS, compiler

SAMPLES = {"python": 3000, "c": 3000}
REAL = {"double": ctypes.c_double, "float": ctypes.c_float}
CLOCK = System(
    states=(Channel("hour", "h", period=24.0, neutral=6.0), Channel("level", "m", low=-1.0, high=3.0), Channel("flow")),
    controls=(Channel("valve", low=0.0, high=1.0),),
    dt=1.0,
)


@cache
def cc():
    try:
        return compiler()
    except InvalidArgument as error:
        return pytest.skip(f"the C file is not compiled: {error}")


def loaded(text):
    """Return what the text of a Python file defines."""
    module = {"__name__": "exported"}
    exec(compile(text, "exported.py", "exec"), module)
    return module


def library(law, real, folder):
    """Return the compiled C file of ``law``; a warning is an error."""
    source, compiled = write(c_text(law, real), folder / "law.c"), folder / "law.so"
    subprocess.run([cc(), *WARNINGS, "-Werror", "-O2", "-shared", "-fPIC", source, "-lm", "-o", compiled], check=True)
    return ctypes.CDLL(str(compiled))


def python_step(law, real, folder):
    return loaded(python_text(law))["Controller"]().step


def c_step(law, real, folder):
    functions, memory = library(law, real, folder), ctypes.create_string_buffer(4096)
    control = (REAL[real] * law.system.nu)()
    getattr(functions, f"{law.name}_reset")(memory)

    def decide(row):
        getattr(functions, f"{law.name}_step")(memory, (REAL[real] * len(row))(*row), control)
        return np.array(control)

    return decide


STEP = {"python": python_step, "c": c_step}


@cache
def commands(spec):
    return decided(champion_of(spec), wandering(max(SAMPLES.values())))


@pytest.mark.parametrize("language", ["python", "c"])
@pytest.mark.parametrize("spec", SPECS)
def test_the_file_gives_the_commands_of_the_product_over_thousands_of_samples(spec, language, tmp_path):
    seen, expected = wandering(max(SAMPLES.values())), commands(spec)
    assert len(np.unique(expected, axis=0)) > 2
    step, samples = STEP[language](exported_controller(champion_of(spec)), "double", tmp_path), SAMPLES[language]
    np.testing.assert_array_equal(stepped(step, seen[:samples]), expected[:samples])


@pytest.mark.parametrize(
    ("language", "real", "off", "specs"),
    [
        ("python", "double", 1e-12, (*SPECS, "constant")),
        ("c", "float", 2e-3, (*SPECS, "constant")),
    ],
)
def test_continuous_controls_are_scaled_as_the_product_does_but_for_rounding(language, real, off, specs, tmp_path):
    seen = wandering(200)
    for number, spec in enumerate(specs):  # a library is loaded once by its path
        champion, folder = champion_of(spec, continuous_car()), tmp_path / str(number)
        folder.mkdir()
        found = stepped(STEP[language](exported_controller(champion), real, folder), seen)
        np.testing.assert_allclose(found, decided(champion, seen), atol=off, err_msg=spec)


def test_reset_forgets_what_was_seen():
    controller = loaded(python_text(exported_controller(champion_of("recurrent", continuous_car()))))["Controller"]()
    first = stepped(controller.step, wandering(5))
    assert not np.array_equal(stepped(controller.step, wandering(5)), first)
    controller.reset()
    np.testing.assert_array_equal(stepped(controller.step, wandering(5)), first)


class Compiled(Controller):
    """The step of a C file; its memory structure is an array of numbers, held in the memory argument here."""

    n_parameters = 1

    def __init__(self, law, step):
        self.law, self.step = law, step
        self.n_memory = sum(value.size for value in law.program.remembered.values())

    def bind(self, n_observations, n_outputs):
        return self

    def act(self, parameters, memory, view):
        after, controls = memory.copy(), np.zeros((*view.observation.shape[:2], self.law.system.nu))
        for place in np.ndindex(*controls.shape[:2]):
            held = [np.ascontiguousarray(array[place]) for array in (after, view.observation, controls)]
            self.step(*(row.ctypes.data_as(ctypes.POINTER(ctypes.c_double)) for row in held))
            after[place], controls[place] = held[0], held[2]
        return self.law.system.raw_output(controls), after


def test_the_c_file_drives_the_emulated_car_in_the_loop_as_the_product_does(tmp_path):
    robot = make_robot("emulated_car")
    champion = champion_of("recurrent", robot.system)
    law = exported_controller(champion)
    step = getattr(library(law, "double", tmp_path), f"{law.name}_step")
    task = PointToPoint(horizon=80)
    ours, in_c = (
        RobotRunner(robot, seed=1).bind(controller, task)(parameters, trial_seeds(1, 2)).trajectories
        for controller, parameters in (
            (make_controller(champion.controller), champion.parameters[None]),
            (Compiled(law, step), np.zeros((1, 1))),
        )
    )
    for expected, found in zip(ours, in_c, strict=True):
        assert len(np.unique(expected.controls, axis=0)) > 2
        np.testing.assert_array_equal(found.controls, expected.controls)
        np.testing.assert_array_equal(found.states, expected.states)


def test_the_python_file_checks_itself_without_this_package(tmp_path):
    text = python_text(exported_controller(champion_of("pid")))
    assert "sysid_evo" not in text
    for source, code, said in ((text, 0, "ok: 20 samples\n"), (text.replace("raw = np", "raw = -np"), 1, "")):
        file = write(source, tmp_path / "law.py")
        done = subprocess.run([sys.executable, "-I", file], capture_output=True, text=True, check=False)
        assert (done.returncode, done.stdout) == (code, said)


@pytest.mark.parametrize("real", REAL)
def test_the_c_file_checks_itself(real, tmp_path):
    law = exported_controller(champion_of("recurrent"))
    text = c_text(law, real, "law.c")
    assert f"cc -std=c99 -DTEST_{law.name.upper()} law.c -lm -o check && ./check" in text
    for source, code in ((text, 0), (text.replace("? ", "? -", 1), 1)):
        file = write(source, tmp_path / "law.c")
        command = [cc(), "-std=c99", f"-DTEST_{law.name.upper()}", file, "-lm", "-o", tmp_path / "check"]
        subprocess.run(command, check=True)
        assert subprocess.run([tmp_path / "check"], capture_output=True, check=False).returncode == code


def test_the_c_file_allocates_nothing():
    for spec in SPECS:
        text = c_text(exported_controller(champion_of(spec)))
        assert "alloc" not in text.replace("no allocation", "")
        assert text.count("#include") == 3  # math.h, stddef.h, and stdio.h of its test


def test_the_python_file_names_what_it_takes_and_gives_with_units():
    text = python_text(exported_controller(champion_of("recurrent")))
    module = loaded(text)
    assert module["OBSERVATIONS"] == ("bias", "forward_speed", "yaw_rate", "waypoint_angle", "waypoint_distance")
    assert module["CONTROLS"] == ("drive", "steer")
    assert module["DT"] == 0.05
    for line in ("2  yaw_rate           rad/s", "0  drive  -, one of -1, 0, 1", "evolved against a, b (min)"):
        assert line in text


def test_a_name_that_would_end_the_remark_does_not():
    law = exported_controller(champion_of("linear", name='a"""\\ */ b'))
    assert law.name == "a_b" or law.name.isidentifier()
    assert "Controller" in loaded(python_text(law))


def test_units_and_names_end_no_comment_and_add_no_line_of_code():
    hostile = '*/ #error out */\nraise SystemExit("out")\r\x0craise SystemExit\x1b[2J"""'
    system = switched_car()
    channels = tuple(replace(channel, unit=hostile) for channel in system.controls)
    law = exported_controller(champion_of("linear", replace(system, controls=channels), name=hostile))
    assert "Controller" in loaded(python_text(law))
    assert "#error" not in re.sub(r"/\*.*?\*/", "", c_text(law), flags=re.DOTALL)
    assert "#error" in c_text(law)
    assert "\x1b" not in python_text(law) + c_text(law)


@pytest.mark.parametrize(
    ("spec", "robot"),
    [
        ("set_point(channels=[temperature], low=30, high=60)", "thermal"),
        ("set_point(channels=[hour, level, flow], tolerance=[1, 0.5, 0.1], low=0, high=2)", "clock"),
        ("track_reference(channels=angular_speed)", "pendulum"),
        ("swing_up", "pendulum"),
        ("environment(id='CartPole-v1')", "gymnasium(id='CartPole-v1')"),
        ("environment(id='MountainCar-v0')", "gymnasium(id='MountainCar-v0')"),
    ],
)
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
        formula = formulas.get(channel.name, channel.name).partition(",")[0]
        target = next((targets[name] for name in targets if f"{name}_error" in channel.name), math.nan)
        known = {**dict(zip(system.state_names, state[0], strict=True)), "bias": 1.0, "target": target}
        plain = re.sub(rf"(\d) (?:{units})(?=\W|$)", r"\1", formula) if units else formula
        plain = re.sub(r"^(sin|cos)\(([\d.]+) (.*)\)$", r"\1(\2 * \3)", plain)
        value = eval(plain, {"sin": math.sin, "cos": math.cos}, known)
        assert value == pytest.approx(shown[0, place], abs=1e-8), f"{channel.name}: {formula}"


def test_the_formulas_are_in_the_head_of_the_file():
    system, task = find_robot("thermal").system, "set_point(low=30, high=60, tolerance=1)"
    n = make_controller("linear").bind_to(make_task(task).bind(system)).n_parameters
    champion = Champion(
        "warm", np.ones(n), ("a",), "min", 0, np.zeros((1, 3)), task=task, controller="linear", system=system
    )
    text = python_text(exported_controller(champion))
    assert "1  temperature        (temperature - 50 degC) / (50 degC)\n" in text
    assert "2  temperature_error  (target - temperature) / (10 degC)\n" in text
    assert "0  heater  -, 0 to 1\n" in text


class Bare(Controller):
    """A controller without a program."""

    def bind(self, n_observations, n_outputs):
        bound = copy.copy(self)
        bound.n_parameters, bound.n_memory, bound.n_outputs = 1, 0, n_outputs
        return bound

    def act(self, parameters, memory, view):
        return np.zeros((*view.observation.shape[:2], self.n_outputs)), memory


def test_what_has_no_program_is_refused_with_what_to_do_instead(register, car_data, tmp_path):
    register(controllers, "bare", Bare)
    with pytest.raises(InvalidArgument, match=r"'bare' cannot be exported: .* feed_forward, constant"):
        exported_controller(champion_of("bare"))
    file = save_model(make_model("linear").fit(car_data), tmp_path / "body")
    with pytest.raises(InvalidArgument, match=r"'predictive' cannot be exported: .* Evolve a network in that model"):
        exported_controller(champion_of(f"predictive(model={str(file)!r}, horizon=3)"))
    with pytest.raises(InvalidArgument, match="is a human driver; only controllers can be exported"):
        exported_controller(replace(champion_of("recurrent"), system=None))


@pytest.fixture
def stored(tmp_path):
    return save_champion(champion_of("recurrent"), tmp_path / "champion")


@pytest.mark.parametrize(("to", "suffix"), [("python", ".py"), ("c", ".c")])
def test_the_command_names_the_file_and_how_to_use_it_and_overwrites_none(to, suffix, stored, tmp_path, call):
    done = call("export", stored, "--to", to)
    assert done.code == 0
    assert f"best of a+b written to best_of_a_b{suffix}" in done.stdout
    assert "every 0.05 s, from bias, forward_speed (m/s)" in done.stdout
    assert (tmp_path / f"best_of_a_b{suffix}").stat().st_size > 500
    again = call("export", stored, "--to", to)
    assert again.code == 2
    assert again.says(f"best_of_a_b{suffix} exists already")


def test_it_may_be_called_otherwise_in_its_file(stored, tmp_path, call):
    assert "written to controller.c" in call("export", stored, "--to", "c", "--name", "controller").stdout
    text = (tmp_path / "controller.c").read_text()
    assert "void controller_step(controller_memory *memory" in text
    assert "controller 'best of a+b'" in text
    assert "best_of_a_b" not in text


def test_wrong_words_are_refused_with_those_that_would_do(stored, call):
    assert call("export", stored, "--to", "java").says("--to: expected python, c, got 'java'")
    wrong = call("export", stored, "--to", "c", "--real", "half")
    assert (wrong.code, wrong.says("--real: expected double or float, got 'half'")) == (2, True)
