"""Digests, the store, names and their grammar, exit codes."""

from tests.mutation.change import Change

CELL = "sysid_evo/plan/cell.py"
STORE = "sysid_evo/plan/store.py"
EXECUTION = "sysid_evo/plan/executors.py"
CELLS = "evaluation/cells/controllers.py"
REGISTRY = "sysid_evo/registry/registry.py"
SPEC = "sysid_evo/registry/grammar.py"
TEST_PLAN = ("tests/sysid_evo/plan/test_plan.py",)
TEST_EXECUTION = ("tests/sysid_evo/plan/test_execution.py",)
TEST_SIDE_BY_SIDE = ("tests/sysid_evo/plan/test_side_by_side.py",)
TEST_REGISTRY = ("tests/sysid_evo/test_registry.py",)
TEST_SPEC = ("tests/sysid_evo/test_spec.py",)
TEST_ARTEFACTS = ("tests/sysid_evo/test_artefacts.py",)
TEST_FOUND_AGAIN = ("tests/evaluation/test_found_again.py",)

CHANGES = (
    Change("a result is found whatever it was made with", CELL, '"inputs": self.inputs(),', '"inputs": {},', TEST_PLAN),
    Change(
        "a result is found whatever it was made of",
        CELL,
        '"needs": [cell.digest for cell in self.needs],',
        '"needs": [],',
        TEST_PLAN,
    ),
    Change("a result of an older contract is found", CELL, '"contract": CONTRACT,', '"contract": 0,', TEST_PLAN),
    Change(
        "a controller of another strategy is found",
        CELLS,
        '"strategy": strategies.identity(settings.strategy),',
        '"strategy": "",',
        TEST_FOUND_AGAIN,
    ),
    Change(
        "a controller evolved without delay is found",
        CELLS,
        '"estimator_delay": settings.estimator_delay,',
        '"estimator_delay": 0.0,',
        TEST_FOUND_AGAIN,
    ),
    Change(
        "a claim is measured without the delay of evolution",
        "evaluation/cells/assessment.py",
        "self.column.runner(work, delay=self.delay),",
        "self.column.runner(work, delay=0.0),",
        TEST_FOUND_AGAIN,
    ),
    Change(
        "a plugin that has changed gives its old results",
        REGISTRY,
        '"source": source_digest(self.get(found.name)),',
        '"source": None,',
        (*TEST_REGISTRY, *TEST_FOUND_AGAIN),
    ),
    Change(
        "a damaged result is taken for whole",
        STORE,
        "if _digest(self.path / name) != digest:",
        "if not (self.path / name).is_file():",
        TEST_EXECUTION,
    ),
    Change(
        "a failed cell counts as done",
        STORE,
        'if record is None or record.status != "done":\n            return False',
        "if record is None:\n            return False",
        TEST_EXECUTION,
    ),
    Change(
        "two processes compute one cell",
        STORE,
        "yield False",
        "yield True",
        ("tests/sysid_evo/plan/test_two_processes.py",),
    ),
    Change(
        "the record of another cell is believed",
        STORE,
        "if record.digest != file.stem:",
        "if not record.digest:",
        TEST_EXECUTION,
    ),
    Change(
        "a record leads out of the run folder",
        "sysid_evo/plan/store.py",
        'return not path.is_absolute() and ".." not in path.parts',
        "return not path.is_absolute()",
        TEST_EXECUTION,
    ),
    Change(
        "a full disk is the failure of one cell",
        "sysid_evo/plan/run_state.py",
        "except OSError:  # a full disk",
        "except MemoryError:  # a full disk",
        TEST_EXECUTION,
    ),
    Change(
        "Ctrl-C is the failure of one cell",
        "sysid_evo/plan/run_state.py",
        "except Exception as error:  # whatever a plugin does",
        "except BaseException as error:  # whatever a plugin does",
        TEST_EXECUTION,
    ),
    Change(
        "what was assessed without a cell is never assessed again",
        "sysid_evo/plan/run_state.py",
        "if self.store.done(cell) and not self.without(cell)]",
        "if self.store.done(cell)]",
        TEST_EXECUTION,
    ),
    Change(
        "a process that ends without a word costs its cell at once",
        "sysid_evo/plan/run_state.py",
        "TRIES = 2",
        "TRIES = 1",
        TEST_SIDE_BY_SIDE,
    ),
    Change(
        "a cell alone is left with one processor while the others idle",
        "sysid_evo/plan/processes.py",
        "processors // len(working) + (i < processors % len(working))",
        "1",
        TEST_SIDE_BY_SIDE,
    ),
    Change(
        "cells are handed out before what they need is there",
        "sysid_evo/plan/processes.py",
        "if cell not in busy and not self.ledger.waits(cell) and",
        "if cell not in busy and",
        TEST_SIDE_BY_SIDE,
    ),
    Change(
        "the yardstick of a recorded run is not planned again",
        "evaluation/planning.py",
        'isinstance(data, RecordedData) or "robot" in data.inputs()',
        "isinstance(data, RecordedData)",
        ("tests/evaluation/test_side_by_side.py",),
    ),
    Change(
        "a model under two labels is driven twice",
        "evaluation/planning.py",
        "any(map(column.is_same, champion.members))",
        "column in champion.members",
        ("tests/evaluation/test_comparison.py::test_what_is_the_same_under_two_labels_is_computed_once",),
    ),
    Change(
        "a crash leaves half a file",
        "sysid_evo/files.py",
        'temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")',
        "temporary = path",
        ("tests/sysid_evo/test_files.py",),
    ),
    Change(
        "an artefact with a flipped bit is loaded",
        "sysid_evo/artefacts.py",
        "if digest != manifest.sha256:",
        "if not digest:",
        TEST_ARTEFACTS,
    ),
    Change(
        "a controller is loaded as a model",
        "sysid_evo/artefacts.py",
        "if manifest.kind != kind:",
        "if not manifest.kind:",
        TEST_ARTEFACTS,
    ),
    Change("a plugin takes a shipped name", REGISTRY, "if owners:", "if owners and not name:", TEST_REGISTRY),
    Change(
        "a parameter that there is not is handed to the constructor",
        REGISTRY,
        "if name not in known and None not in known:",
        "if name not in known and None in known:",
        TEST_REGISTRY,
    ),
    Change(
        "of several extras the first one is named, which may be all",
        "sysid_evo/extras.py",
        "key=lambda e: (len(brings[e]), e)",
        "key=lambda e: e",
        TEST_REGISTRY,
    ),
    Change("commas inside brackets separate specs", SPEC, "elif depth == 0:", "else:", TEST_SPEC),
    Change(
        "one label stands for two things",
        SPEC,
        "if repeated is not None:",
        "if repeated is not None and not labels:",
        TEST_SPEC,
    ),
    Change(
        "a parameter given twice counts once",
        SPEC,
        "if argument.arg in found:",
        "if argument.arg in found and not piece:",
        TEST_SPEC,
    ),
    Change(
        "a wrong argument ends with another exit code",
        "sysid_evo/cli/console.py",
        "WRONG_INPUT = 2",
        "WRONG_INPUT = 1",
        (
            "tests/sysid_evo/cli/test_mistakes.py::test_in_a_process_of_its_own_the_error_stands_on_standard_error_and_nothing_else",
        ),
    ),
    Change(
        "a comparison of which a family failed ends as if nothing had",
        "sysid_evo/cli/console.py",
        "SOME_FAILED = 3",
        "SOME_FAILED = 0",
        ("tests/sysid_evo/cli/test_outcomes.py::test_a_family_that_fails_is_exit_code_3_with_a_report_and_its_reason",),
    ),
    Change(
        "a robot that does not answer is wrong input",
        "sysid_evo/cli/console.py",
        "ROBOT = 4",
        "ROBOT = 2",
        ("tests/sysid_evo/cli/test_driving.py::test_robot_that_does_not_answer_is_a_message_and_an_exit_code",),
    ),
)
