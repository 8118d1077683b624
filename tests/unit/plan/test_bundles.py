"""Parcels: what is packed in one folder stands in another as it was, and what is not whole is refused."""

import hashlib

import pytest

from sysid_evo.errors import ArtefactError
from sysid_evo.plan import Again, Plan, Store, execute
from sysid_evo.plan.store import Record, digest_of, packed, unpack
from tests.fixtures.cells import number

ONE, OTHER = number(1, label="one"), number(2, label="other")


@pytest.fixture
def done(tmp_path):
    store = Store(tmp_path / "done")
    execute(Plan.of([ONE, OTHER]), store)
    return store


def test_files_stand_elsewhere_as_they_were_and_in_the_same_order(tmp_path):
    for name in ("b", "a/c"):
        (tmp_path / "from" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "from" / name).write_bytes(name.encode())
    parcel = packed(tmp_path / "from", ["b", "a/c"])
    assert [file.relative_to(tmp_path / "to").as_posix() for file in unpack(parcel, tmp_path / "to")] == ["b", "a/c"]
    assert packed(tmp_path / "to", ["b", "a/c"]) == parcel
    assert digest_of(parcel) == digest_of(packed(tmp_path / "to", ["b", "a/c"]))
    assert len({digest_of(parcel), digest_of(parcel[:1]), digest_of(parcel[::-1])}) == 3


def test_parcels_that_differ_in_anything_have_digests_of_their_own():
    """Also those of which name, time and content are the same characters when they are joined."""
    parcels = (
        (("a", 1, b"2x"),),
        (("a", 12, b"x"),),
        (("a1", 2, b"x"),),
        (("a", 1, b"2x"), ("b", 1, b"")),
        (("a", 1, b"2xb\x001\x000\x00"),),
        (("a", 2, b"2x"),),
        (("a", 1, b"2y"),),
    )
    assert len({digest_of(parcel) for parcel in parcels}) == len(parcels)


@pytest.mark.parametrize("name", ["../out", "/tmp/out", "a/../../out"])
def test_a_file_that_would_stand_outside_is_refused(tmp_path, name):
    with pytest.raises(ArtefactError, match="lies outside the folder that it is sent to"):
        unpack(((name, 0, b"x"),), tmp_path / "in")
    assert list(tmp_path.iterdir()) == []


def test_no_file_is_written_through_a_link(tmp_path):
    (tmp_path / "in").mkdir()
    (tmp_path / "out").mkdir()
    (tmp_path / "in" / "a").symlink_to(tmp_path / "out")
    with pytest.raises(ArtefactError, match="lies outside the folder that it is sent to"):
        unpack((("a/file", 0, b"x"),), tmp_path / "in")
    (tmp_path / "in" / "b").symlink_to(tmp_path / "out" / "b")
    (tmp_path / "out" / "b").write_bytes(b"old")
    unpack((("b", 0, b"x"),), tmp_path / "in")
    assert [file.read_bytes() for file in (tmp_path / "out").iterdir()] == [b"old"]


@pytest.mark.parametrize("name", ["experiment.toml", "evil.py", "cells/other.json", "results/other-12345678.json"])
def test_a_worker_writes_no_file_but_those_of_its_cell(tmp_path, done, name):
    (record_name, _, text), *files = done.parcel(ONE.digest)
    record = Record.model_validate_json(text)
    further = record.model_copy(update={"files": {**record.files, name: hashlib.sha256(b"x").hexdigest()}})
    other = record.model_copy(
        update={"artefact": name.partition(".")[0], "files": {name: hashlib.sha256(b"x").hexdigest()}}
    )
    store = Store(tmp_path / "other")
    for forged, sent in ((further, (*files, (name, 0, b"x"))), (other, ((name, 0, b"x"),))):
        with pytest.raises(ArtefactError, match="is not the whole result of this cell"):
            store.take(ONE, ((record_name, 0, forged.model_dump_json().encode()), *sent))
    assert not store.path.exists()


def test_a_result_that_was_sent_is_that_of_the_cell_and_stands_in_the_log_once(tmp_path, done):
    store = Store(tmp_path / "other")
    store.take(ONE, done.parcel(ONE.digest))
    assert store.load(ONE) == 1
    assert store.parcel(ONE.digest)[0][2] == done.parcel(ONE.digest)[0][2]
    assert (store.path / "log.jsonl").read_text().count(ONE.digest) == 1


def changed(parcel, place, content):
    return tuple((name, time, content if i == place else old) for i, (name, time, old) in enumerate(parcel))


@pytest.mark.parametrize("damage", ["nothing", "no record", "record", "file", "missing file", "further file", "other"])
def test_what_is_no_whole_result_of_the_cell_is_refused_and_nothing_is_written(tmp_path, done, damage):
    parcel = done.parcel(ONE.digest)
    damaged = {
        "nothing": (),
        "no record": parcel[1:],
        "record": changed(parcel, 0, b"{}"),
        "file": changed(parcel, 1, b"7"),
        "missing file": parcel[:1],
        "further file": (*parcel, ("results/more", 0, b"")),
        "other": done.parcel(OTHER.digest),
    }
    store = Store(tmp_path / "other")
    with pytest.raises(ArtefactError, match="count one: what came"):
        store.take(ONE, damaged[damage])
    assert not store.path.exists()


def test_what_is_not_done_has_no_parcel(done):
    with pytest.raises(ArtefactError, match="not computed yet"):
        done.parcel(number(3).digest)


def test_names_of_files_are_those_of_their_copies_wherever_they_stand_in_settings():
    again = Again("m:f", {"plugins": ["/a/p.py", "q"], "deep": {"robot": "/a/p.py"}, "n": 1}, files={"/a/p.py": ("x",)})
    moved = again.with_files_at({"/a/p.py": "/b/0/p.py"})
    assert moved.settings == {"plugins": ["/b/0/p.py", "q"], "deep": {"robot": "/b/0/p.py"}, "n": 1}
    assert again.settings["plugins"] == ["/a/p.py", "q"]


def test_the_values_used_last_are_kept_in_memory(tmp_path, monkeypatch):
    monkeypatch.setattr("sysid_evo.plan.store.IN_MEMORY", 2)
    store = Store(tmp_path)
    cells = [number(i, label=str(i)) for i in range(3)]
    execute(Plan.of(cells[:2]), store)
    store.load(cells[0])
    execute(Plan.of(cells), store)
    assert set(store._values) == {cells[0].digest, cells[2].digest}
    assert [store.load(cell) for cell in cells] == [0, 1, 2]
