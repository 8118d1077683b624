"""Which options of a command are refused together, over all pairs; what a command may replace."""

import inspect
import itertools
from functools import cache
from pathlib import Path

import pytest
from typer.testing import CliRunner

from evaluation import compare
from evaluation.experiment import MEANINGLESS, Experiment
from sysid_evo.cli.app import COMMANDS, REFUSED, CheckedCommand, app, load, typed
from sysid_evo.cli.console import as_option
from sysid_evo.cli.options import with_settings
from sysid_evo.errors import InvalidArgument, refuse_meaningless
from sysid_evo.settings import seconds
from sysid_evo.testing import example_dataset

ARGUMENTS = {"fit": ["car"], "study": ["s.toml"], "inspect": ["car"], "import": ["logs"], "adapt": ["m"],
             "exploit": ["m"], "transfer": ["c"], "export": ["c"], "report": ["run"]}  # fmt: skip
"""What stands besides options; values of options are those below, else 1."""
NEEDED = {"import": ["--out", "new"], "adapt": ["--data", "car", "--out", "new"],
          "record": ["--out", "new"], "evolve": ["--against", "linear"], "transfer": ["--on", "linear"],
          "export": ["--to", "c"]}  # fmt: skip
VALUES = {"stop-after": "prediction", "procedure": "plain", "to": "python", "seconds": "5"}

OF_CONTROLLERS = ("aggregate", "baselines", "controller", "ensembles", "estimator-delay", "generations",
                  "noise", "procedure", "repeats", "strategy", "task", "trials", "reference", "starts",
                  "rounds", "search-minutes")  # fmt: skip
TOGETHER = {
    "compare": {("stop-after", name) for name in OF_CONTROLLERS} | {
        ("data", "minutes"), ("scheduler", "jobs"), ("starts", "controller"), ("starts", "strategy"),
    },
    "fit": {("scheduler", "jobs")},
    "evolve": {("scheduler", "jobs")},
    "study": {("scheduler", "jobs"), ("render", "jobs"), ("render", "scheduler"), ("render", "dry-run")},
    "export": {("to", "real")},
    "drive": {("model", "robot"), ("controller", "host"),
              ("controller", "port")},
}  # fmt: skip
"""The pairs of options that are refused: each option, and one that has no effect beside it. All others are taken."""
ALONE = {
    "compare": {"columns": "data"},
    "drive": {"watch": "controller"},
}
"""Options that have no effect without another one."""

COMMANDS_WITH_OPTIONS = [name for name in COMMANDS if isinstance(load(name), CheckedCommand)]


def options_of(command):
    """Return every option of a command as it is typed with a value, by its name."""
    found = {}
    for option in load(command).params:
        name = option.opts[0].removeprefix("--")
        if option.param_type_name == "option" and name != "help":
            found[name] = [option.opts[0], *([] if option.is_flag else [VALUES.get(name, "1")])]
    return found


@cache
def given(command, name=""):
    """Return the setting that one option makes of a command, "" for what the command needs anyway."""
    option = options_of(command).get(name, [])
    asked = typed(load(command).make_context(command, [*NEEDED.get(command, []), *option, *ARGUMENTS.get(command, [])]))
    return {key: value for key, value in asked.items() if not name or key == name.replace("-", "_")}


def refused(command, *names):
    """Return why the command refuses these options because one makes another one meaningless; else ""."""
    settings = {key: value for name in ("", *names) for key, value in given(command, name).items()}
    try:
        refuse_meaningless(REFUSED.get(command, ()), settings, settings, as_option)
        if command == "compare":
            refuse_meaningless(MEANINGLESS, settings, settings, as_option)
    except InvalidArgument as error:
        return str(error)
    return ""


def pairs(command):
    """Yield every pair of options of a command, and why it is refused, "" if it is not; with what either needs."""
    for one, other in itertools.combinations(options_of(command), 2):
        further = (ALONE.get(command, {}).get(name, name) for name in (one, other))
        why = refused(command, *further, one, other)
        named = {word.strip(":;,") for word in why.split()}
        yield one, other, why if {f"--{one}", f"--{other}"} <= named else ""  # else it is of what one of them needs


@pytest.mark.parametrize("command", COMMANDS_WITH_OPTIONS)
def test_options_are_refused_together_where_one_makes_the_other_meaningless_and_nowhere_else(command):
    expected = {frozenset(pair) for pair in TOGETHER.get(command, set())}
    found = {frozenset((one, other)): why for one, other, why in pairs(command) if why}
    for one, other in (sorted(pair) for pair in set(found) ^ expected):
        pytest.fail(f"{command} --{one} --{other}: {found.get(frozenset((one, other)), 'is not refused')}")


@pytest.mark.parametrize(("command", "option", "needs"), [
    (command, option, needs) for command, rows in ALONE.items() for option, needs in rows.items()
])  # fmt: skip
def test_an_option_that_needs_another_is_refused_without_it(command, option, needs):
    assert f"--{option} has no effect without --{needs}: " in refused(command, option)
    assert not refused(command, option, needs)


@pytest.mark.parametrize(
    ("settings", "both"),
    [
        ({"stop_after": "prediction", "task": "point_to_point"}, ("task", "stop_after = 'prediction'")),
        ({"stop_after": "fit", "held_out": 0.5}, ("held_out", "stop_after = 'fit'")),
        ({"minutes": 2.0}, ("minutes", "data")),
        ({"stop_after": "prediction", "robot": "emulated_car"}, ("robot", "data")),
        ({"test": ("episode-2",), "held_out": 0.5}, ("held_out", "test")),
        ({"procedure": "plain", "polish_generations": 20}, ("polish_generations", "procedure = 'plain'")),
    ],
)
def test_the_plan_refuses_settings_from_python_and_names_both(settings, both, tmp_path):
    with pytest.raises(InvalidArgument, match="has no effect with") as told:
        compare(example_dataset(), out=tmp_path / "run", models=["linear"], **settings)
    assert all(name in str(told.value) for name in both)
    assert not (tmp_path / "run").exists()


def test_an_option_removes_the_settings_of_a_configuration_that_it_makes_meaningless(call, stored_data):
    (call.folder / "whole.toml").write_text('models = ["linear"]\ntask = "point_to_point(horizon=40)"\n')
    planned = call.works(
        "compare", "--config", "whole.toml", "--data", stored_data, "--stop-after", "prediction", "--dry-run"
    )
    assert "evolve" not in planned.stdout
    (call.folder / "part.toml").write_text('stop_after = "prediction"\n')
    ended = call.refused("compare", "--config", "part.toml", "--data", stored_data, "--task", "point_to_point")
    assert ended.says("--task has no effect with --stop-after prediction")
    (call.folder / "both.toml").write_text('stop_after = "prediction"\nminutes = 2\nrepeats = 3\n')
    assert call("compare", "--config", "both.toml").says(
        "both.toml: repeats has no effect with stop_after = 'prediction'"
    )


def test_other_models_replace_those_of_a_configuration_with_the_choice_of_those_that_only_score(call, stored_data):
    (call.folder / "some.toml").write_text('models = ["linear", "narx"]\nsearched = ["linear"]\ngenerations = 2\n')
    asked = "compare", "--config", "some.toml", "--data", stored_data, "--dry-run"
    assert "evolve narx" not in call.works(*asked).stdout
    assert "evolve narx" in call.works(*asked, "--models", "narx").stdout


def test_options_of_a_settings_class_are_texts_that_the_class_converts():
    given = {}

    @with_settings(Experiment, "models", "data", "estimator_delay", "generations", "plugins", "preset", preset="paper")
    def command(*, settings, jobs: int = 1):
        given.update(settings)

    assert list(inspect.signature(command).parameters)[-1] == "jobs"
    values = dict.fromkeys(inspect.signature(command).parameters) | {"jobs": 2}
    command(**values)
    assert given == {"preset": "paper"}
    command(**values | {"models": "narx(lags=[1,2]),linear", "data": ["log.csv"], "estimator_delay": "50ms"})
    assert given["models"] == ("narx(lags=[1,2])", "linear")
    assert given["data"] == (str(Path("log.csv").resolve()),)
    assert Experiment.of(given).estimator_delay == 0.05
    with pytest.raises(InvalidArgument, match="--estimator-delay: expected a time with a unit"):
        command(**values | {"estimator_delay": "50"})


@pytest.mark.parametrize(
    ("text", "expected"),
    [("50ms", 0.05), ("0.05s", 0.05), (" 2 s ", 2.0), ("5m", 300.0), ("1.5min", 90.0), ("1h", 3600.0)],
)
def test_a_time_has_a_unit(text, expected):
    assert seconds(text) == pytest.approx(expected)
    assert Experiment.of({"estimator_delay": text}).estimator_delay == pytest.approx(expected)


@pytest.mark.parametrize("text", ["", "s", "-5s", "5 days", "soon", "nan", "1e3s"])
def test_a_text_that_is_no_time_is_an_error(text):
    with pytest.raises(InvalidArgument, match="expected a time"):
        seconds(text)


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("sysid-evo comp", {"compare"}),
        ("sysid-evo models ", {"list", "show"}),
        ("sysid-evo compare --models lin", {"linear", "linear_state_space"}),
        ("sysid-evo compare --models narx,sindy_", {"narx,sindy_discrete"}),
        ("sysid-evo compare --models narx(lags=[1,sin", set()),
        ("sysid-evo compare --task point", {"point_to_point"}),
        ("sysid-evo compare --robot emu", {"emulated_car"}),
        ("sysid-evo fit logs --preset ", {"quick", "standard", "paper"}),
        ("sysid-evo evolve --run r", {"runs/old", "runs/new"}),
        ("sysid-evo report ", {"runs/old", "runs/new"}),
        ("sysid-evo evolve --against emulated_car,my", {"emulated_car,my_model"}),
        ("sysid-evo export c --to ", {"python", "c"}),
    ],
)
def test_the_shell_completes_commands_and_values(words, expected, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("old", "new"):
        (tmp_path / "runs" / name / "models").mkdir(parents=True)
        (tmp_path / "runs" / name / "models" / "my_model.json").touch()
    asked = {"COMP_WORDS": words, "COMP_CWORD": str(len(words.split(" ")) - 1), "_SYSID_EVO_COMPLETE": "complete_bash"}
    ended = CliRunner(env=asked).invoke(app, [], prog_name="sysid-evo")
    assert set(ended.stdout.split("\n")) - {""} == expected


LOG = "time,angle,torque\n" + "".join(f"{0.05 * k:.2f},{(k % 7) / 7:.3f},{(k % 3) - 1}\n" for k in range(80))
MAP = """
name = "swing"
dt = 0.05
time = { column = "time" }
states = { angle = { column = "angle", unit = "rad" } }
controls = { torque = { column = "torque", low = -1, high = 1 } }
"""


def contents(folder):
    return {path: path.read_bytes() for path in folder.iterdir()}


def test_an_import_replaces_a_data_set_only_with_overwrite_and_nothing_else(call):
    folder = call.folder
    (folder / "log.csv").write_text(LOG)
    (folder / "map.toml").write_text(MAP)
    command = ("import", "log.csv", "--columns", "map.toml", "--out", "data")
    call.works(*command)
    example_dataset(episodes=1).save(folder / "data")
    kept = contents(folder / "data")
    assert call.refused(*command).says("but data holds a data set; --overwrite replaces it")
    assert contents(folder / "data") == kept
    assert call(*command, "--overwrite").code == 0
    assert contents(folder / "data") != kept
    Experiment().write(folder / "run" / "experiment.toml")
    for further in ((), ("--overwrite",)):
        assert call.refused(*command[:-1], "run", *further).says("run holds 'experiment.toml'")
    assert [path.name for path in (folder / "run").iterdir()] == ["experiment.toml"]
