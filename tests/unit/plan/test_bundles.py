"""Bundles: files of one folder arrive unchanged in another, and incomplete results are refused."""

import hashlib

import pytest

from sysid_evo.errors import ArtefactError
from sysid_evo.plan import Plan, Store, execute
from sysid_evo.plan.store import CellRecord, unpack
from tests.fixtures.cells import number

ONE, OTHER = number(1, label="one"), number(2, label="other")


@pytest.fixture
def done(tmp_path):
    store = Store(tmp_path / "done")
    execute(Plan.of([ONE, OTHER]), store)
    return store


def test_files_arrive_unchanged_and_in_the_same_order(tmp_path, done):
    bundle = done.bundle(ONE.digest)
    assert bundle[0][0] == f"cells/{ONE.digest}.json"
    files = unpack(bundle, tmp_path / "to")
    assert [file.relative_to(tmp_path / "to").as_posix() for file in files] == [name for name, _, _ in bundle]
    assert Store(tmp_path / "to").bundle(ONE.digest) == bundle
    assert Store(tmp_path / "to").load(ONE) == 1


@pytest.mark.parametrize("name", ["../out", "/tmp/out", "a/../../out"])
def test_a_file_outside_the_folder_is_refused(tmp_path, name):
    with pytest.raises(ArtefactError, match="is outside the target folder"):
        unpack(((name, 0, b"x"),), tmp_path / "in")
    assert list(tmp_path.iterdir()) == []


def test_no_file_is_written_through_a_link(tmp_path):
    (tmp_path / "in").mkdir()
    (tmp_path / "out").mkdir()
    (tmp_path / "in" / "a").symlink_to(tmp_path / "out")
    with pytest.raises(ArtefactError, match="is outside the target folder"):
        unpack((("a/file", 0, b"x"),), tmp_path / "in")
    (tmp_path / "in" / "b").symlink_to(tmp_path / "out" / "b")
    (tmp_path / "out" / "b").write_bytes(b"old")
    unpack((("b", 0, b"x"),), tmp_path / "in")
    assert [file.read_bytes() for file in (tmp_path / "out").iterdir()] == [b"old"]


@pytest.mark.parametrize(
    "name",
    [
        "experiment.toml", "evil.py", "cells/other.json", "results/other-12345678.json",
        f"models/one-{ONE.digest[:8]}.txt",
    ],
)  # fmt: skip
def test_a_worker_writes_no_file_but_those_of_its_cell(tmp_path, done, name):
    (record_name, _, text), *files = done.bundle(ONE.digest)
    record = CellRecord.model_validate_json(text)
    further = record.model_copy(update={"files": {**record.files, name: hashlib.sha256(b"x").hexdigest()}})
    other = record.model_copy(
        update={"artefact": name.partition(".")[0], "files": {name: hashlib.sha256(b"x").hexdigest()}}
    )
    store = Store(tmp_path / "other")
    for forged, sent in ((further, (*files, (name, 0, b"x"))), (other, ((name, 0, b"x"),))):
        with pytest.raises(ArtefactError, match="the received files are not the complete result of this cell"):
            store.receive(ONE, ((record_name, 0, forged.model_dump_json().encode()), *sent))
    assert not store.path.exists()


def test_a_result_that_was_sent_is_that_of_the_cell_and_is_logged_once(tmp_path, done):
    store = Store(tmp_path / "other")
    store.receive(ONE, done.bundle(ONE.digest))
    assert store.load(ONE) == 1
    assert store.bundle(ONE.digest)[0][2] == done.bundle(ONE.digest)[0][2]
    assert (store.path / "log.jsonl").read_text().count(ONE.digest) == 1


def changed(bundle, place, content):
    return tuple((name, time, content if i == place else old) for i, (name, time, old) in enumerate(bundle))


@pytest.mark.parametrize(
    "damage", ["nothing", "no record", "record", "failed", "file", "missing file", "further file", "other"]
)
def test_what_is_no_whole_result_of_the_cell_is_refused_and_nothing_is_written(tmp_path, done, damage):
    bundle = done.bundle(ONE.digest)
    damaged = {
        "nothing": (),
        "no record": bundle[1:],
        "record": changed(bundle, 0, b"{}"),
        "failed": changed(bundle, 0, bundle[0][2].replace(b'"status": "done"', b'"status": "failed"')),
        "file": changed(bundle, 1, b"7"),
        "missing file": bundle[:1],
        "further file": (*bundle, ("results/more", 0, b"")),
        "other": done.bundle(OTHER.digest),
    }
    store = Store(tmp_path / "other")
    with pytest.raises(ArtefactError, match="count one: the received"):
        store.receive(ONE, damaged[damage])
    assert not store.path.exists()


def test_what_is_not_done_has_no_bundle(done):
    with pytest.raises(ArtefactError, match="not computed yet"):
        done.bundle(number(3).digest)


def test_the_values_used_last_are_kept_in_memory(tmp_path, monkeypatch):
    monkeypatch.setattr("sysid_evo.plan.store.IN_MEMORY", 2)
    store = Store(tmp_path)
    cells = [number(i, label=str(i)) for i in range(3)]
    execute(Plan.of(cells[:2]), store)
    store.load(cells[0])
    execute(Plan.of(cells), store)
    assert set(store._values) == {cells[0].digest, cells[2].digest}
    assert [store.load(cell) for cell in cells] == [0, 1, 2]
