"""What is trained and what steps are the same model; its gradients are derivatives; it can be trained further."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from model_zoo.backprop27 import Backprop27
from model_zoo.car.hybrid_ode import CarRateGradient, HybridOde
from model_zoo.networks.backpropagation import DifferentiableSimulation, train
from model_zoo.networks.mlp_ensemble import DifferenceNetworks, MlpEnsemble, held_together
from model_zoo.networks.network import Layers, random_network
from model_zoo.networks.neural_ode import OdeSimulation
from model_zoo.networks.training import (
    FLOOR,
    SHARPNESS,
    Batches,
    ResumableTrainings,
    TrainingSchedule,
    TrainingWindows,
    step_weights,
)
from model_zoo.scaling import Mirror
from sysid_evo.carry import CarryLayout
from sysid_evo.data import Dataset
from sysid_evo.errors import InvalidData
from sysid_evo.models import load_model, save_model
from sysid_evo.models.base import make_model
from sysid_evo.models.dynamics import rk4
from sysid_evo.progress import Counter
from sysid_evo.system import Channel, System
from sysid_evo.testing import example_dataset
from sysid_evo.types import Array
from sysid_evo.validation.folds import time_fold
from tests.fixtures.systems import FloorCar, drive, swung

HARDLY = {"hidden": [6], "one_step_updates": 10, "updates": 2, "horizon": 5, "input_noise": 0.07}
FAMILIES = {
    "mlp_ensemble": {**HARDLY, "members": 2, "state_lags": 1, "control_lags": 1},
    "neural_ode": HARDLY,
    "hybrid_ode": {**HARDLY, "state_lags": 0, "control_lags": 0},
}


@pytest.fixture(scope="module")
def ensemble(car_data):
    model = MlpEnsemble(
        members=3, hidden=[16], state_lags=1, control_lags=2, one_step_updates=200, updates=40, horizon=10, folds=3
    )
    return model.fit(car_data, rng=np.random.default_rng(4))


def test_layers_and_plain_networks_agree():
    rng = np.random.default_rng(0)
    network = random_network([4, 7, 5, 2], 3, rng)
    inputs, centre, scale, output = rng.standard_normal((6, 4)), np.ones(4), rng.uniform(1, 2, 4), np.array([2.0, 3.0])
    layers = Layers([4, 7, 5, 2], 3, centre=centre, scale=scale, output_scale=output)
    parameters = layers.flat(network)
    layers.take(parameters)
    layers.reserve(2, 6)[1] = inputs
    folded = network.folded(centre, scale, output)
    np.testing.assert_allclose(layers.forward(1), folded(inputs), atol=1e-5)
    np.testing.assert_allclose(layers.network(parameters)(inputs), network(inputs), atol=1e-5)


def test_a_folded_network_takes_raw_inputs():
    rng = np.random.default_rng(0)
    network = random_network([4, 7, 2], 3, rng)
    centre, scale, output = rng.standard_normal(4), rng.uniform(1, 2, 4), rng.uniform(1, 2, 2)
    inputs = rng.standard_normal((6, 4))
    np.testing.assert_allclose(
        network.folded(centre, scale, output)(inputs), network((inputs - centre) / scale) * output, atol=1e-12
    )


def members(dataset):
    mirror = Mirror.of(dataset.system, ["steer"])
    rng = np.random.default_rng(0)
    return DifferenceNetworks(dataset, (1, 3), hidden=[7, 6], members=2, further=1, mirror=mirror, rng=rng)


def flow(dataset):
    return OdeSimulation(dataset, (2, 1), hidden=[7], rng=np.random.default_rng(0))


def hybrid(dataset):
    model = OdeSimulation(dataset, (0, 2), hidden=[5], rng=np.random.default_rng(0))
    model.know(CarRateGradient((0, 1, 2, 0, 1)), HybridOde.initial)
    return model


def swinging():
    """Return a short recording of a pendulum, whose angle is periodic."""
    return swung(0, steps=40)


@pytest.mark.parametrize(
    ("make", "record"),
    [(members, example_dataset), (flow, example_dataset), (hybrid, example_dataset), (flow, swinging)],
)
def test_the_gradient_of_a_simulation_is_its_derivative(make, record):
    """Of a random sum of all states of all steps, by every eleventh parameter and the last nine."""
    dataset, rng = record(), np.random.default_rng(3)
    model = make(dataset)
    count, size = model.parameters.shape
    shots = TrainingWindows.of(dataset, 6, model.layout.n_lags)
    batch = Batches([shots] * count, model.layout.n_lags).of(rng.integers(0, len(shots), (count, 9)), 6)
    batch = model.augmented(batch, rng)
    weights = rng.standard_normal((6, count, 9, dataset.system.nx)).astype(np.float32)
    model.run(batch)
    found, before = model.gradient(weights), model.parameters
    for place in (*range(0, size - 9, 11), *range(size - 9, size)):
        sums = []
        for step in (2e-3, -2e-3):
            model.parameters = before.copy()
            model.parameters[:, place] += step
            sums.append(np.sum(model.run(batch).astype(np.float64) * weights, axis=(0, 2, 3)))
        slope = (sums[0] - sums[1]) / 4e-3
        np.testing.assert_allclose(found[:, place], slope, atol=1e-3 * np.abs(found).max())


def short_episodes(lengths):
    """Return episodes of the example of these numbers of steps."""
    whole = example_dataset()
    longest = max(whole, key=len)
    starts = np.arange(len(lengths)) % (len(longest) - max(lengths) + 1)
    return whole.with_episodes([
        replace(longest[start : start + count], name=f"short {i}")
        for i, (start, count) in enumerate(zip(starts.tolist(), lengths, strict=True))
    ])  # fmt: skip


def test_windows_are_shorter_where_most_episodes_are_and_single_steps_of_all_episodes_are_used():
    short = short_episodes([6] * 20 + [30])
    windows, moving = TrainingWindows.of(short, 20, 0), short.windows(1, moving=True)
    assert windows.horizon == 6
    assert len(windows.single) == len(moving)
    room = np.array([len(episode) for episode in short])[moving.episode] - moving.start
    assert len(windows.starts) == np.sum(room >= 6) > 0.25 * len(moving)
    whole = example_dataset()
    usual = TrainingWindows.of(whole, 5, 0)
    assert (usual.horizon, usual.single is usual.starts) == (5, True)
    some = TrainingWindows.of(short_episodes([3] * 10 + [30] * 3), 4, 0)  # enough fits: the short ones are not used
    assert (some.horizon, some.single is some.starts) == (4, True)
    with pytest.raises(InvalidData, match="no episode has a moving sample after the 8 that are the history"):
        TrainingWindows.of(short_episodes([6] * 20), 20, 8)


def test_an_ensemble_says_that_it_was_trained_on_shorter_simulations(tmp_path):
    small = {**HARDLY, "horizon": 20, "members": 2, "state_lags": 0, "control_lags": 0}
    model = make_model("mlp_ensemble", **small).fit(short_episodes([7] * 30), rng=0)
    assert "trained on simulations of 6 steps in place of 20, because episodes are short" in model.fit_note
    assert load_model(save_model(model, tmp_path / "short")).fit_note == model.fit_note
    usual = make_model("mlp_ensemble", **small).fit(example_dataset(), rng=0)
    assert "in place of" not in usual.fit_note


@pytest.mark.parametrize("stochastic", [False, True])
def test_a_member_that_diverges_on_its_held_out_blocks_is_left_out_of_the_mean(stochastic, monkeypatch):
    """Its calibration uses the blocks of the remaining members; which member diverges is decided here."""
    small = {**FAMILIES["mlp_ensemble"], "members": 3, "stochastic": stochastic}
    whole = make_model("mlp_ensemble", **small).fit(example_dataset(), rng=0)
    monkeypatch.setattr("model_zoo.networks.mlp_ensemble.held_together", lambda errors: np.array([0, 2]))
    model = make_model("mlp_ensemble", **small).fit(example_dataset(), rng=0)
    assert "1 of 3 networks are left out" in model.fit_note
    assert "left out" not in whole.fit_note
    for found, expected in zip(model.weights_, whole.weights_, strict=True):
        np.testing.assert_array_equal(found, expected[[0, 2]])
    if stochastic:
        data, errors = example_dataset(), []
        for place, member in enumerate((0, 2)):
            windows = time_fold(data, member, model.folds)[1].windows(1, history=model.n_lags)
            simulated = model._of_member(place).simulate(windows.past_states, windows.past_controls, windows.controls)
            errors.append((windows.states - simulated)[:, 0])
        np.testing.assert_allclose(model.residual_, np.sqrt(np.mean(np.concatenate(errors) ** 2, axis=0)))


def test_members_diverge_whose_error_is_three_times_the_median():
    assert held_together(np.array([1.0, 1.2, 3.5, np.inf, 0.1])).tolist() == [0, 1, 2, 4]
    assert held_together(np.array([1.0, 1.2, 3.7])).tolist() == [0, 1]
    assert held_together(np.full(3, np.inf)).tolist() == [0, 1, 2]


@pytest.mark.parametrize("family", ["mlp_ensemble", "neural_ode", "hybrid_ode"])
def test_what_was_trained_is_what_steps(family, car_data, monkeypatch):
    """Its free runs over the held-out windows, in single precision, are those of the fitted model."""
    seen = []
    learn = DifferentiableSimulation.learn

    def watched(self, *arguments):
        learned = learn(self, *arguments)
        seen.append((self, learned[0]))
        return learned

    monkeypatch.setattr(DifferentiableSimulation, "learn", watched)
    small = {"hidden": [8], "one_step_updates": 40, "updates": 20, "horizon": 4, "state_lags": 1, "control_lags": 2}
    model = make_model(family, **small, **({"members": 1} if family == "mlp_ensemble" else {}))
    model.fit(car_data, rng=0)
    trained, trained.parameters = seen[-1]
    trained.flag = trained.recorded
    windows = car_data.windows(5, stride=20, history=2)
    shots = TrainingWindows.at(car_data, windows.episode, windows.start, 5)
    found = trained.run(Batches([shots], 2).of([np.arange(len(shots))], 5))
    expected = model.simulate(windows.past_states, windows.past_controls, windows.controls)
    np.testing.assert_allclose(np.moveaxis(found[:, 0], 0, 1), expected, atol=2e-4)


def test_a_state_that_never_changes_stays_as_it_is():
    states, controls = (Channel("position", "m"), Channel("goal", "m")), (Channel("push", low=-1.0, high=1.0),)
    system = System(states, controls, dt=0.1)
    rng = np.random.default_rng(0)
    pushes = [rng.uniform(-1.0, 1.0, (30, 1)) for _ in range(4)]
    states = [np.column_stack([0.1 * np.cumsum([0.0, *push[:, 0]]), np.full(31, rng.normal())]) for push in pushes]
    data = Dataset.from_arrays(system, states, pushes)
    model = MlpEnsemble(**HARDLY, members=1, state_lags=0, control_lags=0).fit(data, rng=rng)
    simulated = model.simulate(states[0][:1], pushes[0][:0], pushes[0])
    np.testing.assert_allclose(simulated[:, 1], states[0][0, 1], atol=1e-3)
    assert np.ptp(simulated[:, 0]) > 1e-3


def test_the_lags_of_a_neural_ode_are_chosen_if_all_are_searched(car_data):
    assert make_model("neural_ode(lag_search=all)", **HARDLY).fit(car_data, rng=3).lags in ((0, 2), (0, 3), (1, 3))


def test_the_rotation_of_the_frame_alone_keeps_the_speed(car):
    state = np.array([[1.0, 0.2, 3.0]])
    after = rk4(car.frame_rotation, state, 0.05)
    assert np.hypot(*after[0, :2]) == pytest.approx(np.hypot(1.0, 0.2), abs=1e-6)


def test_runge_kutta_is_of_fourth_order():
    def error(dt):
        state = np.array([[1.0]])
        for _ in range(round(1.0 / dt)):
            state = rk4(lambda x: -(x**2), state, dt)
        return abs(float(state[0, 0]) - 0.5)

    assert 3.7 < np.log2(error(0.1) / error(0.05)) < 4.3


def test_a_mirrored_car_steers_the_other_way(car):
    mirror = Mirror.of(car, ["steer"])
    assert mirror is not None
    assert mirror.states.tolist() == [1.0, -1.0, -1.0]
    assert mirror.controls.tolist() == [1.0, -1.0]
    assert Mirror.of(car, ["rudder"]) is None


def test_the_ensemble_learns_and_its_members_differ(ensemble, car_data):
    windows = car_data.windows(20, stride=10, history=2)
    simulated = ensemble.simulate(windows.past_states, windows.past_controls, windows.controls)
    error = np.sqrt(np.mean((simulated - windows.states) ** 2)) / windows.states.std()
    assert error < 0.5
    carry = ensemble.start(windows.past_states, windows.past_controls)
    outputs = ensemble.network(np.concatenate([carry, windows.controls[:, 0]], axis=1))
    assert np.abs(outputs[0] - outputs[1]).max() > 1e-3


def test_ninety_per_cent_intervals_hold_ninety_per_cent():
    ensemble = make_model("mlp_ensemble", **FAMILIES["mlp_ensemble"], stochastic=True).fit(example_dataset(), rng=0)
    fresh = example_dataset(seed=9)
    windows = fresh.windows(20, stride=5, history=ensemble.n_lags + ensemble.n_recent)
    assert 1.0 <= np.median(ensemble.start(windows.past_states, windows.past_controls)[:, -1]) < 1.4
    drawn = ensemble.simulate(
        windows.past_states, windows.past_controls, windows.controls, samples=60, rng=np.random.default_rng(0)
    )
    low, high = np.quantile(drawn[:, :, -1], [0.05, 0.95], axis=0)
    truth = windows.states[:, -1]
    assert 0.75 < float(((truth >= low) & (truth <= high)).mean()) < 0.99


@pytest.mark.parametrize("optimiser", ["adam", "gradient"])
def test_back_propagation_fits_a_linear_map(optimiser):
    rng = np.random.default_rng(0)
    inputs = rng.standard_normal((200, 3))
    targets = 0.4 * inputs @ rng.standard_normal((3, 2))

    def error(epochs):
        model = Backprop27(epochs=epochs, optimiser=optimiser, learning_rate=0.02 if optimiser == "adam" else 0.2)
        counter = Counter(None, epochs)
        first, first_bias, last, last_bias = model._trained(inputs, targets, np.random.default_rng(1), counter)
        hidden = np.tanh(inputs @ first + first_bias).reshape(200, 2, 8)
        guess: Array = np.einsum("nsh,sh->ns", hidden, last) + last_bias
        return float(np.mean((guess - targets) ** 2) / targets.var())

    assert error(600) < 0.05 < error(1)


@pytest.fixture(scope="module")
def training():
    return drive(FloorCar(), seconds=20.0, seed=1)


@pytest.fixture(scope="module")
def there():
    return drive(FloorCar(thrust=1.5), seconds=10.0, seed=2)


def learned(model):
    """Return copies of all that training changes."""
    names = [name for name in ("weights_", "biases_", "physical_") if hasattr(model, name)]
    return {name: [np.array(one) for one in getattr(model, name)] for name in names}


def same(one, other):
    return all((a == b).all() for a, b in zip(one, other, strict=True))


@pytest.mark.parametrize("family", FAMILIES)
def test_every_parameter_learns_and_the_model_stays_what_it_was(family, training, there):
    model = make_model(family, **FAMILIES[family]).fit(training, rng=0)
    before = learned(model)
    further = model.fine_tuned(there, 3, rng=np.random.default_rng(1))
    assert type(further) is type(model)
    assert further is not model
    assert further.lags == model.lags
    after, again = (learned(one) for one in (further, model.fine_tuned(there, 3, rng=np.random.default_rng(1))))
    assert not any(same(after[name], before[name]) for name in before)
    assert all(same(after[name], again[name]) for name in before)
    assert all(same(learned(model)[name], before[name]) for name in before)


@pytest.mark.parametrize("family", FAMILIES)
def test_it_is_trained_so_long_on_single_steps_and_runs_of_its_own_length_and_in_the_mirror(
    family, training, there, monkeypatch
):
    plans, signs = [], []
    model = make_model(family, **FAMILIES[family]).fit(training, rng=0)
    original = DifferentiableSimulation.fine_tune

    def remembered(self, dataset, plan, trainings):
        plans.append(plan)
        signs.append(self.mirror.states.tolist())
        assert dataset is there
        return original(self, dataset, plan, trainings)

    monkeypatch.setattr(DifferentiableSimulation, "fine_tune", remembered)
    model.fine_tuned(there, 7, rng=np.random.default_rng(1))
    (plan,) = plans
    assert (plan.one_step_updates, plan.updates, plan.horizon) == (5, 2, 5)
    assert plan.learning_rate == TrainingSchedule(1, 1, 1).learning_rate
    assert plan.input_noise == model.input_noise
    assert signs == [[1.0, -1.0, -1.0]]


@pytest.mark.parametrize("family", ["mlp_ensemble", "neural_ode"])
def test_right_turns_are_predicted_better_after_training_on_left_turns(family, training, monkeypatch):
    model = make_model(family, **{**FAMILIES[family], "one_step_updates": 300, "updates": 20}).fit(training, rng=0)
    other, steps, rng = FloorCar(turn=2.0), 300, np.random.default_rng(3)
    controls = np.repeat(rng.uniform([0.3, 0.2], 1.0, (steps // 5, 2)), 5, axis=0)
    left = recorded(other, controls)
    right = recorded(other, controls * [1.0, -1.0])
    seen_in_the_mirror = model.fine_tuned(left, 200, rng=np.random.default_rng(0)).score(right)
    monkeypatch.setattr(Mirror, "of", lambda *_: None)
    assert seen_in_the_mirror > 0.93 * model.fine_tuned(left, 200, rng=np.random.default_rng(0)).score(right)


def recorded(car, controls):
    """Return what the car does from rest under ``controls`` (H, 2)."""
    states = np.zeros((len(controls) + 1, 3))
    for k, control in enumerate(controls):
        states[k + 1] = car.step(states[k : k + 1], control[None])[0]
    return Dataset.from_arrays(car.system, states, controls)


def test_fine_tuning_a_mean_keeps_its_weights_and_members_without_updates(training, there):
    rng = np.random.default_rng(0)
    network = make_model("mlp_ensemble", **FAMILIES["mlp_ensemble"]).fit(training, rng=rng)
    linear = make_model("auto", candidates=["linear"], folds=2).fit(training, rng=rng)
    mean = linear.of([network, linear.members_[0]], np.array([0.25, 0.75]))
    further = mean.fine_tuned(there, 2, rng=rng)
    np.testing.assert_array_equal(further.weights_, [0.25, 0.75])
    assert further.members_[1] is linear.members_[0]
    assert further.members_[0] is not network
    assert (further.members_[0].weights_[0] != network.weights_[0]).any()
    assert linear.fine_tuned(there, 2, rng=rng) is None
    assert mean.members_[0] is network


def test_the_steps_of_a_simulation_are_weighted_by_their_error_to_the_power_of_minus_2_5():
    error = np.array([[0.1, 0.3], [0.4, 0.4], [0.9, 1.1]])
    weight = (np.array([0.2, 0.4, 1.0]) + FLOOR) ** -SHARPNESS
    np.testing.assert_allclose(step_weights(error), weight / weight.sum(), rtol=1e-5)
    assert SHARPNESS == 2.5
    assert step_weights(np.zeros((3, 1))) == pytest.approx([1 / 3] * 3)


class Drifting:
    """A model of one number p that predicts p after one step and 4 p after two."""

    layout, standard = CarryLayout(1, 0), SimpleNamespace(state_scale=np.ones(1), change=np.ones(1))

    def __init__(self) -> None:
        self.parameters = np.full((1, 1), 0.5)

    def run(self, samples):
        steps, size = len(samples) - 1, samples.shape[2]
        return self.parameters[0, 0] * np.tile(4.0 ** np.arange(steps)[:, None, None, None], (1, 1, size, 1))

    def gradient(self, by_states):
        steps = 4.0 ** np.arange(len(by_states))[:, None, None, None]
        return np.sum(by_states * steps).reshape(1, 1)

    def augmented(self, samples, rng):
        return samples


def test_training_follows_the_weights_of_the_steps():
    """The steps ask for p = 1 and p = 2; the first decides, though the second has the larger error."""
    starts = np.arange(0, 12, 3)
    shots = TrainingWindows(np.tile([[0.0], [1.0], [8.0]], (4, 1)), starts, 2, starts)
    plan = TrainingSchedule(1, 300, 2, batch=4, learning_rate=0.05, weight_decay=0.0, input_noise=0.0, averaging=0.5)
    found = train(Drifting(), [shots], plan, trainings=ResumableTrainings(np.random.default_rng(0)))
    assert float(found[0, 0]) == pytest.approx(1.0, abs=0.1)
