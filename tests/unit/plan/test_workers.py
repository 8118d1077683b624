"""Workers on this machine, made up: shares of the processors, what becomes of a slot whose worker died, notes."""

import json
from concurrent.futures import BrokenExecutor, Future

import pytest

from sysid_evo.plan import Store, processes
from sysid_evo.plan.processes import Processes, Slot
from sysid_evo.plan.run_cell import CellEnd, CellLost
from tests.fixtures.cells import Number, number

SHORT, LONG = number(1, label="short"), Number(2, label="long").cell(expected_seconds=9.0)


class MadeUpExecutor:
    """Ends nothing by itself; ``broken`` ones take nothing."""

    def __init__(self, *_, broken=False):
        self.broken, self.asked = broken, []

    def submit(self, function, *arguments):
        if self.broken:
            raise BrokenExecutor
        self.asked.append((function, *arguments))
        return Future()


class MadeUpSlot(Slot):
    """Starts no process."""

    def start(self):
        self.executor = MadeUpExecutor()
        self.starts = getattr(self, "starts", 0) + 1


@pytest.fixture
def workers(tmp_path, monkeypatch):
    monkeypatch.setattr(processes, "usable_processors", lambda: 5)
    made = Processes(Store(tmp_path), [], 2)
    made._slots = [MadeUpSlot(i, tmp_path / f"note{i}") for i in range(2)]
    made._shares = [0, 0]
    return made


def test_processors_are_shared_by_the_busy_and_the_longest_cell_has_the_rest(workers):
    short = workers.submit(SHORT, ())
    assert (workers.n_idle(), workers._shares) == (1, [5, 0])
    workers.submit(LONG, ())
    assert (workers.n_idle(), workers._shares) == (0, [2, 3])
    short.set_result(CellEnd("done"))
    assert workers.result(SHORT, short).status == "done"
    assert (workers.n_idle(), workers._shares[1]) == (1, 5)


def died(workers, cell, how):
    future = workers.submit(cell, ())
    future.set_exception(BrokenExecutor(f"The exit codes of the workers are {{{how}}}"))
    with pytest.raises(CellLost, match="its worker died") as lost:
        workers.result(cell, future)
    return str(lost.value)


def test_a_worker_that_died_is_started_again_but_after_a_kill_there_is_one_less_of_several(workers):
    assert died(workers, SHORT, "EXIT(5)") == "its worker died (EXIT(5))"
    assert [slot.starts for slot in workers._slots] == [2, 1]
    died(workers, SHORT, "SIGKILL(-9)")
    assert workers.n_idle() == 1
    died(workers, SHORT, "SIGKILL(-9)")
    assert [slot.starts for slot in workers._slots] == [2]
    assert workers.n_idle() == 1


def test_a_worker_that_died_while_it_was_idle_costs_no_cell(workers):
    workers._slots[0].executor.broken = True
    workers.submit(SHORT, ())
    (asked,) = workers._slots[0].executor.asked
    assert asked[:2] == (processes.compute, SHORT.digest)


def test_the_progress_of_a_cell_is_in_the_note_of_its_worker(workers):
    workers.submit(SHORT, ())
    note = workers._slots[0].note
    for text in ("", "[", json.dumps([LONG.digest, 1, 2, "of the cell before"])):
        note.write_text(text)
        assert list(workers.progress()) == []
    note.write_text(json.dumps([SHORT.digest, 1, 2, "half"]))
    assert list(workers.progress()) == [(SHORT, 1, 2, "half")]
