"""`sysid-evo export`: the file it writes, what it says, and what it refuses."""

from __future__ import annotations

import copy
from dataclasses import replace

import numpy as np
import pytest

from sysid_evo.controllers import Controller
from sysid_evo.errors import InvalidArgument
from sysid_evo.evolution.champion import save_champion
from sysid_evo.export import law_of
from sysid_evo.models import save_model
from sysid_evo.models.base import make_model
from sysid_evo.registry import controllers
from sysid_evo.testing import example_dataset
from tests.fixtures.commands import Caller
from tests.fixtures.exports import champion_of


@pytest.fixture
def stored(tmp_path):
    return save_champion(champion_of("recurrent"), tmp_path / "champion")


@pytest.fixture
def call(tmp_path, capsys):
    return Caller(tmp_path, capsys)


@pytest.mark.parametrize("to, suffix", [("python", ".py"), ("c", ".c"), ("onnx", ".onnx")])
def test_it_names_the_file_and_how_to_use_it(to, suffix, stored, tmp_path, call):
    if to == "onnx":
        pytest.importorskip("onnx")
    done = call("export", stored, "--to", to)
    assert done.code == 0
    assert f"best of a+b written to best_of_a_b{suffix}" in done.stdout
    assert "every 0.05 s, from bias, forward_speed (m/s)" in done.stdout
    assert (tmp_path / f"best_of_a_b{suffix}").stat().st_size > 500
    again = call("export", stored, "--to", to)
    assert again.code == 2
    assert again.says(f"best_of_a_b{suffix} exists already")


def test_it_may_be_called_otherwise_in_its_file(stored, tmp_path, call):
    done = call("export", stored, "--to", "c", "--name", "controller")
    assert "written to controller.c" in done.stdout
    text = (tmp_path / "controller.c").read_text()
    assert "void controller_step(controller_memory *memory" in text
    assert "controller 'best of a+b'" in text
    assert "best_of_a_b" not in text


def test_wrong_words_are_refused_with_those_that_would_do(stored, call):
    assert call("export", stored, "--to", "java").says("--to: expected python, c, onnx, got 'java'")
    wrong = call("export", stored, "--to", "c", "--real", "half")
    assert (wrong.code, wrong.says("--real: expected double or float, got 'half'")) == (2, True)


class Bare(Controller):
    """A controller without a program."""

    def bind(self, n_observations, n_outputs):
        bound = copy.copy(self)
        bound.n_parameters, bound.n_memory, bound.n_outputs = 1, 0, n_outputs
        return bound

    n_outputs: int

    def act(self, parameters, memory, view):
        return np.zeros((*view.observation.shape[:2], self.n_outputs)), memory


def test_a_controller_that_has_no_program_is_refused_with_those_that_have(register):
    register(controllers, "bare", Bare)
    with pytest.raises(InvalidArgument, match=r"'bare' cannot be written as a file .* recurrent, feed_forward, linear"):
        law_of(champion_of("bare"))


def test_a_model_inside_is_refused_with_what_to_do_instead(tmp_path):
    file = save_model(make_model("linear").fit(example_dataset()), tmp_path / "body")
    with pytest.raises(InvalidArgument, match=r"'predictive' cannot be written .* Evolve a network in that model"):
        law_of(champion_of(f"predictive(model={str(file)!r}, horizon=3)"))


def test_somebody_who_drives_by_hand_is_no_controller():
    with pytest.raises(InvalidArgument, match="is somebody who drives by hand"):
        law_of(replace(champion_of("recurrent"), system=None))
