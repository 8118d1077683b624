"""Names from anybody's files reach a terminal as text: no control characters, no markup."""

import io

import numpy as np
import pytest

from evaluation import load_measured
from sysid_evo.cli import console, progress
from sysid_evo.cli.console import Printer
from sysid_evo.cli.progress import PlanProgress
from sysid_evo.errors import UNSEEN
from sysid_evo.progress import progress_bar
from tests.fixtures.commands import run_here

EVIL = "\x1b]0;owned\x07\x1b[2J\x9b31m\r\u202e[link=file:///]:boom:"
QUOTED = EVIL.encode("unicode_escape").decode().replace("\\x", "\\u00")
MAP = f"""
name = "{QUOTED}"
dt = 0.05
[time]
column = "t"
[states."speed{QUOTED}"]
column = "v{QUOTED}"
unit = "m/s"
[controls."push{QUOTED}"]
column = "u"
"""


def unseen(*texts):
    """Return the characters of ``texts`` that must not be printed."""
    return {character for text in texts for character in text if ord(character) in UNSEEN}


@pytest.fixture(scope="module")
def hostile(tmp_path_factory):
    """A folder with a log and a map whose name, headers and channels hold escapes."""
    folder = tmp_path_factory.mktemp("hostile")
    rng = np.random.default_rng(0)
    push, speed = rng.choice([-1.0, 1.0], 400), np.zeros(400)
    for i in range(399):
        speed[i + 1] = 0.95 * speed[i] + 0.1 * push[i]
    rows = "".join(f"{0.05 * i},{speed[i]},{push[i]}\n" for i in range(400))
    (folder / f"log{EVIL.replace('/', '')}.csv").write_text(f"t,v{EVIL.replace(chr(13), '')},u\n" + rows)
    (folder / "map.toml").write_text(MAP.replace(f'"v{QUOTED}"', f'"v{QUOTED}"'.replace("\\r", "")))
    done = run_here("fit", ".", "--columns", "map.toml", "--models", "linear", "--out", "run", cwd=folder)
    assert done.returncode == 0, done.stderr
    assert not unseen(done.stdout, done.stderr)
    return folder


@pytest.mark.parametrize(
    ("command", "code", "stays"),
    [
        (("inspect", ".", "--columns", "map.toml"), 0, "]0;owned[2J31m[link=file:///]:boom:"),
        (("import", ".", "--columns", "map.toml", "--out", "data"), 0, "log]0;owned[2J31m[link=file:]:boom:"),
        (("import", ".", "--out", "data"), 2, "v]0;owned"),
        (("models", "show", "run/models/linear"), 0, "push]0;owned[2J31m[link=file:///]:boom:"),
        (("runs", "show", "run"), 0, "linear"),
        (("fit", ".", "--columns", "map.toml", "--models", f"'{EVIL}'"), 2, "owned"),
        (("robots", "check", f"{EVIL}.toml"), 2, "robot file ]0;owned"),
        (("report", EVIL), 2, "owned"),
        (("report", "run", EVIL), 2, "owned"),
        ((EVIL,), 2, "owned"),
    ],
)
def test_no_command_prints_a_control_character(command, code, stays, hostile, tmp_path):
    done = run_here(*(str(tmp_path / "data") if word == "data" else word for word in command), cwd=hostile)
    assert done.returncode == code, done.stderr
    said = done.stdout + done.stderr
    assert "".join(stays.split()) in "".join(said.split())
    assert not unseen(said)


DEEP = "[" * 3000 + "]" * 3000


@pytest.mark.parametrize(
    "command",
    [
        ("inspect", "log.csv", "--columns", "odd.toml"),
        ("robots", "check", "odd.toml"),
        ("compare", "--config", "odd.toml"),
        ("study", "odd.toml"),
    ],
)
def test_a_file_that_is_nested_or_long_without_end_is_refused_in_a_sentence(command, call):
    (call.folder / "log.csv").write_text("t,x\n0,1\n1,2\n")
    for value in (DEEP, "{a=" * 30 + "1" + "}" * 30, "1" * 4301, f'"{"x" * 2**20}"'):
        (call.folder / "odd.toml").write_text(f'driver = "emulated_car"\nname = {value}\n')
        ended = call.refused(*command)
        assert ended.says("odd.toml")
        assert ended.says("expected at most") or ended.says("4300 digits")
        assert len(" ".join(ended.stderr.split())) < 500


def test_json_that_is_nested_without_end_counts_as_damaged(call):
    places = ("data/dataset.json", "run/report.json", "run/experiment.toml", "run/results/measured/x.json")
    for place in places:
        (call.folder / place).parent.mkdir(parents=True, exist_ok=True)
        (call.folder / place).write_text("" if place.endswith("toml") else "[" * 10**5 + "]" * 10**5)
    for command in (("inspect", "data"), ("runs", "diff", "run", "run")):
        assert call.refused(*command).says("not a readable")
    _, (remark,) = load_measured(call.folder / "run")
    assert "x.json is damaged and left out" in remark


def test_lines_and_tables_show_markup_and_emoji_as_text():
    written, table = io.StringIO(), console.table_of("name")
    table.add_row(EVIL)
    for text in (EVIL, table):
        Printer(file=written, width=200).print(text)
    assert written.getvalue().count("]0;owned[2J31m[link=file:///]:boom:") == 2


def test_bars_show_titles_and_remarks_as_text(monkeypatch, capsys):
    written = io.StringIO()
    for module in (console, progress):
        monkeypatch.setattr(module, "err", Printer(file=written, force_terminal=True, width=200))
    with PlanProgress() as bars:
        bars.begin(EVIL)
        bars.advance(1, 2, EVIL)
        bars._bars.refresh()
        bars.end(EVIL, EVIL)
    said = written.getvalue()
    assert "]0;owned[2J31m[link=file:///]:boom:" in said
    for command in ("\x1b]", "\x07", "\x1b[2J\x9b", "\u202e"):
        assert command not in said
    with progress_bar(EVIL) as update:
        update(1, 2, EVIL)
    assert not unseen(capsys.readouterr().err)
