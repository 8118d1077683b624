"""The sampler of line changes, on modules of a few lines."""

import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from tests.mutate import Imports, Watch, drawn, places

ROOT = Path(__file__).parents[2]


def changed(source):
    """Return the source with each change in turn."""
    return {change.of(source.encode()).decode() for change in places("module.py", source.encode())}


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ("x = a < b", ["x = a >= b"]),
        ("x = a >= 0.3", ["x = a < 0.3", "x = a >= 0.6"]),
        ("x = len(a) < b", ["x = len(a) >= b", "x = len(a) <= b"]),
        ("x = a.shape[i] > b > c", ["x = a.shape[i] <= b > c", "x = a.shape[i] >= b > c", "x = a.shape[i] > b <= c"]),
        ("x = a == b", ["x = a != b"]),
        ("x = a is not None", ["x = a is None"]),
        ("x = a not in (b)", ["x = a in (b)"]),
        ("x = (a + b) * c", ["x = (a - b) * c", "x = (a + b) / c"]),
        ("x = a ** b - c / d", ["x = a ** b + c / d", "x = a ** b - c * d"]),
        ("x -= a", ["x += a"]),
        ("x = a and b or c", ["x = a or b or c", "x = a and b and c"]),
        ("x = not (a)", ["x =  (a)"]),
        ("x = max(a, np.argmin(b))", ["x = min(a, np.argmin(b))", "x = max(a, np.argmax(b))"]),
        ("x = all(a)", ["x = any(a)"]),
        ("x = 0, 1", ["x = 1, 1", "x = 0, 0", "x = 0, 2"]),
        ("x = 3", ["x = 4", "x = 2", "x = 6"]),
        ("x = 2.0, 1e-9", ["x = 3.0, 1e-9", "x = 4.0, 1e-9", "x = 2.0, 1.000000001"]),
        ("def f(a=False): g(a)", ["def f(a=True): g(a)"]),
        ("class A:\n    x: Annotated[int, 1] = 7", [f"class A:\n    x: Annotated[int, 1] = {n}" for n in (6, 8, 14)]),
        ("if a:\n    raise ValueError(3)", ["if False and (a):\n    raise ValueError(3)"]),
        ("if (\n    a\n):\n    g()\n    return b", ["if (\n    False and (a)\n):\n    g()\n    return b"]),
        ("x = 'é' if a < b else 'ö'", ["x = 'é' if a >= b else 'ö'"]),
        ("x = (a  # not - but\n    + b)", []),
    ],
)
def test_an_operator_a_number_or_a_guard_is_changed_where_it_stands(source, expected):
    assert changed(source) == set(expected)


@pytest.mark.parametrize(
    "source",
    [
        '"""One, 2 or 3."""',
        "if TYPE_CHECKING:\n    x = 1",
        "if __name__ == '__main__':\n    x = 1",
        "__all__ = ['a'] + ['b']",
        "@dataclass(frozen=True)\nclass A: ...",
        "def f(a: 'b' = None) -> Array[3]: ...",
        "X: TypeAlias = Array[3]",
        "X = Literal[1, 2]",
        "x = f'{a + 1:5}'",
        "raise ValueError(a + 1)",
        "assert a is not None",
        "x = zip(a, b, strict=True)",
        "x = folder / 'file'",
        "x = a + 'b'",
        "x = [a] * b",
    ],
)
def test_what_only_people_and_type_checkers_read_is_not_changed(source):
    assert changed(source) == set()


def test_a_change_names_its_line_and_keeps_the_number_of_lines():
    source = b"x = (\n    a\n    <\n    b\n)\n"
    (change,) = places("module.py", source)
    assert change.shown(source) == "module.py:3\n  - <\n  + >=\n"


def test_the_seed_chooses_one_change_on_each_of_so_many_lines():
    changes = places("module.py", b"x = 3 + y\n" * 40)
    chosen = drawn(changes, 10, "0")
    assert drawn(changes, 10, "0") == chosen != drawn(changes, 10, "1")
    assert len({change.line for change in chosen}) == 10
    assert len({change.text for change in chosen}) > 1
    assert len(drawn(changes, 100, "0")) == 40


def write(root, files):
    for name, text in files.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text)


PRODUCT = {
    "product/__init__.py": "from product.numbers import double\n",
    "product/numbers.py": "LIMIT = 5\n\n\ndef double(number):\n    return 2 * number\n",
    "product/above.py": "from product import double\n",
}


def test_tests_are_those_that_import_a_module_the_nearest_first(tmp_path):
    write(tmp_path, PRODUCT)
    write(
        tmp_path,
        {
            "pyproject.toml": '[project.entry-points.group]\ndoubled = "product.above"\n',
            "tests/conftest.py": "from product import above\n\n\n"
            "def car():\n    return above\n\n\ndef made(car): ...\n\n\ndef rng(): ...\n",
            "tests/fixtures/systems.py": "import product.numbers\n",
            "tests/unit/test_a_direct.py": "from product import double\n",
            "tests/unit/test_numbers.py": "def test():\n    import product.numbers\n",
            "tests/unit/test_through.py": "import product.above\n",
            "tests/unit/test_helper.py": "from tests.fixtures import systems\n",
            "tests/unit/test_fixture.py": "def test(made): ...\n",
            "tests/unit/test_named.py": "def test():\n    f('doubled(2)')\n",
            "tests/unit/test_other.py": "import numbers\n\n\ndef test(rng): ...\n",
            "tests/unit/test_types.py": "if TYPE_CHECKING:\n    import product.numbers\n",
            "tests/system/test_process.py": "import product.numbers\n",
            "tests/system/test_commands.py": "def test(call): ...\n",
            "tests/docs/test_pages.py": "import product.numbers\n",
        },
    )
    *tests, last = (Path(test).stem for test in Imports(tmp_path).tests_of("product/numbers.py"))
    assert last == "test_commands"
    assert tests[:2] + tests[-1:] == ["test_numbers", "test_a_direct", "test_named"]
    assert sorted(tests[2:-1]) == ["test_fixture", "test_helper", "test_through"]
    for test in tests:
        (tmp_path / f"tests/unit/{test}.py").unlink()
    assert Imports(tmp_path).tests_of("product/numbers.py") == [
        "tests/system/test_process.py",
        "tests/system/test_commands.py",
    ]


def test_the_nearest_tests_are_run_first_whatever_their_folders():
    near = ["tests/unit/test_near.py", "tests/contract/test_far.py"]
    session = SimpleNamespace(items=[SimpleNamespace(nodeid=f"{test}::test") for test in reversed(near)])
    Watch(60.0, near).pytest_collection_finish(session)
    assert [item.nodeid.partition("::")[0] for item in session.items] == near


def test_what_no_test_notices_is_printed(tmp_path):
    write(tmp_path, PRODUCT)
    test = "from product.numbers import LIMIT, double\n\n\ndef test_double():\n    assert double(3) == 6\n"
    write(tmp_path, {"tests/unit/test_numbers.py": f"{test}\n\ndef test_broken():\n    assert LIMIT == 0\n"})
    run = "import sys; from tests import mutate; mutate.WARM = (); sys.exit(mutate.main(sys.argv[1:]))"
    command = [sys.executable, "-c", run, "product", "--lines", "5", "--jobs", "1", "--enough", "0.6"]
    done = subprocess.run(command, cwd=tmp_path, env={"PYTHONPATH": str(ROOT)}, capture_output=True, text=True)
    assert done.returncode == 1, done.stderr
    assert "fails without a change: tests/unit/test_numbers.py::test_broken" in done.stderr
    assert "product/numbers.py:5 tests/unit/test_numbers.py::test_double" in done.stderr
    place, before, after, summary = done.stdout.splitlines()
    assert (place, before) == ("product/numbers.py:1", "  - LIMIT = 5")
    assert after.startswith("  + LIMIT = ")
    assert summary == "1 of 2 changes noticed, 50%; seed 0"
    assert (tmp_path / "product/numbers.py").read_text() == PRODUCT["product/numbers.py"]
