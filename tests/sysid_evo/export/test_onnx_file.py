"""Controllers as ONNX models, run by onnxruntime if it is there, else by the reference of the library onnx."""

import json
from collections.abc import Callable
from importlib.util import find_spec
from typing import Any

import numpy as np
import pytest

from sysid_evo.errors import MissingExtra
from sysid_evo.export import law_of, onnx_bytes
from sysid_evo.testing.examples import continuous_car
from sysid_evo.types import Array
from tests.fixtures.exports import SPECS, champion_of, decided, stepped, wandering

needs_onnx = pytest.mark.skipif(find_spec("onnx") is None, reason="the library onnx is not installed")
Run = Callable[[Any, dict[str, Array]], list[Array]]


def runner(content):
    if find_spec("onnxruntime") is None:
        from onnx import load_from_string
        from onnx.reference import ReferenceEvaluator

        return ReferenceEvaluator(load_from_string(content)).run
    from onnxruntime import InferenceSession

    return InferenceSession(content, providers=["CPUExecutionProvider"]).run


def commands(content, seen, real):
    from onnx import load_from_string

    graph = load_from_string(content).graph
    run, names = runner(content), [value.name for value in graph.output]
    sizes = {value.name: value.type.tensor_type.shape.dim[0].dim_value for value in graph.input}
    memory = {name: np.zeros(n, real) for name, n in sizes.items() if name != "observation"}

    def step(row):
        results = dict(zip(names, run(None, {"observation": row.astype(real), **memory}), strict=True))
        for name in memory:
            memory[name] = results[name.replace("memory_", "next_", 1)]
        return results["control"]

    return stepped(step, seen)


@needs_onnx
@pytest.mark.parametrize("spec", SPECS)
def test_the_onnx_model_gives_the_commands_of_the_product(spec):
    champion, seen = champion_of(spec), wandering(400)
    np.testing.assert_array_equal(commands(onnx_bytes(law_of(champion)), seen, np.float64), decided(champion, seen))


@needs_onnx
@pytest.mark.parametrize("real, dtype, off", [("double", np.float64, 1e-12), ("float", np.float32, 1e-4)])
def test_continuous_controls_are_scaled_as_the_product_does(real, dtype, off):
    champion, seen = champion_of("recurrent", continuous_car()), wandering(100)
    found = commands(onnx_bytes(law_of(champion), real), seen, dtype)
    np.testing.assert_allclose(found, decided(champion, seen), atol=off)


@needs_onnx
def test_the_model_says_how_often_it_is_called_and_what_it_is_given():
    from onnx import load_from_string

    model = load_from_string(onnx_bytes(law_of(champion_of("linear"))))
    described = {item.key: item.value for item in model.metadata_props}
    assert described["dt"] == "0.05"
    assert json.loads(described["observations"])[3].startswith("3  waypoint_angle     rad")


def test_without_the_library_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "onnx", None)
    with pytest.raises(MissingExtra, match="export --to onnx needs the package 'onnx'"):
        onnx_bytes(law_of(champion_of("linear")))
