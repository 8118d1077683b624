"""Names from decorators and entry points, plugin files, and what is said when one is broken."""

import json
import sys
from importlib.metadata import entry_points
from types import ModuleType

import pytest

from sysid_evo.errors import InvalidArgument, MissingExtra, PluginError, PluginWarning, RegistrationError, UnknownName
from sysid_evo.registry import Registry, Spec, load_plugin, make_robot, models, robots
from sysid_evo.registry import registry as registry_module
from sysid_evo.registry.plugins import source_digest
from sysid_evo.registry.registry import KINDS
from tests.fixtures.commands import forgetting

GROUP = "sysid_evo.test_things"


GOOD = "@things.register('good')\nclass Good:\n    def __init__(self, size=1):\n        self.size = size\n"
PLUGIN = (
    "from sysid_evo.registry import robots\n@robots.register('{name}')\ndef make(seed=0):\n    return '{name}', seed\n"
)


class Box:
    """A thing with parameters, of which the seed is handed over by whoever runs it."""

    def __init__(self, *, size=1, colour, seed):
        self.size, self.colour, self.seed = size, colour, seed


@pytest.fixture
def things():
    return Registry("thing", GROUP)


@pytest.fixture
def boxes():
    registry = Registry("thing", GROUP, given=frozenset({"seed"}))
    registry.register("box")(Box)
    return registry


@pytest.fixture
def install(things, tmp_path, monkeypatch):
    """Installs a made-up distribution into a folder on ``sys.path``; its modules see ``things``."""
    host = ModuleType("made_up_registry")
    host.things = things
    monkeypatch.setitem(sys.modules, "made_up_registry", host)
    monkeypatch.syspath_prepend(tmp_path)
    before = set(sys.modules)

    def install(points, modules, requires="", name="made-up", group=GROUP):
        info = tmp_path / f"{name}-1.0.dist-info"
        info.mkdir()
        lines = "\n".join(f"{point} = {module}" for point, module in points.items())
        (info / "entry_points.txt").write_text(f"[{group}]\n{lines}\n")
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n{requires}")
        for module, source in modules.items():
            (tmp_path / f"{module}.py").write_text(f"from made_up_registry import things\n{source}")

    yield install
    for name in set(sys.modules) - before:
        if str(getattr(sys.modules[name], "__file__", "")).startswith(str(tmp_path)):
            del sys.modules[name]


@pytest.fixture
def installed(install):
    """A distribution whose module ``good_module`` registers what its entry point names."""
    install({"good": "good_module"}, {"good_module": GOOD})


@pytest.fixture
def write(tmp_path):
    """Writes a plugin file; what is loaded of it is forgotten afterwards."""

    def write(text, path="my_robot.py"):
        file = tmp_path / path
        file.parent.mkdir(exist_ok=True)
        file.write_text(text)
        return file

    with forgetting():
        yield write


def test_a_registered_thing_is_found_under_one_name_until_it_is_forgotten(things):
    @things.register("box")
    class Box:
        def __init__(self, *, size):
            self.size = size

    things.register("box")(Box)
    assert things.get("box") is Box
    assert things.make("box", size=3).size == 3
    assert things.names() == ("box",)
    assert dict(things.loaded) == {"box": Box}
    with pytest.raises(RegistrationError, match=r"'box' is registered twice: by .*Box and by .*Crate"):

        @things.register("box")
        class Crate:
            pass

    assert things.get("box") is Box
    things.forget("box")
    things.forget("crate")  # is not there
    assert things.names() == ()
    things.register("box")(lambda **parameters: parameters)
    assert things.make("box(a=1)") == {"a": 1}, "a factory that takes any parameter is not second-guessed"


def test_an_entry_point_is_imported_only_when_asked_for(things, installed):
    assert things.names() == ("good",)
    assert things.module("good") == "good_module"
    assert "good_module" not in sys.modules
    assert not things.loaded
    assert things.make("good", size=5).size == 5
    assert "good_module" in sys.modules


OPTIONAL = ('no-such-package>=2; extra == "all"', 'other; extra == "all"', 'no-such-package>=2; extra == "deep"')
REQUIRES = "".join(f"Requires-Dist: {line}\n" for line in ("numpy", *OPTIONAL))


@pytest.mark.parametrize(
    ("source", "requires", "error", "reason"),
    [
        ("", "", RegistrationError, "but the module registers nothing"),
        (GOOD, "", RegistrationError, r"it = 'a_module' should register 'it', .* registers 'good'\. Use the same name"),
        ("1 / 0", "", PluginError, r"thing 'it' \(a_module\) cannot be imported: ZeroDivisionError"),
        ("import no_such_package", "", PluginError, r"'it'.*No module named 'no_such_package'"),
        (
            "import no_such_package.x",
            REQUIRES,
            MissingExtra,
            r"'no_such_package'.*pip .*made-up\[deep\]\"",
        ),
    ],
)
def test_a_module_without_the_name_of_its_entry_point_is_refused(source, requires, error, reason, things, install):
    other = "@things.register('other')\ndef make():\n    return None\n"
    install({"it": "a_module", "other": "other_module"}, {"a_module": source, "other_module": other}, requires)
    things.get("other")
    for _ in range(2):  # the second time the module may be loaded already
        with pytest.raises(error, match=reason) as raised:
            things.get("it")
        assert isinstance(raised.value, MissingExtra) == (error is MissingExtra)


def test_one_broken_plugin_is_one_warning_and_the_rest_goes_on(things, install):
    install({"bad": "bad_module", "good": "good_module"}, {"bad_module": "1 / 0\n", "good_module": GOOD})
    with pytest.warns(PluginWarning) as caught:
        found = dict(things.load_all())
    assert list(found) == ["good"]
    assert len(caught) == 1
    assert "thing 'bad' left out: " in str(caught[0].message)


def test_two_packages_that_bring_one_name_are_an_error_that_names_both(things, install):
    install({"good": "good_module"}, {"good_module": GOOD}, name="first")
    install({"good": "other_module"}, {"other_module": GOOD}, name="second")
    with pytest.raises(RegistrationError, match="'good' is registered twice: by good_module and by other_module"):
        things.get("good")


def test_an_unknown_name_is_answered_with_the_nearest_known_one():
    with pytest.raises(UnknownName) as raised:
        models.get("nearest_neighbor")
    assert str(raised.value).startswith("no model is called 'nearest_neighbor'. Did you mean 'nearest_neighbour'?")
    assert "linear" in str(raised.value)
    with pytest.raises(UnknownName, match=r"no thing is called 'x'\. Known: none\."):
        Registry("thing", GROUP).get("x")


def test_a_plugin_file_registers_what_it_holds_once(write):
    path = write(PLUGIN.format(name="crawler"))
    load_plugin(path)
    first = robots.get("crawler")
    load_plugin(str(path))
    assert robots.get("crawler") is first
    assert make_robot("crawler") == ("crawler", 0)


def test_a_plugin_file_that_fails_gives_the_reason_and_can_be_corrected(write):
    path = write("import nowhere_to_be_found\n")
    reason = r"my_robot.py cannot be imported: ModuleNotFoundError: .*nowhere_to_be_found"
    with pytest.raises(PluginError, match=reason):
        load_plugin(path)
    load_plugin(write(PLUGIN.format(name="mended") + "# another length, so that no cached bytecode is taken\n"))
    assert "mended" in robots.loaded


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("missing.py", "found none"),
        ("folder", "but this is a folder; it contains other.py$"),
        ("notes.txt", "found none"),
    ],
)
def test_a_plugin_that_is_no_python_file_is_refused(write, tmp_path, name, reason):
    write("hello", "folder/other.py")
    write("hello", "notes.txt")
    with pytest.raises(PluginError, match=f"expected a Python file, {reason}"):
        load_plugin(tmp_path / name)


def test_two_plugin_files_of_one_name_are_not_confused(write):
    first, second = (write(PLUGIN.format(name=f"robot_{folder}"), f"{folder}/my_robot.py") for folder in "ab")
    load_plugin(first)
    with pytest.raises(PluginError, match=r"b/my_robot.py: .*a/my_robot.py, a file of the same name, is loaded"):
        load_plugin(second)


def test_a_robot_may_be_named_with_a_seed(register):
    register(robots, "made_up", lambda seed=None: ("robot", seed))
    assert make_robot("made_up") == ("robot", None)
    assert make_robot("made_up:17") == ("robot", 17)
    for spec in ("made_up:", "made_up:x", "made_up:-1", "made_up:1.5", "made_up:²"):
        with pytest.raises(InvalidArgument, match=r"expected NAME\(parameter=value, ...\)"):
            make_robot(spec)
    with pytest.raises(UnknownName, match=r"no robot is called 'made_down'\. Did you mean 'made_up'"):
        make_robot("made_down:3")


def test_a_thing_is_made_from_its_spec_and_a_wrong_or_lacking_parameter_is_named(boxes):
    box = boxes.make("mine=box(size=3, colour=red)", seed=7)
    assert (box.size, box.colour, box.seed) == (3, "red", 7)
    with pytest.raises(InvalidArgument, match=r"thing 'box' has no parameter 'sise'\. Did you mean 'size'\? It takes"):
        boxes.check("box(sise=3)")
    with pytest.raises(InvalidArgument, match=r"It takes size \(1\), colour\.$"):
        boxes.check("box(weight=3)")
    with pytest.raises(InvalidArgument, match=r"thing 'box' needs colour: box\(colour=\.\.\.\)"):
        boxes.check("box(size=3)")
    assert boxes.check("box(colour=red)").parameters == {"colour": "red"}, "the seed is handed over"


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ('driver = "made_up"\nport = "/dev/x"\n[tracker]\ndriver = "udp"\n', None),
        (None, "no such file"),
        ("driver = ", "is not TOML"),
        ("port = 1", "expected driver"),
        ('driver = "made_up"\ncolour = 1', "has no parameter 'colour'"),
    ],
)
def test_a_robot_may_be_described_by_a_file_or_it_is_said_why_not(register, tmp_path, text, complaint):
    register(robots, "made_up", lambda *, port="", tracker=None: ("robot", port, tracker))
    file = tmp_path / "mine.toml"
    if text is not None:
        file.write_text(text)
    if complaint is None:
        assert make_robot(str(file)) == ("robot", "/dev/x", {"driver": "udp"})
    else:
        with pytest.raises(InvalidArgument, match=f"mine.toml.*{complaint}"):
            make_robot(str(file))


def test_a_plugin_cannot_take_a_name_that_an_entry_point_has(things, installed):
    with pytest.raises(RegistrationError, match=r"'good' is registered twice: by good_module and by .*Other"):

        @things.register("good")
        class Other:
            pass

    assert things.get("good").__module__ == "good_module"


def test_a_plugin_file_that_takes_a_shipped_name_is_refused_and_both_modules_are_named(write):
    text = "from sysid_evo.registry import models\n@models.register('linear')\nclass Mine:\n    pass\n"
    reason = r"my_linear\.py: model 'linear' .*by model_zoo\.linear.* and by .*my_linear\.Mine"
    with pytest.raises(RegistrationError, match=reason):
        load_plugin(write(text, "my_linear.py"))


def test_what_a_thing_imports_late_is_looked_for_before_it_is_used(things, install):
    requires = 'Requires-Dist: no-such-package>=2; extra == "deep"\nProvides-Extra: deep\n'
    late = GOOD.replace("class Good:\n", "class Good:\n    requires = ('{}',)\n")
    install(
        {"good": "good_module"},
        {"good_module": late.format("no_such_package"), "other_module": late.format("json").replace("good", "other")},
        requires,
    )
    error = things.missing_package("good")
    assert error is not None
    assert 'pip install "made-up[deep]"' in str(error)
    things.register("here")(type("Here", (), {"requires": ("json",)}))
    assert things.missing_package("here") is None


def test_the_digest_of_a_plugin_changes_with_its_source_and_shipped_things_have_none(write):
    digests = []
    for folder, text in (("a", PLUGIN), ("b", PLUGIN), ("c", PLUGIN + "# more\n")):
        with forgetting():
            load_plugin(write(text.format(name="crawler"), f"{folder}/crawler.py"))
            digests.append(source_digest(robots.get("crawler")))
    assert digests[0] == digests[1] != digests[2]
    assert len(digests[0]) == 64
    assert source_digest(models.get("linear")) == ""


def test_the_identity_of_a_thing_holds_every_parameter_but_those_handed_over(boxes):
    plain = boxes.identity("box(colour=red)")
    assert plain["parameters"] == {"size": 1, "colour": "red"}
    assert boxes.identity("mine=box(size=1, colour=red)") == plain
    assert boxes.identity("box(size=2, colour=red)") != plain
    assert len(plain["source"]) == 64


def test_an_identity_is_strict_json_whatever_the_parameters_are(things):
    @things.register("odd")
    class Odd:
        def __init__(self, *, limit=float("inf"), sizes=(1, 2), law=len):
            pass

    found = things.identity("odd")["parameters"]
    assert json.loads(json.dumps(found, allow_nan=False)) == {
        "limit": "inf", "sizes": [1, 2], "law": "<built-in function len>",
    }  # fmt: skip


def test_every_registry_is_among_the_kinds():
    defined = {id(value) for value in vars(registry_module).values() if isinstance(value, Registry)}
    assert defined == {id(registry) for registry in KINDS.values()}
    assert {"noise", "probe"} <= {kind for kind, registry in KINDS.items() if entry_points(group=registry.group)}


def test_a_long_text_among_the_parameters_is_left_out_for_readers_only():
    spec = Spec.parse(f'environment(id="Some-v0", learned="{"x" * 300}")')
    assert spec.shown == "environment(id='Some-v0', learned='...')"
    assert "x" * 300 in spec.text
