"""What a comparison plans, leaves out with a reason, and refuses before any work."""

import numpy as np
import pytest

from evaluation import chosen_models
from evaluation.cells.controllers import Baseline, with_starts
from evaluation.cells.data import HoldOut, whole_episodes
from evaluation.experiment import Experiment, meaningful
from evaluation.planning import plan_comparison
from evaluation.running import compare
from hardware.robot import Robot, find_robot
from sysid_evo.data import Dataset
from sysid_evo.errors import IncompatibleSystem, IncompatibleTask, InvalidArgument, UnknownName
from sysid_evo.models import save_model
from sysid_evo.models.base import make_model
from sysid_evo.registry import Spec, models, robots
from sysid_evo.rigid_body import RigidBody
from sysid_evo.system import Channel, System, rigid_body_states
from sysid_evo.testing import ExampleDynamics, example_dataset
from sysid_evo.testing.examples import pendulum, switched_car
from tests.fixtures.known_models import recording
from tests.fixtures.recordings import oscillator_data

SHORT = {
    "generations": 2, "trials": 2, "selection_trials": 2, "transfer_trials": 3, "traces": 2, "held_out": 0.3,
    "ensembles": (), "task": "point_to_point(horizon=60)", "strategy": "mu_plus_lambda(children=5)",
}  # fmt: skip


class MadeUpRobot(Robot):
    """A robot that is emulated by a linear system."""

    name, made_like = "made_up_robot", staticmethod(switched_car)

    def __init__(self):
        self.system = self.made_like()
        self.dynamics = ExampleDynamics(self.system)

    def connect(self, *, seed=None):
        raise AssertionError("a plan connects to nothing")


class Swinging(MadeUpRobot):
    """A robot that is no car."""

    made_like = staticmethod(pendulum)


@pytest.fixture(autouse=True)
def _made_up_things(register):
    register(robots, "made_up_robot", MadeUpRobot)
    register(robots, "swinging", Swinging)


SWING = System(
    (Channel("angle", "rad", period=2.0 * np.pi), Channel("speed", "rad/s")),
    (Channel("torque", "N m", -1.0, 1.0),),
    0.05,
)


def swings(lengths):
    rng = np.random.default_rng(0)
    states = [np.cumsum(rng.standard_normal((length + 1, 2)), axis=0) for length in lengths]
    return Dataset.from_arrays(SWING, states, [rng.uniform(-1.0, 1.0, length) for length in lengths])


def planned(*names, **changes):
    asked = Experiment.of(meaningful({**SHORT, "models": names}, changes))
    return plan_comparison(asked, dataset=example_dataset())


def test_a_model_inside_a_controller_is_needed_by_it_and_its_label_is_no_part_of_a_result():
    fit = planned("linear").fits["linear"]
    cells = [Baseline(Spec("lqr", {"model": n}), Spec("set_point"), switched_car(), {n: fit}).cell() for n in "ab"]
    assert cells[0].needs == (fit,)
    assert cells[0].digest == cells[1].digest


def evolved_in(comparison):
    """Return the models in which a comparison evolves, and those on which its controllers are run."""
    evolved = {one.label for cell in comparison.plan.of_kind("evolve") for one in cell.settings.members}
    polished = {one.label for cell in comparison.plan.of_kind("polish") for one in cell.settings.members}
    assert polished <= evolved
    return evolved, {cell.settings.column.label for cell in comparison.plan.of_kind("run")}


@pytest.mark.parametrize(
    ("dataset", "scoring"),
    [
        (example_dataset(), ["gaussian_process"]),
        (swings([200, 200]), ["gaussian_process"]),
        (oscillator_data(), ["gaussian_process", "nonlinear_state_space"]),
    ],
    ids=["rates of a body", "rate of an angle", "no rates"],
)
def test_by_default_other_families_score_controllers_without_one_of_their_own(monkeypatch, dataset, scoring):
    for usual in ("OTHER_FAMILIES", "TURNING_FAMILIES"):
        monkeypatch.setattr(chosen_models, usual, ("linear", "narx"))
    task = {} if dataset.system.motion is not None else {"task": f"set_point(channels={dataset.system.state_names[0]})"}
    asked = Experiment.of({**SHORT, "procedure": "recommended", **task})
    comparison = plan_comparison(asked, dataset=dataset)
    assert list(comparison.fits) == ["linear", "narx", *scoring]
    assert evolved_in(comparison) == ({"linear", "narx"}, {"linear", "narx", *scoring})
    repeated = plan_comparison(comparison.experiment, dataset=dataset)
    assert [cell.digest for cell in repeated.plan] == [cell.digest for cell in comparison.plan]
    for named in ({"models": ("linear", "narx")}, {"preset": "paper"}, {"stop_after": "fit"}):
        settings = {**asked.model_dump(exclude_unset=True), **named} if "stop_after" not in named else named
        other = plan_comparison(Experiment.of(settings), dataset=dataset)
        assert not set(other.fits) & set(scoring)
        assert other.experiment.searched is None
    some = plan_comparison(asked.model_copy(update={"searched": ("narx", "gaussian_process")}), dataset=dataset)
    assert evolved_in(some)[0] == {"narx", "gaussian_process"}
    with pytest.raises(InvalidArgument, match=r"searched: expected some of the models linear, narx, .* got ghost"):
        plan_comparison(asked.model_copy(update={"searched": ("ghost",)}), dataset=dataset)


def noises_met(**changes):
    """Return the noise of every evolution of a comparison with a reference, by the label of what it is evolved on."""
    plan = planned("linear", robot="made_up_robot", reference=True, **changes).plan
    return {cell.name: cell.settings.evolution.noise for cell in plan.of_kind("evolve")}


def test_where_a_target_is_to_be_kept_models_meet_some_noise_unless_none_is_asked_for():
    target = "set_point(channels=yaw_rate, low=-1, high=1)"
    assert noises_met(task=target) == {"linear": "domain_randomisation(process=0.02)", "made_up_robot": ""}
    assert set(noises_met(task=target, noise="none").values()) == {""}
    assert set(noises_met(task=target, noise="domain_randomisation(sensor=0.1)").values()) == {
        "domain_randomisation(sensor=0.1)"
    }
    assert set(noises_met().values()) == {""}


def test_a_row_by_hand_depends_on_what_is_in_the_files_that_it_names(tmp_path):
    file = save_model(make_model("linear").fit(example_dataset(), rng=0), tmp_path / "body")
    spec = Spec("predictive", {"model": str(file)})
    settings = Baseline(spec, Spec("point_to_point"), switched_car())
    first, same = (settings.inputs() for _ in range(2))
    assert len(first["files"]) == 2
    file.write_text(file.read_text() + " ")
    assert first == same != settings.inputs()


def test_an_ensemble_in_two_orders_is_one():
    comparison = planned("linear", "near=nearest_neighbour", ensembles=("near+linear", "linear+near", "near + linear"))
    assert comparison.experiment.ensembles == ("near+linear",)
    assert len([cell for cell in comparison.plan.of_kind("evolve") if len(cell.settings.members) > 1]) == 1


@pytest.mark.parametrize(("count", "title"), [(7, "a, b, c, d, e, f, g"), (8, "8 models")])
def test_a_report_is_called_after_its_models_if_they_are_few(count, title):
    comparison = planned(*(f"{label}=linear" for label in "abcdefgh"[:count]), stop_after="prediction")
    assert comparison.title.endswith(f": {title}")


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"ensembles": ("linear+parametrised",)}, InvalidArgument, "names parametrised, but the models are linear"),
        ({"ensembles": ("linear",)}, InvalidArgument, "expected two or more models joined by +"),
        ({"ensembles": ("linear+linear",)}, InvalidArgument, "names a model twice"),
        ({"models": ("linear", "linear")}, InvalidArgument, "'linear' is given 2 times"),
        ({"models": ()}, InvalidArgument, "expected at least one family"),
        ({"models": ("linear(rigde=1)",)}, InvalidArgument, "has no parameter 'rigde'. Did you mean 'ridge'?"),
        ({"task": "point_to_point(horizon=0)"}, InvalidArgument, "horizon"),
        ({"strategy": "mu_plus_lambda(parents=0)"}, InvalidArgument, "parents"),
        ({"controller": "recurrent(hidden=0)"}, InvalidArgument, "hidden"),
        ({"aggregate": "min(share=0.2)"}, InvalidArgument, "'min' has no parameter 'share'"),
        ({"baselines": ("recurrent",)}, InvalidArgument, "'recurrent' must be evolved before it can drive"),
        ({"baselines": ("predictive(model=liner)",)}, UnknownName, "the models compared are linear"),
        ({"baselines": ("predictive(model=linear, horizon=0)",)}, InvalidArgument, "expected horizon"),
        ({"baselines": ("pursuit", "pursuit")}, InvalidArgument, "'pursuit' is given 2 times"),
        ({"baselines": ("linear=pursuit",)}, InvalidArgument, "another controller is called 'linear'"),
        ({"models": ("persistence=linear",)}, InvalidArgument, "the prediction of no change is called 'persistence'"),
        ({"models": ("polished=linear", "narx")}, InvalidArgument, "another controller is called 'polished'"),
        (
            {"models": ("made_up_robot=linear",), "robot": "made_up_robot"},
            InvalidArgument,
            "the robot is called 'made_up_robot', too: give the model or baseline a name of its own",
        ),
        (
            {"baselines": ("pursuit",), "stop_after": "fit"},
            InvalidArgument,
            "baselines has no effect with stop_after = 'fit'",
        ),
        ({"reference": True}, InvalidArgument, "name the emulated robot"),
        (
            {"reference": True, "stop_after": "prediction", "robot": "made_up_robot"},
            InvalidArgument,
            "stop_after = 'prediction'",
        ),
        ({"robot": "swinging"}, IncompatibleSystem, "robot 'swinging' is not the one in the recordings"),
        ({"robot": "made_up_robot(seed=1)"}, InvalidArgument, "'made_up_robot' has no parameter 'seed'"),
        ({"test": ("episode-7",)}, InvalidArgument, "episode-7"),
        ({"held_out": 0.0}, InvalidArgument, "held_out: expected a share above 0"),
    ],
)
def test_a_mistake_is_found_by_the_plan_and_nothing_is_written(tmp_path, changes, error, message):
    with pytest.raises(error) as told:
        compare(example_dataset(), out=tmp_path / "run", **meaningful({**SHORT, "models": ("linear",)}, changes))
    assert message in str(told.value)
    assert not (tmp_path / "run").exists()


def test_a_task_that_does_not_fit_the_system_is_found_by_the_plan():
    with pytest.raises(IncompatibleSystem.__mro__[1], match="motion"):
        plan_comparison(Experiment.of({**SHORT, "models": ("linear",)}), dataset=swings([200]))


def test_an_unknown_setting_is_refused_with_the_closest_one():
    with pytest.raises(
        InvalidArgument, match=r"genrations is no setting of an experiment\. Did you mean 'generations'\?"
    ):
        Experiment.of({"genrations": 3})
    with pytest.raises(InvalidArgument, match="preset: expected 'quick', 'standard' or 'paper', got 'slow'"):
        Experiment.of({"preset": "slow"})


def test_an_experiment_comes_back_from_its_file(tmp_path):
    settled = planned("near2=nearest_neighbour(state_lags=2)", "linear", ensembles=("near2+linear",)).experiment
    settled.write(tmp_path / "experiment.toml")
    assert Experiment.of(Experiment.read(tmp_path)) == settled
    assert settled.repeats == 1  # what was left open is named


def test_conditions_are_left_out_of_recordings_of_several_alone():
    with pytest.raises(InvalidArgument, match=r"leave_out: expected recordings of two or more conditions, got 1"):
        planned("linear", stop_after="prediction", leave_out="condition")


@pytest.mark.parametrize(
    ("name", "baselines", "rows"),
    [
        ("Pendulum-v1", (), ["linear", "rest", "random"]),
        ("Pendulum-v1", ("still=constant",), ["linear", "still", "random"]),
        ("CartPole-v1", (), ["linear", "rest", "random"]),
    ],
)
def test_controls_at_rest_are_a_row_where_they_may_bring_something(name, baselines, rows):
    task, robot = f'environment(id="{name}")', f'gymnasium(id="{name}")'
    planned = plan_comparison(Experiment(robot=robot, task=task, models=("linear",), baselines=baselines))
    assert [champion.name for champion in planned.matrix.controllers] == rows
    own = plan_comparison(Experiment(robot=robot, models=("linear",), baselines=baselines))
    assert own.experiment.task == task  # without --task it is the environment's own
    assert [cell.digest for cell in own.plan] == [cell.digest for cell in planned.plan]
    only = plan_comparison(Experiment(robot=robot, models=("linear",), stop_after="fit"))
    assert only.matrix is None


@pytest.mark.parametrize(
    ("settings", "starts"),
    [
        ({}, ["linear", "feed_forward", "recurrent"]),
        ({"controller": "linear"}, ["linear"]),
        ({"strategy": "cma_es"}, ["recurrent"]),
        ({"procedure": "plain"}, ["recurrent"]),
        ({"generations": 59}, ["recurrent"]),
        ({"starts": "start(controller=pid), start(controller=linear)"}, ["pid", "linear"]),
        ({"starts": ""}, ["recurrent"]),
        ({"task": "set_point(channels=angle, low=-1, high=1)"}, ["linear", "feed_forward", "recurrent"]),
    ],
)
def test_the_task_of_an_environment_is_searched_from_several_starts_unless_one_is_asked_for(settings, starts):
    robot = 'gymnasium(id="CartPole-v1")'
    planned = plan_comparison(Experiment(robot=robot, models=("linear",), reference=False, **settings))
    evolution = planned.matrix.controllers[0].settings.evolution
    assert [start.controller.name for start in evolution.all_starts] == starts


FLYING = System(
    rigid_body_states(RigidBody(), speed=10.0, rate=10.0), (Channel("thrust", "N", 0.0, 10.0),), 0.02, RigidBody()
)


@pytest.mark.parametrize(
    ("settings", "starts"),
    [
        ({}, ["linear", "feed_forward", "recurrent"]),
        ({"controller": "linear"}, ["linear"]),
        ({"generations": 59}, ["recurrent"]),
        ({"procedure": "plain"}, ["recurrent"]),
        ({"starts": "start(controller=pid)"}, ["pid"]),
    ],
)
def test_a_body_in_space_is_searched_from_several_starts_unless_one_is_asked_for(settings, starts):
    states = np.cumsum(np.random.default_rng(0).normal(size=(400, 9)), axis=0)
    recorded = Dataset.from_arrays(FLYING, [states], [np.zeros((399, 1))])
    planned = plan_comparison(Experiment(models=("linear",), task="hover", **settings), dataset=recorded)
    evolution = planned.matrix.controllers[0].settings.evolution
    assert [start.controller.name for start in evolution.all_starts] == starts
    assert evolution.noise == "", "a body that noise turns over is searched for what survives it, not for what hovers"
    again = plan_comparison(Experiment.of(planned.experiment.model_dump()), dataset=recorded)
    assert again.plan.cells == planned.plan.cells


def test_the_simulator_of_another_package_is_searched_from_several_starts():
    task = "set_point(channels=angle, low=-1, high=1)"
    experiment = Experiment(task=task)
    system = System([Channel("angle", "rad")], [Channel("u", low=-1.0, high=1.0)], dt=0.05)
    assert with_starts(experiment, system, Spec("gymnasium", {"id": "Pendulum-v1"})).starts
    assert with_starts(experiment, system, Spec("pendulum")) is experiment
    assert with_starts(experiment, system) is experiment


def test_controls_at_rest_are_no_row_where_they_are_known_to_bring_nothing():
    planned = plan_comparison(Experiment(models=("linear",), reference=False))
    assert [champion.name for champion in planned.matrix.controllers] == ["linear"]


def test_controls_at_rest_are_a_row_without_a_robot():
    task = 'set_point(channels="forward_speed")'
    without_robot = plan_comparison(Experiment(models=("linear",), task=task), dataset=recording(3, steps=400))
    assert [champion.name for champion in without_robot.matrix.controllers] == ["linear", "rest", "random"]


def test_families_that_predict_well_where_an_angle_comes_round_are_the_default_there():
    plan = plan_comparison(Experiment(stop_after="prediction"), dataset=swings([400, 400]))
    assert set(plan.fits) == {"backprop27", "nearest_neighbour", "sindy", "narx", "mlp_ensemble"}
    assert plan.experiment.models is not None
    assert len(plan.experiment.models) == len(plan.fits)  # the run can be planned again from what is stored of it
    assert any("evolved3 is left out" in text and "angle wraps around" in text for text in plan.plan.remarks)
    asked = plan_comparison(
        Experiment(stop_after="prediction", models=("evolved3", "linear")), dataset=swings([400, 400])
    )
    assert set(asked.fits) == {"evolved3", "linear"}
    assert not any("left out" in text for text in asked.plan.remarks)


def test_a_periodic_family_steps_the_same_a_turn_later():
    data = swings([300])
    names = [name for name in models.names() if getattr(models.get(name), "periodic", False)]
    assert {"nearest_neighbour", "k_neighbours", "sindy", "narx", "mlp_ensemble", "gaussian_process"} <= set(names)
    assert "linear" not in names
    for name in ("nearest_neighbour", "narx", "backprop27"):
        model = models.make(name, **models.get(name).presets.get("quick", {})).fit(data)
        lags, control, turn = model.n_lags, np.array([[0.5]]), np.array([[2.0 * np.pi, 0.0]])
        states = np.tile([[0.4, 1.0]], (1, lags + 1, 1))
        begun, later = (model.start(some, np.zeros((1, lags, 1))) for some in (states, states + turn))
        np.testing.assert_allclose(model.next_state(later, control), model.next_state(begun, control) + turn)


def test_whole_episodes_are_held_back_where_parts_of_them_would_be_too_short():
    short = swings([40, 90] * 10)
    names = whole_episodes(short, 0.25)
    held = sum(len(episode) for episode in short if episode.name in names)
    assert 0.15 * short.n_steps < held <= 0.25 * short.n_steps
    parts = HoldOut().of(short)
    assert set(parts.test.names) == set(names)
    assert {*parts.training.names, *names} == set(short.names)


def test_a_few_episodes_or_long_ones_are_cut_instead():
    assert whole_episodes(swings([40] * 7), 0.25) == []
    assert whole_episodes(swings([400] * 9), 0.25) == []
    assert whole_episodes(swings([400] * 9 + [20] * 9), 0.25) == []
    parts = HoldOut().of(swings([400] * 9))
    assert parts.test is not None
    assert len(parts.test) == len(parts.training) == 9


def test_recordings_of_an_environment_without_its_task_are_told_its_name():
    data = find_robot('gymnasium(id="CartPole-v1")').record(seed=0, duration=20.0).dataset
    with pytest.raises(IncompatibleTask, match=r'needs a planar body.*environment\(id="CartPole-v1"\).*--plugin FILE'):
        plan_comparison(Experiment.of(SHORT | {"models": ("linear",)}), dataset=data)
