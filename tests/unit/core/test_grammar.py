"""The grammar NAME(parameter=value, ...): what it reads, what it writes, what it refuses."""

from keyword import iskeyword

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sysid_evo.errors import InvalidArgument
from sysid_evo.registry import Spec

WORDS = st.text("ab1_ ,=()[]{}:'\"\\\n\t\0#+-.é𝄞", min_size=1, max_size=12)
SCALARS = st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | WORDS
VALUES = st.recursive(SCALARS, lambda inner: st.lists(inner, max_size=3), max_leaves=6)
NAMES = st.text("abfinorsx_01", min_size=1, max_size=9).filter(lambda name: name.isidentifier() and not iskeyword(name))


@settings(derandomize=True, database=None, max_examples=40)
@given(NAMES, st.dictionaries(NAMES, VALUES, max_size=3), NAMES)
def test_what_is_written_is_read_again(name, parameters, label):
    spec = Spec(name, parameters, label)
    read = Spec.parse(str(spec))
    assert (read.name, read.parameters, read.label) == (name, parameters, label)


def test_a_text_is_written_without_quotes_where_it_is_a_name_and_no_value():
    spec = Spec("thing", {"a": "word", "b": "two words", "c": "true", "d": True, "e": "in", "f": None, "g": [1, "x"]})
    assert spec.text == "thing(a=word, b='two words', c='true', d=true, e='in', f=none, g=[1, x])"
    assert str(Spec("thing", {}, "label")) == "label=thing"
    assert str(Spec("thing", {}, "thing")) == str(Spec("thing", {}, "thing:3")) == "thing"


def test_values_are_what_they_look_like():
    spec = Spec.parse("thing(a=1, b=-2.5e-3, c=true, d=None, e=word, f='two words', g=[1, x], h={port: 5005})")
    assert spec.parameters == {
        "a": 1, "b": -0.0025, "c": True, "d": None, "e": "word", "f": "two words", "g": [1, "x"], "h": {"port": 5005},
    }  # fmt: skip


def test_a_thing_inside_a_thing_is_handed_over_as_text_in_the_same_grammar():
    spec = Spec.parse("niches(strategy=mu_plus_lambda(sigma=0.2, parents=10), slots=3)")
    assert spec.parameters == {"strategy": "mu_plus_lambda(sigma=0.2, parents=10)", "slots": 3}
    assert Spec.parse(str(spec)) == spec


def test_several_are_separated_by_commas_outside_brackets_and_quotes():
    specs = Spec.parse_many("linear, near2=nearest_neighbour(state_lags=2, note='a, b'), emulated_car:3")
    assert [spec.label for spec in specs] == ["linear", "near2", "emulated_car:3"]
    assert specs[1].parameters == {"state_lags": 2, "note": "a, b"}
    escaped = Spec.parse_many("near(note='it\\'s (\"so, ', k=2), linear")
    assert escaped[0].parameters == {"note": "it's (\"so, ", "k": 2}
    assert specs[2] == Spec("emulated_car", {"seed": 3}, "emulated_car:3")


def test_the_label_is_the_name_unless_another_is_given_and_is_not_part_of_what_is_made():
    assert Spec.parse("linear(ridge=1)").label == "linear"
    assert Spec.parse("mine = linear(ridge=1)").text == "linear(ridge=1)"


def test_parameters_that_are_there_win_over_those_that_are_added():
    assert Spec.parse("linear(ridge=1)").with_parameters(ridge=2, state_lags=1).parameters == {
        "ridge": 1,
        "state_lags": 1,
    }


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "an empty text"),
        (" , ", "an empty text"),
        ("linear,", "before and after every comma"),
        ("linear(", "not closed"),
        ("linear(a='x)", "not closed"),
        ("linear)", "not closed"),
        ("lin ear", r"expected NAME\(parameter=value"),
        ("9lives", r"expected NAME\(parameter=value"),
        ("linear(1)", "parameter=value between the brackets"),
        ("linear(**x)", "parameter=value between the brackets"),
        ("linear()(a=1)", "parameter=value between the brackets"),
        ("linear(a=1, a=2)", "given twice|repeated"),
        ("linear(a=)", "cannot be read"),
        ("linear(a=1+x)", "is no value"),
        ("linear(a=b'x')", "is no value"),
        ("linear(a=lambda: 1)", "is no value"),
        ("linear(a=x[0])", "is no value"),
        ("linear(a='\ud800')", "bytes that are not UTF-8"),
        ("linear(a={[1]: 2})", "is no value"),
        # Where Python's parser gives up depends on its recursion limit, which other libraries change.
        (f"linear(a={'-' * 3000}1)", "nested brackets|is no value"),
        (f"linear(a={'1+' * 900}1)", "nested brackets|is no value"),
        (f"linear(a={'1' * 4301})", "cannot be read"),
        (f"linear(a=0x{'f' * 5000})", "is no value"),
        (f"linear:{'1' * 4301}", r"expected NAME\(parameter=value"),
        ("linear(a=1e999)", "is no value"),
        (f"linear(a={'[' * 13}{']' * 13})", "at most 12 nested brackets"),
        (f"linear(a={'[' * 3000}{']' * 3000})", "at most 12 nested brackets|too many nested"),
        ("a(b=" * 40 + "1" + ")" * 40, "at most 12 nested brackets"),
        (f"linear(a='{'x' * 10**6}')", "at most 100000 characters, got 1000012"),
        ("linear, linear", "'linear' is given 2 times; give each a label"),
        ("a=linear, a=narx", "'a' is given 2 times"),
    ],
)
def test_what_cannot_be_read_is_refused_with_a_sentence(text, complaint):
    with pytest.raises(InvalidArgument, match=complaint) as raised:
        Spec.parse_many(text)
    assert len(str(raised.value)) < 500


def test_one_spec_is_expected_where_one_stands():
    with pytest.raises(InvalidArgument, match="expected one NAME"):
        Spec.parse("a, b")


@pytest.mark.parametrize("path", ["runs/first/controllers/recomended", "controller.json"])
def test_a_path_where_nothing_is_is_called_no_file(path):
    with pytest.raises(InvalidArgument, match=f"^'{path}': there is no such file, and a name has"):
        Spec.parse(path)
