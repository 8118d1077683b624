"""Executions: failures are outcomes, finished cells are kept, what is damaged is computed again."""

import json
import re
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest

from sysid_evo.errors import ArtefactError, InvalidData
from sysid_evo.plan import CELL_KINDS, CellKind, Plan, Store, execute, stored
from tests.fixtures.cells import NUMBERS, NamedNumber, Number, Watching, named, number, tolerant


def run(folder, *wanted, only=None):
    """Execute the plan of ``wanted`` in a new store in ``folder``."""
    watching, store = Watching(), Store(folder)
    execute(Plan.of(wanted), store, observer=watching, only=only)
    return watching, store


def fails(error):
    def then():
        raise error

    return then


class Keeping(Number):
    """Finds what it kept the last time, and keeps one more; the first time it is interrupted, the second it fails."""

    def compute(self, work):
        work.checkpoint.parent.mkdir(exist_ok=True)
        kept = int(work.checkpoint.read_text()) if work.checkpoint.exists() else 0
        work.checkpoint.write_text(str(kept + 1))
        if kept < 2:
            raise (KeyboardInterrupt, ValueError)[kept]
        return kept


def record_of(folder, cell):
    return folder / "cells" / f"{cell.digest}.json"


BASE = number(1, label="base")
LEFT, RIGHT = number(2, (BASE,), "left"), number(3, (BASE,), "right")
TOP = number(4, (LEFT, RIGHT), "top")


def test_results_are_handed_on_and_survive_the_process(tmp_path):
    watching, _ = run(tmp_path, TOP)
    assert watching.computed == ["base", "left", "right", "top"]
    again, store = run(tmp_path, TOP)
    assert (again.computed, again.kept) == ([], ["base", "left", "right", "top"])
    assert store.load(TOP) == 4 + 2 + 1 + 3 + 1
    assert store.outcome(LEFT).value == 3
    assert [record.title for record in store.records()] == ["count base", "count left", "count right", "count top"]


def test_the_log_says_when_the_last_of_some_cells_was_computed(tmp_path):
    store = Store(tmp_path)
    assert store.last_computed([BASE]) is None
    times = [(BASE.digest, 86_400.0), (TOP.digest, 172_799.0), (LEFT.digest, 90_000.0)]
    lines = [json.dumps({"time": seconds, "digest": digest}) for digest, seconds in times]
    (tmp_path / "log.jsonl").write_text("\n".join([*lines, "[1]", '{"time": 9e9, "error": "it broke"}', '{"time": 9e']))
    assert store.last_computed([BASE, LEFT]) == datetime(1970, 1, 2, 1, tzinfo=UTC)
    assert store.last_computed([BASE, TOP]) == datetime(1970, 1, 2, 23, 59, 59, tzinfo=UTC)
    assert store.last_computed([RIGHT]) is None


def test_a_result_is_found_under_another_label_and_carries_it(tmp_path):
    store = Store(tmp_path)
    execute(Plan.of([named(5, label="old")]), store)
    for some in (store, Store(tmp_path)):
        assert some.load(named(5, label="new")) == NamedNumber("new", 5)
        assert some.load(named(5, label="old")) == NamedNumber("old", 5)
    assert store.result_path(named(5, label="new")) == store.result_path(named(5, label="old"))
    assert store.result_path(named(5, label="new")).with_suffix(".txt").is_file()


def test_a_cell_that_needs_a_renamed_one_is_handed_its_present_label(tmp_path):
    class Asking(Number):
        def compute(self, work):
            return len(work.result(self.required[0]).label)

    run(tmp_path, named(5, label="old"))
    asking = Asking(1, (named(5, label="newer"),)).cell()
    _, store = run(tmp_path, asking)
    assert store.load(asking) == len("newer")


@pytest.mark.parametrize("error", [InvalidData("too little"), ValueError("too little"), MemoryError("too little")])
def test_a_failure_is_an_outcome_with_reason_and_traceback_and_blocks_what_needs_it(tmp_path, error):
    broken = number(2, (BASE,), "broken", then=fails(error))
    after = number(3, (broken,), "after")
    later = number(4, (after,), "later")
    aside = number(5, (BASE,), "aside")
    watching, store = run(tmp_path, later, aside)
    reason = "too little"
    if not isinstance(error, InvalidData):
        reason = rf"{type(error).__name__}: too little \(test_store.py, line \d+: raise error\)"
    assert re.fullmatch(reason, watching.failed.pop("broken"))
    assert watching.failed == {
        "after": "needs count broken, which failed",
        "later": "needs count after, which failed",
    }
    assert store.load(aside) == 6
    record = store.find(broken.digest)
    assert record.status == "failed"
    assert re.fullmatch(reason, record.reason)
    assert "in then" in (record.traceback or "")
    assert record.seconds >= 0.0
    assert store.find(after.digest) is None  # it was never tried
    assert store.outcome(later).reason == "needs count after, which failed"
    log = [json.loads(line) for line in (tmp_path / "log.jsonl").read_text().splitlines()]
    assert [line["title"] for line in log if line["status"] == "failed"] == ["count broken"]
    assert all("in then" in line["traceback"] for line in log if line["status"] == "failed")


def test_a_failed_cell_is_tried_again_the_next_time(tmp_path):
    run(tmp_path, number(2, label="broken", then=fails(ValueError("for a while"))))
    watching, store = run(tmp_path, number(2, label="mended"))
    assert watching.computed == ["mended"]
    assert store.load(number(2)) == 2


def test_a_result_that_cannot_be_written_as_it_is_is_a_failure_of_its_cell_alone(tmp_path):
    class Odd(Number):
        def compute(self, work):
            return np.zeros(2)

    odd, plain = Odd(7, label="odd").cell(), number(8, label="plain")
    watching, store = run(tmp_path, odd, plain)
    assert "TypeError" in watching.failed["odd"]
    assert store.load(plain) == 8


def test_a_tolerant_cell_is_computed_although_something_it_needs_failed(tmp_path):
    broken = number(2, label="broken", then=fails(ValueError("no")))
    cell = tolerant(1, (BASE, broken), "tolerant")
    _, store = run(tmp_path, cell)
    assert store.load(cell) == 1 + 1 + 1000


def test_a_tolerant_cell_is_computed_again_when_what_had_failed_is_there(tmp_path):
    def shaky(then):
        return tolerant(1, (BASE, number(2, label="shaky", then=then)), "tolerant")

    run(tmp_path, shaky(fails(ValueError("for a while"))))
    still, _ = run(tmp_path, shaky(fails(ValueError("for a while"))))
    assert "tolerant" in still.kept
    mended, store = run(tmp_path, shaky(None))
    assert set(mended.computed) == {"shaky", "tolerant"}
    assert store.load(shaky(None)) == 1 + 1 + 2
    after, _ = run(tmp_path, shaky(None))
    assert not after.computed


def test_only_the_asked_cells_are_computed_and_the_others_are_what_is_known(tmp_path):
    broken = number(2, label="broken", then=fails(ValueError("no")))
    run(tmp_path, broken, BASE)
    cell = tolerant(1, (BASE, number(2, label="broken"), number(9, label="never")), "tolerant")
    watching, store = run(tmp_path, cell, only=(cell,))
    assert watching.computed == ["tolerant"]
    assert store.load(cell) == 1 + 1 + 1000 + 1000


@pytest.mark.parametrize(
    "damage",
    [
        lambda file: file.unlink(),
        lambda file: file.write_text(""),
        lambda file: file.write_bytes(file.read_bytes()[:-20]),
        lambda file: file.write_text("[]"),
        lambda file: file.write_text(file.read_text().replace('"done"', '"finished"')),
        lambda file: file.write_bytes(b"\xff\xfe"),
        lambda file: file.write_text(file.read_text()[:-1] + ', "extra": 1}'),
        lambda file: file.write_text(file.read_text() + " " * 2**22),
    ],
    ids=["missing", "empty", "truncated", "a list", "another status", "no text", "an unknown key", "huge"],
)
def test_a_damaged_or_missing_record_is_computed_again_with_a_remark(tmp_path, damage):
    run(tmp_path, TOP)
    file = record_of(tmp_path, LEFT)
    damage(file)
    missing = not file.exists()
    watching, store = run(tmp_path, TOP)
    assert watching.computed == ["left"]
    assert [f"{file} is damaged" in remark for remark in watching.remarks] == ([] if missing else [True])
    assert store.load(TOP) == 11


@pytest.mark.parametrize(
    "damage",
    [lambda file: file.unlink(), lambda file: file.write_text(""), lambda file: file.write_text("4")],
    ids=["missing", "truncated", "foreign"],
)
def test_a_damaged_or_missing_result_is_computed_again_with_a_remark(tmp_path, damage):
    run(tmp_path, TOP)
    (file,) = (tmp_path / "results").glob("left-*.txt")
    damage(file)
    watching, store = run(tmp_path, TOP)
    assert watching.computed == ["left"]
    assert watching.remarks == [f"results/{file.name} is missing or damaged: count left is computed again"]
    assert store.load(LEFT) == 3


def test_a_result_whole_on_disk_that_cannot_be_read_any_more_is_computed_again(tmp_path, monkeypatch):
    def load(path):
        raise ArtefactError("of an older version")

    base = number(1, label="base")
    run(tmp_path, base)
    monkeypatch.setitem(CELL_KINDS, "number", CellKind(replace(NUMBERS, load=load)))
    watching, store = run(tmp_path, number(2, (base,), "after"))
    assert watching.computed == ["base", "after"]
    assert len(watching.remarks) == 1
    assert "of an older version: count base is computed again" in watching.remarks[0]
    assert store.load(number(2, (base,))) == 3


def test_a_cell_of_which_only_the_record_is_known_is_loaded_and_not_computed(tmp_path):
    _, store = run(tmp_path, BASE, tolerant(3, (BASE,), "top"))
    known = stored(store.find(BASE.digest))
    assert known == BASE
    assert (known.name, known.title, known.settings.inputs()) == ("base", "count base", {"number": 1})
    assert Store(tmp_path).load(known) == 1
    next((tmp_path / "results").glob("base-*.txt")).unlink()
    watching, _ = run(tmp_path, known)
    missing = f"results/base-{BASE.digest[:8]} is missing or damaged and cannot be computed here: rerun the command"
    assert watching.failed["base"].startswith(missing)
    assert set(watching.failed) == {"base"}


def test_the_record_of_another_cell_is_not_taken_for_this_one(tmp_path):
    run(tmp_path, LEFT, RIGHT)
    record_of(tmp_path, LEFT).write_bytes(record_of(tmp_path, RIGHT).read_bytes())
    watching, store = run(tmp_path, LEFT)
    assert watching.computed == ["left"]
    assert "it is the record of another cell" in watching.remarks[0]
    assert store.load(LEFT) == 3


@pytest.mark.parametrize("name", ["../outside.txt", "/etc/hostname", "results/../../outside.txt"])
@pytest.mark.parametrize("key", ["artefact", "files"])
def test_a_record_that_leads_out_of_the_folder_is_damaged(tmp_path, name, key):
    folder = tmp_path / "run"
    (tmp_path / "outside.txt").write_text("77")
    run(folder, BASE)
    file = record_of(folder, BASE)
    record = json.loads(file.read_text())
    record[key] = name.removesuffix(".txt") if key == "artefact" else {name: "0" * 64}
    file.write_text(json.dumps(record))
    watching, store = run(folder, BASE)
    assert watching.computed == ["base"]
    assert "is outside the run folder" in watching.remarks[0]
    assert store.load(BASE) == 1


@pytest.mark.parametrize("title", ["a/b", "../../etc", "..", "", "é mit ß", "a" * 300, "x@y (1, 2)", ".hidden", "a\nb"])
def test_files_of_any_title_stay_in_the_folder_and_are_found_again(tmp_path, title):
    folder = tmp_path / "run"
    cell = number(1, label=title)
    _, store = run(folder, cell)
    place = store.new_path(cell)
    assert place.parent == folder / "results"
    assert not place.name.startswith((".", "-"))
    assert len(place.name) < 80
    assert [file.parent.parent for file in tmp_path.rglob("*.txt")] == [folder]
    again, store = run(folder, cell)
    assert again.kept == [title]
    assert store.load(cell) == 1


def test_two_cells_of_one_name_do_not_share_files(tmp_path):
    one, two = number(1, label="same"), number(2, label="same")
    _, store = run(tmp_path, one, two)
    assert store.new_path(one) != store.new_path(two)
    assert (Store(tmp_path).load(one), Store(tmp_path).load(two)) == (1, 2)


def test_a_full_disk_stops_the_run_and_finished_cells_are_kept(tmp_path):
    full = Number(2, (BASE,), "right in the middle").cell("unstorable number")
    with pytest.raises(OSError, match="No space left"):
        run(tmp_path, full, number(3, (full,), "after"))
    assert Store(tmp_path).load(BASE) == 1
    assert Store(tmp_path).find(full.digest) is None
    watching, store = run(tmp_path, number(3, (number(2, (BASE,), "right in the middle"),), "after"))
    assert watching.kept == ["base"]
    assert store.load(number(2, (BASE,))) == 3


def test_an_interruption_stops_the_run_and_leaves_no_record_of_the_cell(tmp_path):
    stopped = number(2, (BASE,), "stopped", then=fails(KeyboardInterrupt()))
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path, stopped)
    assert Store(tmp_path).find(stopped.digest) is None
    with Store(tmp_path).claim(stopped) as ours:
        assert ours


def test_a_cell_may_ask_only_for_what_it_needs(tmp_path):
    class Curious(Number):
        def compute(self, work):
            return int(work.result(number(99, label="ninety-nine")))

    watching, _ = run(tmp_path, Curious(1, label="curious").cell())
    assert "count ninety-nine is not among the needs" in watching.failed["curious"]


def test_the_observer_gets_the_remaining_work(tmp_path):
    told = []

    class Counting(Watching):
        def plan(self, cells, kept, seconds):
            told.append((cells, kept, seconds))

    run(tmp_path, LEFT)
    execute(Plan.of([TOP]), Store(tmp_path), observer=Counting())
    assert told == [(4, 2, 2.0)]


def test_a_store_that_nothing_was_put_into_writes_nothing(tmp_path):
    store = Store(tmp_path / "none")
    assert not store.done(BASE)
    assert store.outcome(BASE).reason == "not computed yet"
    assert store.records() == []
    assert not (tmp_path / "none").exists()
    with pytest.raises(ArtefactError, match="count base: not computed yet"):
        store.load(BASE)


def test_what_a_cell_keeps_meanwhile_stays_until_it_is_done(tmp_path):
    store, plan = Store(tmp_path), Plan.of([Keeping().cell()])
    with pytest.raises(KeyboardInterrupt):
        execute(plan, store)
    (failed,) = execute(plan, store).values()
    assert failed.failed
    (done,) = execute(plan, store).values()
    assert not done.failed
    assert store.load(plan.cells[0]) == 2
    assert not store.checkpoint(plan.cells[0]).exists()
