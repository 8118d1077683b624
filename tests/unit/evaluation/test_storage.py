"""Results on disk: every data class comes back as it was, and what does not fit it is refused by name."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
import pytest

from evaluation.storage import from_plain, load_result, plain, save_result
from sysid_evo.errors import ArtefactError, InvalidData
from sysid_evo.system import Channel
from sysid_evo.types import Array, BoolArray
from sysid_evo.validation.estimates import Estimate


@dataclass(frozen=True)
class Part:
    """A number and a list."""

    size: float
    inside: BoolArray


@dataclass(frozen=True)
class Whole:
    """A field of every type that a result may have."""

    name: str
    count: int
    sure: bool
    kind: Literal["a", "b"]
    channel: Channel
    estimate: Estimate
    curve: Array
    parts: tuple[Part, ...]
    pairs: tuple[tuple[str, float], ...]
    curves: Mapping[str, Array]
    figures: Mapping[str, float | None] = field(default_factory=dict)
    best: Part | None = None
    pose: Array | None = None


WHOLE = Whole(
    name="one",
    count=3,
    sure=True,
    kind="b",
    channel=Channel("angle", "rad", period=2 * np.pi),
    estimate=Estimate(float("nan"), 1 / 3),
    curve=np.array([[1.0, np.nan], [np.inf, 1e-300]]),
    parts=(Part(1, np.array([True, False])), Part(0.1, np.zeros(0, bool))),
    pairs=(("a", 1.0),),
    curves={"x.y": np.zeros((0, 2)), "z": np.ones(1)},
    figures={"a": None, "b": 2.0},
    best=None,
    pose=np.ones((2, 3)),
)


def stored(found):
    """Return everything in it that can be compared."""
    arrays = {}
    return plain(found, arrays), {name: (array.dtype, array.shape, array.tobytes()) for name, array in arrays.items()}


@pytest.mark.parametrize("value", [WHOLE, replace(WHOLE, best=WHOLE.parts[0], pose=None, parts=(), curves={})])
def test_a_result_comes_back_from_disk_bit_by_bit(tmp_path, value):
    files = save_result(value, tmp_path / "run" / "one@a.b")
    assert [file.name for file in files] == ["one@a.b.safetensors", "one@a.b.json"]
    again = load_result(Whole, tmp_path / "run" / "one@a.b")
    assert stored(again) == stored(value)
    assert again.channel == value.channel
    assert type(again.parts) is tuple


def test_several_without_arrays_are_one_file(tmp_path):
    value = (Channel("a"), Channel("b", low=0.0))
    assert [file.name for file in save_result(value, tmp_path / "two")] == ["two.json"]
    assert load_result(tuple[Channel, ...], tmp_path / "two") == value


def test_arrays_in_the_text_come_back_too():
    text = json.dumps(plain(WHOLE), allow_nan=False)
    again = from_plain(Whole, json.loads(text))
    assert again.pose.tolist() == WHOLE.pose.tolist()
    assert again.parts[0].inside.dtype == bool


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"name": 3}, "name: expected str, got 3"),
        ({"count": True}, "count: expected int, got True"),
        ({"count": 1.5}, "count: expected int, got 1.5"),
        ({"sure": 1}, "sure: expected bool, got 1"),
        ({"kind": "c"}, "kind: expected one of ('a', 'b'), got 'c'"),
        ({"pairs": [["a"]]}, "pairs.0: expected 2 values, got ['a']"),
        ({"pairs": [{"a": 1.0}]}, "pairs.0: expected a list, got {'a': 1.0}"),
        ({"estimate": {"value": "2"}}, "estimate.value: expected a number, got '2'"),
        ({"estimate": {"value": False}}, "estimate.value: expected a number, got False"),
        ({"parts": [[1.0]]}, "parts.0: expected an object, got [1.0]"),
        ({"parts": [{"size": 1.0}]}, "parts.0: expected an object with size, inside, got ['size']"),
        ({"best": {"size": 1.0, "inside": None}}, "best.inside: expected an array of bool, got None"),
        ({"figures": [1.0]}, "figures: expected an object, got [1.0]"),
        ({"figures": {"a": "many"}}, "figures.a: expected a number, got 'many'"),
        ({"further": 1}, "expected an object with name, count, "),
    ],
)
def test_a_value_of_another_type_is_refused_with_file_and_field(tmp_path, change, said):
    save_result(WHOLE, tmp_path / "one")
    file = tmp_path / "one.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | change))
    with pytest.raises(ArtefactError) as refused:
        load_result(Whole, tmp_path / "one")
    assert str(refused.value).startswith(f"{tmp_path / 'one'}: not a stored Whole: InvalidData: ")
    assert said in str(refused.value)


def test_arrays_of_another_type_and_missing_files_are_refused(tmp_path):
    save_result(replace(WHOLE, curve=np.zeros(2, np.float32)), tmp_path / "one")
    with pytest.raises(ArtefactError, match="curve: expected an array of float64"):
        load_result(Whole, tmp_path / "one")
    (tmp_path / "one.safetensors").unlink()
    with pytest.raises(ArtefactError, match="curve: expected an array of float64, got None"):
        load_result(Whole, tmp_path / "one")
    with pytest.raises(ArtefactError, match="not a stored Whole: FileNotFoundError"):
        load_result(Whole, tmp_path / "two")


def test_what_could_not_be_read_again_is_not_written(tmp_path):
    with pytest.raises(InvalidData, match=r"parts.1: expected numbers, texts, arrays or data classes, got <object"):
        save_result(replace(WHOLE, parts=(WHOLE.parts[0], object())), tmp_path / "one")
    assert list(tmp_path.iterdir()) == []
    assert plain([float("inf"), np.float64(2.0), {1: np.int64(3)}]) == [None, 2.0, {"1": 3}]
