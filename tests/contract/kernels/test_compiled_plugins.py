"""The compiled form of a plugin: one that differs is caught, one that agrees or that is missing is not."""

import re

import pytest

from hardware.testing import CONTRACTS
from sysid_evo.testing.contract import rule_of
from tests.fixtures import broken_controllers, broken_models, broken_robots, broken_tasks
from tests.fixtures.kits import broken

CASES = {
    "model": broken_models,
    "task": broken_tasks,
    "controller": broken_controllers,
    "robot": broken_robots,
}
BROKEN = [(kind, one) for kind, cases in CASES.items() for one in cases.BROKEN_FORMS]


@pytest.mark.parametrize(("kind", "one"), BROKEN, ids=CASES)
def test_a_compiled_form_that_differs_is_caught(kind, one, register):
    register(CONTRACTS[kind].registry, "broken", one.plugin)
    ((said, reason),) = broken(CONTRACTS[kind].run("broken")).items()
    assert said == rule_of(one.check)
    assert re.search(one.reason, reason)


def test_a_compiled_form_that_agrees_is_not(register):
    register(CONTRACTS["model"].registry, "sound", broken_models.Compiled)
    assert not any(result.failure or "compiled" in result.idle for result in CONTRACTS["model"].run("sound"))


@pytest.mark.parametrize("kind", CASES)
def test_the_kit_reports_a_missing_compiled_form(kind, register):
    register(CONTRACTS[kind].registry, "sound", CASES[kind].SOUND[0])
    idle = {result.rule: result.idle for result in CONTRACTS[kind].run("sound")}
    assert idle[rule_of(CASES[kind].BROKEN_FORMS[0].check)].startswith("it has no compiled form: Python computes every")
