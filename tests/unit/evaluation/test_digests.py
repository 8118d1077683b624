"""Which cells a change of an experiment changes: a result is found by all that it depends on, and no more."""

from dataclasses import replace

import numpy as np
import pytest

from evaluation import chosen_models
from evaluation.cells.controllers import Polish
from evaluation.cells.models import StoredModelCell
from evaluation.experiment import Experiment
from evaluation.planning import plan_comparison, unsettled
from evaluation.transfer.matrix import MeasuredResult, human_driver
from evaluation.transfer.matrix import TransferResult as Cell
from model_zoo.linear import Linear
from sysid_evo.errors import IncompatibleSystem, InvalidArgument, MissingExtra
from sysid_evo.evolution import Champion
from sysid_evo.models import save_model
from sysid_evo.models.base import make_model
from sysid_evo.plan import cell as plan_cell
from sysid_evo.registry import load_plugin, models
from sysid_evo.testing import example_dataset
from tests.fixtures.commands import forgetting

BASE = {
    "models": ("linear", "near=nearest_neighbour"),
    "ensembles": ("linear+near",),
    "robot": "emulated_car",
    "generations": 2,
    "trials": 2,
    "repeats": 1,
    "selection_trials": 2,
    "transfer_trials": 3,
    "traces": 2,
    "task": "point_to_point(horizon=60)",
    "strategy": "mu_plus_lambda(children=5)",
    "procedure": "plain",
}
DATA = "prepare made-up car"
FITS, FIT_LINEAR, FIT_NEAR = {"fit linear", "fit near"}, {"fit linear"}, {"fit near"}
PERSISTENCE = {"predict with persistence"}
PREDICTIONS = {"predict with linear", "predict with near"}
EVOLUTIONS = {"evolve linear", "evolve near", "evolve linear+near"}
RUNS = {
    f"run {row} on {column}"
    for row in ("linear", "near", "linear+near")
    for column in ("linear", "near", "emulated_car")
}
ASSESS = {"assess exploitability", "advise on the models"}
CONTROLLERS = EVOLUTIONS | RUNS | ASSESS
ALL = {DATA} | FITS | PERSISTENCE | PREDICTIONS | CONTROLLERS
ON_ROBOT = {title for title in RUNS if title.endswith("emulated_car")}
RECORDED = {title for title in RUNS if title not in ("run linear on near", "run near on linear")}


def planned(dataset=None, **changes):
    return plan_comparison(Experiment.of({**BASE, **changes}), dataset=dataset or example_dataset())


def digests(comparison):
    return {cell.title: cell.digest for cell in comparison.plan}


def changed(before, after):
    """Return the titles of the cells of ``after`` that ``before`` does not have."""
    known = set(digests(before).values())
    return {title for title, digest in digests(after).items() if digest not in known}


def test_the_plan_has_the_cells_that_the_table_below_speaks_of():
    assert set(digests(planned())) == ALL


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({}, set()),
        ({"title": "another"}, set()),
        ({"seed": 1}, ALL - {DATA} - PERSISTENCE - PREDICTIONS | PREDICTIONS),
        ({"held_out": 0.3}, ALL),
        ({"test": ("episode-1",)}, ALL),
        ({"models": ("linear(ridge=0.5)", "near=nearest_neighbour")}, ALL - {DATA} - PERSISTENCE - FIT_NEAR
         - {"predict with near", "evolve near", "run near on near", "run near on emulated_car"}),
        ({"models": ("linear", "near=nearest_neighbour(state_lags=2)")}, ALL - {DATA} - PERSISTENCE - FIT_LINEAR
         - {"predict with linear", "evolve linear", "run linear on linear", "run linear on emulated_car"}),
        ({"models": ("near=nearest_neighbour", "linear")}, ASSESS),
        ({"ensembles": ("near+linear",)}, {"evolve near+linear", "run near+linear on linear", "run near+linear on near",
                                           "run near+linear on emulated_car"} | ASSESS),
        ({"aggregate": "mean"}, ASSESS | {
            title.replace("linear+near", "mean(linear+near)") for title in CONTROLLERS if "linear+near" in title}),
        ({"aggregate": "cvar"}, {
            title.replace("linear+near", "cvar(linear+near)") for title in CONTROLLERS}),
        ({"task": "point_to_point(horizon=61)"}, CONTROLLERS),
        ({"controller": "recurrent(hidden=4)"}, CONTROLLERS),
        ({"strategy": "mu_plus_lambda(children=6)"}, CONTROLLERS),
        ({"starts": "start(strategy=niches)", "controller": None, "strategy": None}, CONTROLLERS),
        ({"generations": 3}, CONTROLLERS),
        ({"trials": 3}, CONTROLLERS),
        ({"repeats": 2}, CONTROLLERS),
        ({"selection_trials": 3}, CONTROLLERS),
        ({"estimator_delay": 0.02}, CONTROLLERS),
        ({"noise": "domain_randomisation(gain=0.1)"}, CONTROLLERS),
        ({"transfer_trials": 4}, RUNS | ASSESS),
        ({"traces": 3}, RECORDED | ASSESS),
        ({"robot": "emulated_car(seed=2)"}, ON_ROBOT | ASSESS),
    ],
    ids=lambda value: next(iter(value), "nothing") if isinstance(value, dict) else "",
)  # fmt: skip
def test_exactly_the_cells_that_depend_on_a_setting_change_with_it(change, expected):
    assert changed(planned(), planned(**change)) == expected


RECOMMENDED = {
    "procedure": "recommended",
    "models": ("linear", "near=nearest_neighbour", "parametrised"),
    "ensembles": (),
}


def test_by_the_recommended_procedure_every_controller_is_judged_by_the_others_and_the_best_are_polished():
    found = planned(**RECOMMENDED, reference=True)
    titles = set(digests(found))
    names = ("linear", "near", "parametrised")
    assert {f"choose {name}" for name in (*names, "best of linear+near+parametrised")} <= titles
    assert {"polish the best", "run polished on emulated_car"} <= titles
    assert "choose emulated_car" not in titles  # what was evolved on the robot is chosen by the robot
    assert [cell.name for cell in found.matrix.controllers] == [*names, "emulated_car", "polished"]


def test_what_was_evolved_against_several_models_can_be_chosen_and_is_not_evolved_again():
    found = planned(**{**RECOMMENDED, "ensembles": ("linear+near",)})
    polished = found.matrix.controllers[-1]
    assert isinstance(polished.settings, Polish)
    contenders = polished.settings.chosen.settings.searches
    assert [one.name for one in contenders] == ["linear", "near", "parametrised", "linear+near"]
    assert sum(cell.title == "evolve linear+near" for cell in found.plan) == 1


def test_a_further_model_judges_and_evolves_nothing_again():
    fewer = planned(**{**RECOMMENDED, "models": ("linear", "near=nearest_neighbour")})
    anew = {title for title in changed(fewer, planned(**RECOMMENDED)) if "parametrised" not in title}
    assert {"choose linear", "choose near", "polish the best"} <= anew
    assert not {title for title in anew if title.startswith(("fit", "evolve", "predict"))}


def test_a_single_family_has_no_scoring_models():
    titles = set(digests(planned(**{**RECOMMENDED, "models": ("linear", "ridged=linear(ridge=0.1)")})))
    assert not {"choose linear", "choose ridged"} & titles
    assert "polish the best" in titles


def test_the_polish_alone_changes_with_its_generations():
    runs = {f"run polished on {name}" for name in ("linear", "near", "parametrised", "emulated_car")}
    assert (
        changed(planned(**RECOMMENDED), planned(**RECOMMENDED, polish_generations=7))
        == {"polish the best"} | runs | ASSESS
    )


def test_a_polish_is_no_longer_than_the_search_before_it_unless_it_is_asked_for():
    assert Experiment.of({"generations": 3}).budget.polish_generations == 3
    assert Experiment.of({"generations": 3, "polish_generations": 9}).budget.polish_generations == 9
    assert Experiment.of({"generations": 5000}).budget.polish_generations == 240
    assert Experiment.of({}).budget.polish_generations == 240


def test_a_preset_changes_the_families_that_have_one_and_the_budget_that_is_not_given():
    chosen = {"models": ("linear", "parametrised"), "ensembles": ()}
    found = changed(planned(**chosen), planned(**chosen, preset="standard"))
    assert "fit parametrised" in found
    assert "fit linear" not in found
    assert "evolve linear" not in found  # its budget is given
    assert "evolve linear" in changed(planned(**chosen), planned(**chosen, preset="standard", generations=None))


def test_a_stored_experiment_under_another_preset_is_what_it_would_have_been_from_the_start():
    asked = {"models": ("linear", "par=parametrised", "sure=parametrised(generations=7)"), "ensembles": (),
             "generations": None}  # fmt: skip
    stored = planned(**asked).experiment.model_dump(mode="json", exclude_none=True)
    assert stored["generations"] == 900
    assert "generations" not in unsettled(stored)
    assert unsettled(stored)["trials"] == 2  # asked for, not the preset's
    again = planned(**{**unsettled(stored), "preset": "standard", "generations": None})
    assert changed(planned(**asked, preset="standard"), again) == set()
    assert changed(planned(**asked), again) != set()


def test_other_data_change_everything_and_their_copy_nothing():
    assert changed(planned(), planned(example_dataset(seed=1))) == ALL
    assert changed(planned(), planned(example_dataset(seed=0))) == set()


def test_a_measured_cell_changes_the_assessment_alone():
    drove = MeasuredResult(human_driver("anna"), Cell("anna", "linear", np.ones(2), unit="waypoints"), on_robot=False)
    experiment = Experiment.of(BASE)
    after = plan_comparison(experiment, dataset=example_dataset(), measured=[drove])
    assert changed(planned(), after) == {"assess exploitability"}


def test_another_contract_changes_everything(monkeypatch):
    before = digests(planned())
    monkeypatch.setattr(plan_cell, "CONTRACT", plan_cell.CONTRACT + 1)
    assert not set(before.values()) & set(digests(planned()).values())


def test_a_default_that_is_written_out_and_a_seed_in_shorthand_change_nothing():
    ridge = models.parameters("linear")["ridge"]
    written = planned(models=(f"linear(ridge={ridge!r})", "near=nearest_neighbour"))
    assert changed(planned(), written) == set()
    shorthand = planned(robot="emulated_car:3", reference=True)
    long = planned(robot="car=emulated_car(seed=3)", reference=True)
    assert changed(shorthand, long) == {"assess exploitability"}  # only the table of the assessment carries labels


PLUGIN = """
from sysid_evo.controllers import RecurrentNetwork
from sysid_evo.evolution.strategies.mu_plus_lambda import MuPlusLambda
from sysid_evo.registry.registry import register_aggregate, register_controller, register_model, register_strategy
from sysid_evo.registry import register_task
from sysid_evo.tasks import PointToPoint
from model_zoo.linear import Linear

@register_model("their_linear")
class TheirLinear(Linear): ...

@register_task("their_task")
class TheirTask(PointToPoint): ...

@register_controller("their_controller")
class TheirController(RecurrentNetwork): ...

@register_strategy("their_strategy")
class TheirStrategy(MuPlusLambda): ...

@register_aggregate("their_aggregate")
def their_aggregate(fitness):
    return fitness.min(axis=0).mean(axis=1)
"""


@pytest.fixture
def plugin(tmp_path):
    """A plugin file with one thing of every kind, until the test ends."""
    path = tmp_path / "theirs.py"
    path.write_text(PLUGIN)
    with forgetting():
        load_plugin(path)
        yield path


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"models": ("linear=their_linear", "near=nearest_neighbour")}, "fit linear"),
        ({"task": "their_task(horizon=60)"}, "evolve linear"),
        ({"controller": "their_controller"}, "evolve linear"),
        ({"strategy": "their_strategy(children=5)"}, "evolve linear"),
        ({"aggregate": "their_aggregate"}, "evolve linear"),
    ],
    ids=("model", "task", "controller", "strategy", "aggregate"),
)
def test_another_source_of_a_plugin_is_another_result(plugin, change, expected):
    before = planned(**change)
    plugin.write_text(PLUGIN + "\n# mended\n")
    assert expected in changed(before, planned(**change))
    assert changed(planned(), planned()) == set()  # what is shipped does not change with it


def test_another_label_of_a_model_changes_the_assessment_alone():
    old, new = (planned(models=(f"{name}=linear",), ensembles=(), robot=None) for name in ("old", "new"))
    assert changed(old, new) == ASSESS


def test_a_champion_is_refused_on_another_system():
    system = example_dataset().system
    champion = Champion("c", np.zeros(3), ("a",), "min", 0, np.ones((1, 3)), system=system)
    champion.check_system(system)
    with pytest.raises(IncompatibleSystem, match="was evolved for another system: 20 Hz against 10 Hz"):
        champion.check_system(replace(system, dt=0.1))
    for change in ({"states": (system.states[1], system.states[0], system.states[2])},
                   {"controls": system.controls[::-1]}):  # fmt: skip
        with pytest.raises(IncompatibleSystem, match="was evolved for another system"):
            champion.check_system(replace(system, **change))


def test_stored_models_with_other_parameters_have_other_digests(tmp_path):
    data = example_dataset()
    rng = np.random.default_rng(0)
    fitted = make_model("k_neighbours(neighbours=3)").fit(data, rng=rng)
    save_model(fitted, tmp_path / "a")
    same = make_model("k_neighbours(neighbours=3)").fit(data, rng=rng)
    save_model(same, tmp_path / "b")
    save_model(fitted.set_params(neighbours=5), tmp_path / "c")
    one, copy, other = (StoredModelCell(tmp_path / name).cell() for name in "abc")
    assert one.digest == copy.digest
    assert one.settings.manifest.sha256 == other.settings.manifest.sha256
    assert one.digest != other.digest


def test_a_fit_that_begins_with_a_stored_model_depends_on_the_content_of_its_file(tmp_path):
    data, base = example_dataset(), tmp_path / "base"

    def fitted():
        return digests(planned(models=("linear", f"near=adapted(base='{base}')")))["fit near"]

    save_model(make_model("linear").fit(data, rng=0), base)
    before = fitted()
    assert fitted() == before
    save_model(make_model("linear", ridge=1.0).fit(data, rng=0), base)
    assert fitted() != before


def test_families_that_cannot_run_here_are_left_out_by_default_and_refused_when_named(register, monkeypatch):
    class Lacking(Linear):
        """A family that needs a package which is not there."""

        requires = ("no_such_package",)

    register(models, "lacking", Lacking)
    monkeypatch.setattr(chosen_models, "OTHER_FAMILIES", ("linear", "lacking"))
    comparison = planned(models=None, ensembles=None)
    assert comparison.experiment.searched == ("linear",)
    assert len(comparison.plan.remarks) == 1
    assert "lacking is left out" in comparison.plan.remarks[0]
    assert 'pip install "no_such_package"' in comparison.plan.remarks[0]
    with pytest.raises(MissingExtra, match="needs the package 'no_such_package', which is not installed"):
        planned(models=("lacking",), ensembles=())
    monkeypatch.setattr(chosen_models, "OTHER_FAMILIES", ("lacking",))
    with pytest.raises(InvalidArgument, match="none of the default families can be compared here"):
        planned(models=None, ensembles=None)
