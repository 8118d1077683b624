"""Four questions to the contract of every kind of plugin, and what is special about one kind."""

import re
from typing import ClassVar

import pytest

from hardware.testing import CONTRACTS, check_robot
from sysid_evo.data import Dataset
from sysid_evo.errors import ContractViolation, IncompatibleSystem, IncompatibleTask, InvalidArgument, RegistrationError
from sysid_evo.models import DynamicsModel, require_planar
from sysid_evo.registry import Spec, make_robot, models, robots, tasks
from sysid_evo.tasks.references import SetPoint
from sysid_evo.testing import (
    MODEL,
    check_adapter,
    check_controller,
    check_model,
    check_reader,
    check_strategy,
    check_task,
)
from sysid_evo.testing import models as model_kit
from sysid_evo.testing.contract import MADE, rule_of
from sysid_evo.testing.examples import (
    ExampleDynamics,
    bare_system,
    continuous_car,
    example_systems,
)
from sysid_evo.testing.template import PLUGINS
from tests.fixtures import broken_adapters as of_adapters
from tests.fixtures import broken_controllers as of_controllers
from tests.fixtures import broken_models as of_models
from tests.fixtures import broken_readers as of_readers
from tests.fixtures import broken_robots as of_robots
from tests.fixtures import broken_strategies as of_strategies
from tests.fixtures import broken_tasks as of_tasks
from tests.fixtures.kits import broken, failing
from tests.fixtures.systems import TASKS_WITH_ARGUMENTS

CASES = {
    "model": (check_model, of_models),
    "task": (check_task, of_tasks),
    "controller": (check_controller, of_controllers),
    "strategy": (check_strategy, of_strategies),
    "adapter": (check_adapter, of_adapters),
    "robot": (check_robot, of_robots),
    "reader": (check_reader, of_readers),
}
OPTIONS = {
    "lqr": {"model": ExampleDynamics(continuous_car()), "at": SetPoint(horizon=60).bind(continuous_car())},
    "predictive": {"model": ExampleDynamics(continuous_car()), "horizon": 6, "samples": 24},
}
"""What a controller cannot do without."""
OTHER_ARGUMENTS = [
    ("strategy", "cma_es(population=4)", ()),
    ("strategy", "mu_plus_lambda(reevaluate=false)", ()),
    ("strategy", "niches(strategy=mu_plus_lambda(parents=5, children=5), slots=1)", ()),
    ("controller", "feed_forward(hidden=[5, 3, 4])", ()),
    ("controller", "linear(inputs=[waypoint_angle])", ()),
    ("controller", "pid(loops={steer: [waypoint_angle, yaw_rate]})", ()),
    ("controller", "pursuit(backward=true)", ()),
    *(("task", spec, (system,)) for spec, system in TASKS_WITH_ARGUMENTS),
]
ELSEWHERE = ("mujoco",)
"""Tested in `test_simulated_robots`, which has a file for it."""
REGISTERED = [
    (kind, name)
    for kind, one in CONTRACTS.items()
    if kind != "model"
    for name in one.registry.names()
    if name not in ELSEWHERE
]
SOUND = [(kind, one) for kind, (_, cases) in CASES.items() for one in cases.SOUND]
BROKEN = [
    pytest.param(kind, one, id=f"{kind}-{one.check.__name__}-{number}")
    for kind, (_, cases) in CASES.items()
    for number, one in enumerate(cases.BROKEN)
]


@pytest.fixture
def given(tmp_path):
    """Arguments of the kit of a kind in addition to the name."""
    return lambda kind: (of_readers.write_lines(tmp_path),) if kind == "reader" else ()


def test_every_kind_with_a_template_has_a_kit_and_its_cases():
    assert set(CONTRACTS) == set(CASES) == set(PLUGINS)


@pytest.mark.parametrize("kind", CONTRACTS)
def test_every_registered_name_can_be_loaded(kind):
    """A plugin that cannot is a warning, which fails a test."""
    registry = CONTRACTS[kind].registry
    assert [name for name, _ in registry.load_all()] == list(registry.names())


@pytest.mark.parametrize(("kind", "name"), REGISTERED)
def test_every_registered_plugin_keeps_its_contract(kind, name, tmp_path, monkeypatch):
    """Model families are tested in `test_families`; a physical robot is not connected."""
    if kind == "robot" and make_robot(name).dynamics is None:
        monkeypatch.setattr(robots.get(name), "connect", lambda *_, **__: pytest.fail("it was connected"))
    file = (of_readers.FILES[name](tmp_path),) if kind == "reader" else ()
    options = OPTIONS.get(name, {"horizon": 40} if kind == "task" else {})
    assert broken(CONTRACTS[kind].run(name, *file, **options)) == {}


@pytest.mark.parametrize(("kind", "spec", "given"), OTHER_ARGUMENTS)
def test_with_other_arguments_a_plugin_keeps_its_contract_too(kind, spec, given):
    parsed = Spec.parse(spec)
    assert broken(CONTRACTS[kind].run(parsed.name, *given, **parsed.parameters)) == {}


@pytest.mark.parametrize(("kind", "plugin"), SOUND)
def test_a_sound_plugin_keeps_every_rule(kind, plugin, register, given):
    contract = CONTRACTS[kind]
    register(contract.registry, "sound", plugin)
    results = {result.rule: result for result in contract.run("sound", *given(kind))}
    assert broken(results.values()) == {}
    rules = {rule_of(one) for one in contract.checks}
    expected = {
        "task": {rule_of(of_tasks.kit.a_measured_pose_is_used)},
        "controller": {rule_of(of_controllers.kit.the_exported_program_acts_as_act_does)},
    }
    assert results.keys() == {MADE, *rules} - expected.get(kind, set()), "what does not apply is not mentioned"


@pytest.mark.parametrize(("kind", "one"), BROKEN)
def test_a_broken_plugin_is_reported_with_the_rule_it_breaks(kind, one, register, given):
    register(CONTRACTS[kind].registry, "broken", one.plugin)
    found = broken(CONTRACTS[kind].run("broken", *given(kind)))
    assert re.search(one.reason, found[rule_of(one.check)])
    assert not one.alone or len(found) == 1


@pytest.mark.parametrize("kind", CASES)
def test_every_check_has_a_plugin_that_breaks_it(kind):
    cases = CASES[kind][1]
    assert {one.check for one in (*cases.BROKEN, *cases.BROKEN_FORMS)} == set(CONTRACTS[kind].checks)


@pytest.mark.parametrize("kind", CASES)
def test_the_check_of_a_kind_raises_with_every_broken_rule_and_nothing_for_a_sound_plugin(kind, register, given):
    check, cases = CASES[kind]
    register(CONTRACTS[kind].registry, "sound", cases.SOUND[0])
    check("sound", *given(kind))
    register(CONTRACTS[kind].registry, "broken", cases.Failing)
    found = broken(CONTRACTS[kind].run("broken", *given(kind)))
    with pytest.raises(ContractViolation) as raised:
        check("broken", *given(kind))
    head, *lines = str(raised.value).splitlines()
    assert head == f"{kind} 'broken' breaks rules of the contract ({len(found)}):"
    assert lines == [f"- {said}: {reason}" for said, reason in found.items()]


@pytest.mark.parametrize("kind", CASES)
def test_a_plugin_that_cannot_be_made_is_reported_and_a_wrong_parameter_is_the_callers(kind, register, given):
    sound = CASES[kind][1].SOUND[0]
    register(CONTRACTS[kind].registry, "broken", type("Unmakable", (sound,), {"__init__": failing}))
    reported = list(CONTRACTS[kind].run("broken", *given(kind)))
    assert [one.rule for one in reported] == [MADE]
    assert str(reported[0].failure).startswith("ZeroDivisionError: a mistake in the plugin (kits.py, line")
    register(CONTRACTS[kind].registry, "sound", sound)
    with pytest.raises(InvalidArgument, match=f"{kind} 'sound' has no parameter 'wheels'"):
        list(CONTRACTS[kind].run("sound", *given(kind), wheels=4))


@pytest.mark.parametrize("system", example_systems()[:2], ids=["switches", "continuous"])
def test_a_task_is_checked_on_the_system_that_is_given(system):
    results = list(CONTRACTS["task"].run("point_to_point", system, waypoint_radius=0.5, horizon=40))
    assert broken(results) == {}
    assert len(results) == 1 + len(CONTRACTS["task"].checks)


def test_a_task_that_fits_no_system_reports_the_reasons(register):
    class Impossible(of_tasks.Upright):
        def check_system(self, system):
            raise IncompatibleTask(f"impossible needs wings, {system.name} has none")

    register(tasks, "broken", Impossible)
    (reason,) = broken(CONTRACTS["task"].run("broken")).values()
    assert "made-up pendulum: impossible needs wings, made-up pendulum has none" in reason


def test_a_reader_is_not_checked_without_a_file(tmp_path):
    with pytest.raises(InvalidArgument, match=r"reader 'csv': expected a file of its kind at .*, found none"):
        check_reader("csv", tmp_path / "nothing.csv")


def test_after_a_failed_fit_nothing_else_is_checked(register):
    register(models, "broken", of_models.Failing)
    assert [one.rule for one in MODEL.run("broken")][-1] == rule_of(model_kit.fit_returns_the_model_itself)


def test_a_system_that_the_family_refuses_is_no_broken_sentence(register, rng):
    class Planar(of_models.Fading):
        def check_system(self, system):
            require_planar(self, system)

    register(models, "planar", Planar)
    dataset = Dataset.from_arrays(bare_system(), [rng.standard_normal((30, 1))], [rng.uniform(0, 1, (29, 1))])
    with pytest.raises(IncompatibleSystem, match="Planar describes a planar body"):
        list(MODEL.run("planar", dataset))


def test_the_quick_preset_gives_way_to_what_is_asked_for(register):
    seen = set()

    class Preset(of_models.Fading):
        presets: ClassVar = {"quick": {"share": 0.5}}

        def fit(self, dataset, *, rng, progress=None):
            seen.add(self.share)
            return super().fit(dataset, rng=rng)

    register(models, "preset", Preset)
    for given, expected in (({}, {0.5}), ({"share": 0.25}, {0.25})):
        seen.clear()
        list(MODEL.run("preset", **given))
        assert seen == expected


def test_a_class_without_what_every_model_has_is_refused_where_it_is_registered():
    with pytest.raises(RegistrationError, match=r"model 'unfinished': .*Unfinished does not define fit, required of"):

        @models.register("unfinished")
        class Unfinished(DynamicsModel):
            def next_state(self, carry, control):
                return carry

    assert "unfinished" not in models.names()
