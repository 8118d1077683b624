"""Environments of others: their state is set where that can be checked, else their reward is learned."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from evaluation.cells.learned_task import LearnedTaskResult, LearnTask, with_learned_task
from evaluation.experiment import Experiment
from evaluation.run_evolution import plan_evolution
from evaluation.running import compare
from hardware.robot import find_robot
from hardware.simulators.gymnasium_robot import GymnasiumRobot
from hardware.simulators.gymnasium_state import AttributeState, MethodState, MujocoState
from hardware.simulators.gymnasium_task import EnvironmentTask
from sysid_evo.cli.robots import reward_sentences
from sysid_evo.controllers import RecurrentNetwork
from sysid_evo.engine import DynamicsRunner
from sysid_evo.errors import IncompatibleTask
from sysid_evo.evolution import ControllerEvolution
from sysid_evo.evolution.champion import load_champion
from sysid_evo.evolution.margins import with_horizon
from sysid_evo.models.base import make_model
from sysid_evo.plan import Cell, Store
from sysid_evo.randomness import trial_seeds
from sysid_evo.registry import Spec
from sysid_evo.tasks.reward_fit import fit_reward
from sysid_evo.tasks.task import learn_task, make_task
from sysid_evo.testing import check_task
from tests.fixtures import environments

pytestmark = pytest.mark.usefixtures("blank_figures")

ROTOR, SLIDER = "Rotor-v0", "Slider-v0"


@pytest.fixture(scope="module", autouse=True)
def small():
    environments.register()


def robot_of(name, **parameters):
    return GymnasiumRobot(id=name, **parameters)


def learned(robot, steps=2000):
    data = robot.record(seed=1, duration=steps * robot.system.dt).dataset
    return learn_task(robot.default_task, data), data


def network(task, system, candidates):
    controller = RecurrentNetwork(hidden=3)
    size = controller.bind(len(task.bind(system).observations), system.nu).n_parameters
    return controller, np.random.default_rng(0).standard_normal((candidates, size))


def test_a_learned_task_keeps_the_contract_and_its_compiled_form_agrees():
    for robot in (robot_of(ROTOR), robot_of(ROTOR, angle="1,2"), robot_of(SLIDER)):
        task, _ = learned(robot, 1000)
        check_task("environment", robot.system, **task.parameters, horizon=30)


def test_distances_and_trees_of_a_learned_task_have_the_same_compiled_form():
    robot, rng = robot_of(ROTOR, angle="1,2"), np.random.default_rng(0)
    spec, _ = learned(robot, 1000)
    found = make_task(spec).learned
    places = np.array([(0, 0, 0), (0, 1, 1), (1, 1, 1), (1, 1, 0), (2, 2, 0)], dtype=float)
    distances = np.hstack([rng.standard_normal((len(places), 1)), places])
    trees = [
        [*rng.integers(0, found.n_reached, 7), *rng.normal(0.0, 1.0, 7), *rng.normal(0.0, 0.5, 8)] for _ in range(9)
    ]
    further = replace(found, distances=distances, trees=np.array(trees), range=np.array([-99.0, 99.0, -99.0, 99.0]))
    check_task("environment", robot.system, **{**spec.parameters, "learned": further.to_text()}, horizon=30)


def test_the_task_of_a_robot_has_its_angles_and_settings():
    task = make_task(robot_of(ROTOR, angle="1,2", settings={"limit": 2.0}).default_task)
    assert (task.angle, task.settings) == ("1,2", {"limit": 2.0})
    assert task.tried.controls[0].high == 2.0
    assert [channel.name for channel in task.tried.states] == ["observation_0", "angle_1"]


def test_claims_with_a_learned_reward_are_what_the_environment_pays():
    robot = robot_of(ROTOR, angle="1,2")
    spec, data = learned(robot, 16_000)
    model, task = make_model("linear").fit(data), make_task(spec)
    controller, parameters = network(task, robot.system, candidates=8)
    runners = DynamicsRunner(model), robot.runner()
    own, paid = (one.bind(controller, task)(parameters, trial_seeds(3, 5)).fitness.mean(axis=1) for one in runners)
    np.testing.assert_allclose(own, paid, atol=0.03 * np.ptp(paid))


def test_on_the_environment_itself_fitness_is_the_sum_of_its_own_rewards():
    robot = robot_of(ROTOR, angle="1,2")
    task = make_task(learned(robot, 1000)[0])
    controller, parameters = network(task, robot.system, candidates=2)
    run = robot.runner().bind(controller, task)(parameters, trial_seeds(8, 3), record=True)
    for episode, fitness in zip(run.trajectories, run.fitness.ravel(), strict=True):
        assert fitness == pytest.approx(episode.total_reward, abs=1e-9)
        assert fitness == pytest.approx(-(episode.states[1:, 0] ** 2).sum(), abs=1e-4)


def test_a_trial_begins_where_an_episode_of_the_environment_does_with_its_seed():
    robot, seeds = robot_of(ROTOR, angle="1,2"), trial_seeds(4, 3)
    starts = make_task(robot.default_task).bind(robot.system).begin(seeds).state
    with robot.simulator.open() as session:
        np.testing.assert_array_equal(starts, [session.reset(int(seed)) for seed in seeds])


def test_a_task_that_has_learned_nothing_and_cannot_ask_says_what_to_do():
    robot = robot_of(ROTOR)
    task = make_task(robot.default_task).bind(robot.system)
    assert task.needs_recording
    with pytest.raises(IncompatibleTask, match=r"must be learned from a recording.*learn_task.*--plugin FILE"):
        task.kernel()


@pytest.mark.parametrize(("name", "ends"), [("Arrival-v0", False), ("Walled-v0", True)])
def test_a_reward_at_the_time_limit_is_paid_there_and_in_no_shorter_trial(name, ends):
    robot = robot_of(name)
    spec, data = learned(robot, 8000)
    made = make_task(spec)
    assert made.pays_at_limit
    check_task("environment", robot.system, **spec.parameters, horizon=50)
    controller, parameters = network(made, robot.system, candidates=8)
    model, seeds = make_model("linear").fit(data), trial_seeds(3, 5)
    own, paid = (one.bind(controller, made)(parameters, seeds) for one in (DynamicsRunner(model), robot.runner()))
    assert (paid.survived < 50).any() == ends
    assert np.median(np.abs(own.fitness - paid.fitness)) < 0.1 * paid.fitness.std()
    short = make_task(with_horizon(spec, 49))
    own, paid = (one.bind(controller, short)(parameters, seeds) for one in (DynamicsRunner(model), robot.runner()))
    whole = paid.survived == 49
    np.testing.assert_array_equal(paid.fitness[whole], 0.0)
    np.testing.assert_allclose(own.fitness[whole & (own.survived == 49)], 0.0, atol=1e-6)


class Held(environments.Slider):
    """A block with methods in place of the attribute."""

    def get_state(self):
        return self.state

    def set_state(self, state):
        self.state = state


class Hidden(environments.Slider):
    """A block whose ``state`` has an offset."""

    def reset(self, **options):
        observation, info = super().reset(**options)
        return observation + 1.0, info

    def step(self, action):
        observation, *others = super().step(action)
        return observation + 1.0, *others


def test_an_environment_is_put_into_a_state_by_what_it_offers_if_it_then_makes_the_same_steps():
    import gymnasium

    for name, kind in (("Held-v0", Held), ("Hidden-v0", Hidden)):
        if name not in gymnasium.registry:
            gymnasium.register(name, entry_point=kind, max_episode_steps=40)
    assert robot_of(SLIDER).simulator.setter == AttributeState()
    assert isinstance(robot_of("Held-v0").simulator.setter, AttributeState | MethodState)
    for name in ("Hidden-v0", "Forgetful-v0", ROTOR):
        assert robot_of(name).simulator.setter is None


# The place of what Pusher pushes is drawn for every episode, and its joints have their zeros elsewhere.
@pytest.mark.parametrize(
    "name", ["InvertedPendulum-v5", "InvertedDoublePendulum-v5", "Reacher-v5", "Swimmer-v5", "Hopper-v5", "Pusher-v5"]
)
def test_a_mujoco_simulation_is_put_into_the_state_of_its_observation(name):
    pytest.importorskip("mujoco")
    robot = robot_of(name)
    assert isinstance(robot.simulator.setter, MujocoState)
    task = EnvironmentTask(id=name, exact=True).bind(robot.system)
    rng, paid, asked = np.random.default_rng(0), [], []
    with robot.simulator.open() as session:
        state = session.reset(5)
        for _ in range(40):
            control = robot.system.actuate(rng.uniform(-1.0, 1.0, robot.system.nu))
            after, reward, over, _ = session.step(control)
            trial, _ = task.advance(task.begin(trial_seeds(0, 1)), state[None], after[None], control=control[None])
            assert trial.alive[0] == (not over)
            paid.append(max(reward, task.least))
            asked.append(task.fitness(trial)[0])
            state = session.reset(6) if over else after
    np.testing.assert_allclose(asked, paid, atol=1e-3 * (np.ptp(paid) + 0.01))


@pytest.mark.parametrize("name", ["InvertedPendulum-v5", "InvertedDoublePendulum-v5", "Reacher-v5"])
def test_the_reward_and_the_end_of_a_mujoco_environment_are_learned_from_a_recording(name):
    pytest.importorskip("mujoco")
    robot = robot_of(name)
    spec, data = learned(robot)
    _, quality = fit_reward(data)
    assert quality.error < 0.05
    assert np.isnan(quality.found) or quality.found > 0.8
    check_task("environment", robot.system, **spec.parameters, horizon=20)


def test_an_environment_of_box2d_is_learned_too():
    pytest.importorskip("Box2D")
    robot = robot_of("LunarLander-v3", settings={"continuous": True})
    spec, _ = learned(robot, 1600)
    assert make_task(spec).learned is not None
    assert robot.system.nu == 2


def test_a_comparison_learns_the_reward_and_its_run_evolves_further_with_it(tmp_path):
    robot = f'gymnasium(id="{ROTOR}", angle="1,2")'
    quick = {"generations": 2, "trials": 2, "selection_trials": 5, "transfer_trials": 3, "procedure": "plain"}
    report = compare(robot=robot, models=("linear",), minutes=5.0, out=tmp_path / "run", jobs=1, **quick)
    assert any(note.startswith("Learned reward: polynomial of degree 2") for note in report.task_notes)
    store = Store(tmp_path / "run")
    (path,) = (tmp_path / "run" / "controllers").glob("linear-*.json")
    champion = load_champion(path)
    assert make_task(champion.task).learned is not None
    planned = plan_evolution(Experiment.of({**quick, "generations": 3}), store, ["linear"])
    (learning,) = (cell for cell in planned.plan if cell.kind == "learn")
    assert store.done(learning)
    paid = report.matrix.cell("linear", "gymnasium")
    assert paid.traces
    for trace in paid.traces:
        assert trace.fitness == pytest.approx(trace.trajectory.total_reward, abs=1e-6)


class Lucky(environments.Rotor):
    """A rotor whose rewards are noise."""

    def step(self, action):
        observation, _, *others = super().step(action)
        return observation, self.np_random.normal(), *others


class LuckySlider(environments.Slider):
    """A block whose reward is a fast wave, which no form of a learned reward is; its state can be set."""

    def step(self, action):
        observation, _, *others = super().step(action)
        return observation, float(np.sin(100.0 * self.state[0])), *others


def quick_comparison(name, kind, folder):
    import gymnasium

    if name not in gymnasium.registry:
        gymnasium.register(name, entry_point=kind, max_episode_steps=40)
    quick = {"generations": 3, "trials": 2, "selection_trials": 3, "transfer_trials": 2, "procedure": "plain"}
    return compare(robot=f'gymnasium(id="{name}")', models=("linear",), minutes=2.0, out=folder, jobs=1, **quick)


def test_a_badly_known_reward_is_in_the_first_lines_of_the_report(tmp_path):
    report = quick_comparison("Lucky-v0", Lucky, tmp_path)
    assert "The learned reward is badly known" in report.task_warning
    assert "register_reward, in a file for --plugin FILE" in report.task_warning
    assert report.task_warning in " ".join(str(report).split())
    page = (tmp_path / "report.html").read_text()
    assert page.index("The learned reward is badly known") < page.index("<section")


def test_a_recording_reports_that_its_reward_is_badly_known():
    import gymnasium

    if "Lucky-v0" not in gymnasium.registry:
        gymnasium.register("Lucky-v0", entry_point=Lucky, max_episode_steps=40)
    robot = robot_of("Lucky-v0")
    sentences = reward_sentences(robot.default_task, robot.record(seed=1, duration=90.0).dataset)
    assert sentences[0].startswith("Return of the")
    assert sentences[-1].startswith("The learned reward is badly known: held-out error")


def test_a_badly_known_reward_is_asked_of_an_environment_that_can_be_put_into_a_state(tmp_path):
    report = quick_comparison("LuckySlider-v0", LuckySlider, tmp_path)
    assert not report.task_warning
    (sentence,) = report.task_notes
    assert "badly known" in sentence
    assert "The environment is put into each state instead and gives its own reward" in sentence
    (path,) = (tmp_path / "controllers").glob("linear-*.json")
    assert load_champion(path).task.parameters["exact"] is True


def test_searches_with_a_slow_task_have_the_generations_that_fit_into_their_time():
    data = Cell(kind="data", name="data", title="data", settings=None, known_digest="data")
    learned = LearnTask(Spec.parse("environment"), data, search_minutes=1.0).cell()
    found = LearnedTaskResult("environment(exact=true)", (), step_seconds=1e-4)
    work = SimpleNamespace(result={learned: found}.get)
    evolution = ControllerEvolution(generations=300, trials=1)
    assert 10 <= with_learned_task(evolution, learned, work).generations < 300
    work = SimpleNamespace(result={learned: replace(found, step_seconds=0.0)}.get)
    assert with_learned_task(evolution, learned, work).generations == 300


@pytest.mark.parametrize(
    ("name", "angles"),
    [("InvertedDoublePendulum-v5", ["angle_3", "angle_4"]), ("Reacher-v5", ["angle_0", "angle_1"]), ("Swimmer-v5", [])],
)
def test_pairs_of_cosine_and_sine_are_found_and_the_state_can_still_be_set(name, angles):
    pytest.importorskip("mujoco")
    robot = find_robot(f'gymnasium(id="{name}")')
    assert [channel.name for channel in robot.system.states if channel.period] == angles
    assert robot.simulator.settable
    plain = find_robot(f'gymnasium(id="{name}", angle="")')
    assert not any(channel.period for channel in plain.system.states)
    make_task(plain.default_task).bind(plain.system)
