"""How a scheduler is named and reached, without a cluster."""

from __future__ import annotations

import logging

import dask
import distributed
import pytest

from sysid_evo.errors import InvalidArgument, SchedulerLost
from sysid_evo.plan.dask_executor import address_of, connected


class MadeUpClient(distributed.Client):
    """A client of nothing."""

    made: list[MadeUpClient]

    def __init__(self, address="", **options):
        self.address, self.options, self.closed = address, options, False
        self.level = logging.getLogger("distributed.client").level
        type(self).made.append(self)

    def __del__(self):
        pass

    @property
    def asynchronous(self):
        return bool(self.options.get("asynchronous"))

    def close(self, *_, **__):
        self.closed = True


@pytest.fixture(autouse=True)
def made(monkeypatch):
    """The clients that were made."""
    MadeUpClient.made = []
    monkeypatch.setattr(distributed, "Client", MadeUpClient)
    yield MadeUpClient.made
    MadeUpClient.made = []


def test_a_client_is_made_of_an_address_without_becoming_that_of_others_and_closed_in_the_end(made):
    log = logging.getLogger("distributed.client")
    before = log.level
    with connected("tcp://127.0.0.1:9") as client:
        assert client is made[0]
        assert [one.closed for one in made] == [False]
        assert log.level == logging.CRITICAL
    assert (made[0].address, made[0].options["set_as_default"]) == ("tcp://127.0.0.1:9", False)
    assert made[0].level == logging.CRITICAL
    assert [one.closed for one in made] == [True]
    assert log.level == before


def test_a_client_that_was_given_stays_open_and_must_be_one_that_waits():
    given = MadeUpClient()
    with connected(given) as client:
        assert client is given
    assert not given.closed
    with (
        pytest.raises(InvalidArgument, match="expected a synchronous Client"),
        connected(MadeUpClient(asynchronous=True)),
    ):
        pass


def test_where_nobody_answers_the_error_says_what_to_do(monkeypatch):
    def refuse(*_, **__):
        raise OSError("timed out\nafter 1 s")

    monkeypatch.setattr(MadeUpClient, "__init__", refuse)
    with pytest.raises(SchedulerLost) as lost, connected("tcp://127.0.0.1:9"):
        pass
    assert "no scheduler answers at tcp://127.0.0.1:9 (timed out): start one with 'dask scheduler'" in str(lost.value)
    assert "the same command goes on from there" in str(lost.value)
    assert logging.getLogger("distributed.client").level != logging.CRITICAL


def test_certificates_are_asked_for_where_the_address_needs_some(made):
    with (
        dask.config.set({"distributed.comm.tls.client.cert": None}),
        pytest.raises(InvalidArgument, match=r"scheduler tls://127\.0\.0\.1:9: expected certificates"),
        connected("tls://127.0.0.1:9"),
    ):
        pass
    assert made == []


def test_an_address_stands_in_the_file_of_a_scheduler(tmp_path):
    (tmp_path / "there.json").write_text('{"address": "tcp://127.0.0.1:9", "id": "x"}')
    assert address_of(str(tmp_path / "there.json")) == "tcp://127.0.0.1:9"
    assert address_of("tls://there:1") == "tls://there:1"


@pytest.mark.parametrize("text", ["{", "[1]", "{}", "3"])
def test_a_file_that_is_not_a_schedulers_is_named(tmp_path, text):
    (tmp_path / "odd.json").write_text(text)
    with pytest.raises(InvalidArgument, match=r"expected the file of a scheduler, .*odd\.json is none"):
        address_of(str(tmp_path / "odd.json"))
