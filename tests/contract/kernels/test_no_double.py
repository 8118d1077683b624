"""Float32 kernels compute in float32: no number of the library's compiled code is a double."""

import importlib.util
from typing import Any

import numpy as np
import pytest

from sysid_evo.controllers import RecurrentNetwork
from sysid_evo.engine.compiled import loops
from sysid_evo.engine.compiled.language import generate
from sysid_evo.kernels import ADVANCE, CONTROLLER, DYNAMICS, OBSERVE, REALS, KernelSource, Signature, Source
from sysid_evo.models.kernels import (
    command_network_predictor,
    neighbour_predictor,
    network_predictor,
    polynomial_predictor,
    runge_kutta_predictor,
    stepping_kernel,
)
from sysid_evo.models.kernels.trees import Tree, tree_predictor
from sysid_evo.tasks import PointToPoint

LEAF = Tree(np.zeros(1, dtype=int), np.zeros(1), np.array([-1]), np.array([-1]), np.ones((1, 3)))


def library(car):
    between, layers = [np.zeros(1)], [(np.zeros((3, 3)), np.zeros(3))]
    predictors = {
        "networks": network_predictor([layers, layers], 3, 0),
        "polynomial": runge_kutta_predictor(polynomial_predictor([[1, 0, 0, 1]], np.ones((1, 3)), 3, 1), car),
        "trees": tree_predictor([LEAF, LEAF], np.zeros(3), 3, 0),
        "neighbours": neighbour_predictor(
            [(np.zeros((1, 3)), np.zeros((1, 3)))], np.zeros(2, dtype=int), between, [], 3
        ),
        "command networks": command_network_predictor(
            np.zeros((1, 3, 3, 4)), np.zeros((1, 3, 4)), np.zeros((1, 3, 4)), np.zeros((1, 3)),
            np.zeros(2, dtype=int), between, [], 3,
        ),
    }  # fmt: skip
    found: dict[str, tuple[Source, Signature]] = {
        name: (stepping_kernel(predictor, car, output="acceleration").source, DYNAMICS)
        for name, predictor in predictors.items()
    }
    task, controller = PointToPoint().bind(car).kernel(), RecurrentNetwork().bind(5, 2).kernel()
    found["recurrent"] = controller.source, CONTROLLER
    found["observe"], found["advance"] = (task.observe, OBSERVE), (task.advance, ADVANCE)
    found["open loop"] = KernelSource(loops.open_loop), loops.OPEN_LOOP
    return found


def promotes(x, y):
    y[0] = x[0] * 3 + x[1] * 5


def llvm(source, signature, folder, *, pointer=True):
    """Compile without the cache, whose code cannot be looked at; return its LLVM text."""
    path = folder / "looked_at.py"
    path.write_text(generate(source, signature, "float32", pointer=pointer).replace("cache=True, ", ""))
    spec = importlib.util.spec_from_file_location("looked_at", path)
    assert spec is not None
    assert spec.loader is not None
    module: Any = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    text = module.entry.inspect_llvm()
    return text if isinstance(text, str) else "\n".join(text.values())


@pytest.mark.nightly
@pytest.mark.parametrize(
    "name",
    [
        "networks",
        "polynomial",
        "trees",
        "neighbours",
        "command networks",
        "recurrent",
        "observe",
        "advance",
        "open loop",
    ],
)
def test_a_float32_kernel_computes_no_double(name, car, tmp_path):
    source, signature = library(car)[name]
    text = llvm(source, signature, tmp_path, pointer=name != "open loop")
    assert " double" not in text
    assert "float" in text


def test_the_search_for_doubles_finds_one(tmp_path):
    """An integer combined with a float32 number gives a float64 number, which the library avoids."""
    assert " double" in llvm(KernelSource(promotes), Signature(x=REALS, y=REALS), tmp_path)
