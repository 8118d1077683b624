"""A mistake is one message and exit code 2, before any work; nothing is written."""

import errno

import pytest

from sysid_evo.cli.console import error_sentence
from tests.fixtures.commands import Caller
from tests.fixtures.mistakes import MISTAKES, prepare


@pytest.fixture(scope="module")
def prepared(tmp_path_factory):
    folder = tmp_path_factory.mktemp("mistakes")
    prepare(folder)
    return folder


@pytest.mark.parametrize("mistake", MISTAKES, ids=lambda mistake: mistake.what)
def test_a_mistake_is_reported_before_any_work_and_nothing_is_written(mistake, prepared, capsys):
    before = sorted(prepared.rglob("*"))
    ended = Caller(prepared, capsys)(*mistake.arguments)
    assert ended.says(mistake.said), ended.stderr
    assert ended.code == 2
    assert "Traceback" not in ended.stderr
    assert not ended.stdout
    assert sorted(prepared.rglob("*")) == before


def test_debug_shows_the_traceback(call):
    assert "Traceback" in call.refused("compare", "--models", "linaer", "--debug").stderr


def test_only_an_error_that_interrupts_work_offers_to_continue():
    full, nowhere = OSError(errno.ENOSPC, "No space left", "run"), OSError(errno.ENOENT, "No such file", "/proc/x")
    assert error_sentence(full).startswith("run: No space left. Finished results are kept")
    assert error_sentence(nowhere) == "/proc/x: No such file"
