"""The compiled plane through neighbours against its NumPy step, and kernels that follow what was learned last."""

from dataclasses import replace

import numpy as np
import pytest

from model_zoo import neighbours_kernel
from sysid_evo.data import Dataset
from sysid_evo.engine.compiled.open_loop import kernel_step
from sysid_evo.kernels import LANES
from sysid_evo.models.base import make_model
from sysid_evo.system import Channel, System
from sysid_evo.testing import example_dataset
from tests.fixtures.lanes import step_between_guards

pytestmark = pytest.mark.filterwarnings("ignore::sysid_evo.errors.DataWarning")  # some fits are to a few points


def fitted(dataset, neighbours=8, lags=(0, 0), **options):
    model = make_model("k_neighbours", neighbours=neighbours, state_lags=lags[0], control_lags=lags[1], **options)
    return model.fit(dataset, rng=0)


def queries(model, rng, away):
    """64 carries and legal controls: recorded ones of several steps, moved by ``away`` deviations."""
    carry = model.points_[rng.integers(len(model.points_), size=LANES)] / model.metric_
    control = model.points_[rng.integers(len(model.points_), size=LANES)] / model.metric_
    carry = carry + away * rng.standard_normal(carry.shape) / model.metric_
    return carry[:, : model.n_carry], control[:, model.n_carry :]


def agree(model, carry, control):
    found = step_between_guards(model.kernel(), carry, control, precision="float64")
    np.testing.assert_allclose(found, model.step(carry, control), rtol=1e-9, atol=1e-9)
    return found


LAGS, NUMBERS = ((0, 0), (0, 3), (2, 0), (1, 3)), (1, 8, 20, 40)
DAILY = [(1, (0, 0)), (8, (0, 3)), (20, (2, 0)), (40, (1, 3))]
PRODUCT = [pytest.param(n, lags, marks=() if (n, lags) in DAILY else pytest.mark.nightly) for n in NUMBERS
           for lags in LAGS]  # fmt: skip


@pytest.mark.parametrize("neighbours, lags", PRODUCT)
@pytest.mark.parametrize("recording", ["car_data", "throttle_car_data"])
def test_one_step_is_that_of_numpy_near_the_data_and_far_from_it(recording, neighbours, lags, request, rng):
    model = fitted(request.getfixturevalue(recording), neighbours, lags)
    for away in (0.1, 0.5, 3.0, 100.0):
        agree(model, *queries(model, rng, away))


@pytest.mark.parametrize("neighbours", [1, 20])
def test_asking_groups_of_buckets_first_finds_the_same_neighbours(neighbours, throttle_car_data, rng, monkeypatch):
    """Among many points; a query that is not a number, or far away, ends as well."""
    monkeypatch.setattr(neighbours_kernel, "MANY", 1)
    model = fitted(throttle_car_data, neighbours)
    for away in (0.1, 0.5, 3.0, 100.0):
        carry, control = queries(model, rng, away)
        agree(model, carry, control)
    expected = model.step(carry, control)
    carry[0], carry[1] = np.nan, 1e30
    found = step_between_guards(model.kernel(), carry, control, precision="float64")
    np.testing.assert_allclose(found[2:], expected[2:], rtol=1e-9, atol=1e-9)


@pytest.mark.nightly
def test_a_step_in_float32_is_that_of_numpy_to_its_precision(throttle_car_data, rng):
    model = fitted(throttle_car_data, 20, (1, 3))
    carry, control = queries(model, rng, 0.3)
    found = step_between_guards(model.kernel(), carry, control, precision="float32")
    assert np.median(np.abs(found - model.step(carry, control))) < 1e-6


@pytest.mark.parametrize("weight", [0.2, 5.0])
def test_controls_may_count_more_or_less(weight, throttle_car_data, rng):
    model = fitted(throttle_car_data, 8, (0, 1), control_weight=weight)
    agree(model, *queries(model, rng, 0.5))


def test_on_a_recorded_step_the_distance_is_zero(throttle_car_data):
    model = fitted(throttle_car_data, 8)
    asked = model.points_[:LANES] / model.metric_
    agree(model, asked[:, :3], asked[:, 3:])


@pytest.mark.parametrize("steps", [1, 2, 5, 17, 300])
def test_fewer_points_than_neighbours_are_all_used(steps, rng):
    model = fitted(example_dataset(episodes=1, steps=steps), 20)
    assert len(model.points_) <= steps
    agree(model, *queries(model, rng, 0.5))


def test_points_on_top_of_each_other_count_as_often_as_they_are_there(rng):
    """Five copies of an episode: every distance occurs five times, so that ties are within the neighbours."""
    once = example_dataset(episodes=1, steps=60)
    (episode,) = once.episodes
    model = fitted(Dataset.from_arrays(once.system, [episode.states] * 5, [episode.controls] * 5), 10)
    agree(model, *queries(model, rng, 0.5))


def test_one_state_and_one_control_are_enough(oscillator_data, rng):
    system = System((Channel("speed"),), (Channel("force", low=-2.0, high=2.0),), dt=0.1)
    episodes = oscillator_data.episodes
    single = Dataset.from_arrays(system, [e.states[:, 1:] for e in episodes], [e.controls for e in episodes])
    for dataset in (oscillator_data, single):
        model = fitted(dataset)
        agree(model, *queries(model, rng, 0.5))


def limited(system):
    return replace(system, states=tuple(replace(channel, low=-9.0, high=9.0) for channel in system.states))


@pytest.mark.parametrize("family, precision", [("linear", "float32"), ("k_neighbours", "float64"),
                                               ("nearest_neighbour", "float32")])  # fmt: skip
@pytest.mark.parametrize("change", [lambda model, _: setattr(model, "system_", limited(model.system)),
                                    lambda model, data: model.fit(data[0], rng=0)],
                         ids=["attribute", "fit"])  # fmt: skip
def test_a_kernel_is_that_of_the_present_parameters_whatever_was_asked_before(
    family, precision, change, throttle_car_data
):
    model, kernels = make_model(family, control_lags=1).fit(throttle_car_data, rng=0), []
    for changed in (False, True):
        if changed:
            change(model, throttle_car_data)
        some = throttle_car_data.transitions(state_lags=model.lags[0], control_lags=model.lags[1])
        carry, control = some.carry[:40].copy(), some.control[:40]
        carry[:5], control[:5] = 0.0, 0.0
        carry[:5, :3] = 1e-3
        kernels.append(model.kernel())
        assert kernels[-1].precision == precision
        found = kernel_step(kernels[-1], carry, control, precision=precision)
        tolerance = 1e-9 if precision == "float64" else 1e-5
        np.testing.assert_allclose(found, model.step(carry, control), atol=tolerance)
    first, second = kernels
    assert first.source != second.source or not np.array_equal(first.parameters, second.parameters)
