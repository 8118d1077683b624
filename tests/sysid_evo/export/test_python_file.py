"""Controllers as Python files."""

from __future__ import annotations

import re
import subprocess
import sys
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from sysid_evo.export import c_text, law_of, python_text
from sysid_evo.testing.examples import continuous_car, switched_car
from tests.fixtures.exports import SPECS, champion_of, decided, stepped, wandering, write


def loaded(text):
    """Return what the text of a file defines."""
    module: dict[str, Any] = {"__name__": "exported"}
    exec(compile(text, "exported.py", "exec"), module)
    return module


@pytest.mark.parametrize("spec", SPECS)
def test_the_python_file_gives_the_commands_of_the_product_over_ten_thousand_samples(spec):
    champion, seen = champion_of(spec), wandering(10_000)
    controller = loaded(python_text(law_of(champion)))["Controller"]()
    expected = decided(champion, seen)
    assert len(np.unique(expected, axis=0)) > 2
    np.testing.assert_array_equal(stepped(controller.step, seen), expected)


@pytest.mark.parametrize("spec", SPECS)
def test_continuous_controls_are_scaled_as_the_product_does(spec):
    champion, seen = champion_of(spec, continuous_car()), wandering(200)
    controller = loaded(python_text(law_of(champion)))["Controller"]()
    np.testing.assert_allclose(stepped(controller.step, seen), decided(champion, seen), atol=1e-12)


def test_reset_forgets_what_was_seen():
    controller = loaded(python_text(law_of(champion_of("recurrent", continuous_car()))))["Controller"]()
    first = stepped(controller.step, wandering(5))
    assert not np.array_equal(stepped(controller.step, wandering(5)), first)
    controller.reset()
    np.testing.assert_array_equal(stepped(controller.step, wandering(5)), first)


def test_the_file_names_what_it_takes_and_gives_with_units():
    text = python_text(law_of(champion_of("recurrent")))
    module = loaded(text)
    assert module["OBSERVATIONS"] == ("bias", "forward_speed", "yaw_rate", "waypoint_angle", "waypoint_distance")
    assert module["CONTROLS"] == ("drive", "steer")
    assert module["DT"] == 0.05
    for line in ("2  yaw_rate           rad/s", "0  drive  -, one of -1, 0, 1", "evolved against a, b (min)"):
        assert line in text


def test_the_file_checks_itself_without_this_package(tmp_path):
    text = python_text(law_of(champion_of("pid")))
    assert "sysid_evo" not in text
    file = write(text, tmp_path / "law.py")
    done = subprocess.run([sys.executable, "-I", file], capture_output=True, text=True, check=True)
    assert done.stdout == "ok: 20 samples\n"
    broken = write(text.replace("K_P * error", "-K_P * error"), tmp_path / "other.py")
    assert subprocess.run([sys.executable, "-I", broken], capture_output=True, check=False).returncode == 1


def test_a_name_that_would_end_the_remark_does_not():
    champion = champion_of("linear", name='a"""\\ */ b')
    law = law_of(champion)
    assert law.name == "a_b" or law.name.isidentifier()
    assert "Controller" in loaded(python_text(law))


def test_units_and_names_end_no_comment_and_add_no_line_of_code():
    hostile = '*/ #error out */\nraise SystemExit("out")\r\x0craise SystemExit\x1b[2J"""'
    system = switched_car()
    channels = tuple(replace(channel, unit=hostile) for channel in system.controls)
    champion = champion_of("linear", replace(system, controls=channels), name=hostile)
    assert "Controller" in loaded(python_text(law_of(champion)))
    code = re.sub(r"/\*.*?\*/", "", c_text(law_of(champion)), flags=re.DOTALL)
    assert "#error" not in code
    assert "#error" in c_text(law_of(champion))
    assert "\x1b" not in python_text(law_of(champion)) + c_text(law_of(champion))
