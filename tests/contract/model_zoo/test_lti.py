"""A linear system of python-control is a family: sampled, with an operating point, and an observer if it needs one."""

import numpy as np
import pytest

from sysid_evo import as_model, make_model
from sysid_evo.data import Dataset
from sysid_evo.errors import IncompatibleSystem, InvalidArgument
from sysid_evo.models.adapters import as_spec
from sysid_evo.system import Channel, System
from sysid_evo.testing import MODEL

control = pytest.importorskip("control")
DT = 0.05
A, B = np.array([[0.0, 1.0], [-6.0, -0.8]]), np.array([[0.0], [3.0]])
BOTH = System((Channel("position", "m"), Channel("speed", "m/s")), (Channel("force", "N", -1.0, 1.0),), DT)
POSITION = System(BOTH.states[:1], BOTH.controls, DT)


def commands(seed, steps=200):
    return np.repeat(np.random.default_rng(seed).uniform(-1.0, 1.0, steps // 5), 5)


def response(plant, u, start):
    """Return the outputs (len(u) + 1, ny) of a continuous ``plant`` under held controls, by python-control."""
    discrete = control.sample_system(control.ss(plant), DT, method="zoh")
    t = DT * np.arange(len(u) + 1)
    return control.forced_response(discrete, t, np.append(u, u[-1])[None], start).outputs.reshape(-1, len(t)).T


def recorded(system, plant, noise=0.0, offset=0.0):
    rng = np.random.default_rng(3)
    runs = [response(plant, commands(seed), rng.uniform(-0.5, 0.5, 2)) for seed in range(2)]
    noisy = [run + noise * rng.standard_normal(run.shape) + offset for run in runs]
    return Dataset.from_arrays(system, noisy, [commands(seed)[:, None] for seed in range(2)])


WHOLE, SEEN = control.ss(A, B, np.eye(2), 0), control.tf([3.0], [1.0, 0.8, 6.0])


@pytest.fixture(scope="module")
def whole():
    return recorded(BOTH, WHOLE)


@pytest.fixture(scope="module")
def output():
    return recorded(POSITION, SEEN, noise=0.01)


@pytest.mark.parametrize("thing", [WHOLE, WHOLE.sample(DT, "zoh"), control.ss(A, B, [[2.0, 0.5], [0.0, 4.0]], 0)])
def test_a_measured_state_space_simulates_as_forced_response(thing, whole):
    model = as_model(thing).fit(whole, rng=0)
    u, c = commands(7, 40), np.asarray(thing.C)
    start = np.array([0.3, -0.2])
    plant = control.ss(A, B, c, 0)
    found = model.simulate(c @ start, u)
    np.testing.assert_allclose(found, np.clip(response(plant, u, start)[1:], *model.state_bounds_), atol=1e-12)
    assert model.n_lags == 0


def test_a_transfer_function_starts_at_rest_and_simulates_as_forced_response(output):
    model = as_model(SEEN).fit(output, rng=0)
    u = commands(8, 60)
    np.testing.assert_allclose(model.simulate(np.zeros(1), u), response(SEEN, u, [0.0, 0.0])[1:], atol=1e-12)


def test_inputs_and_outputs_are_found_by_their_names(whole):
    expected = as_model(WHOLE).fit(whole, rng=0)
    turned = control.ss(A, B, np.eye(2)[::-1], 0, outputs=["speed", "position"], inputs=["force"])
    named = as_model(turned).fit(whole, rng=0)
    u = commands(7, 40)
    np.testing.assert_array_equal(named.simulate([0.3, -0.2], u), expected.simulate([0.3, -0.2], u))
    assert "taken as" not in named.fit_note
    other = as_model(control.ss(A, B, np.eye(2), 0, outputs=["a", "b"])).fit(whole, rng=0)
    np.testing.assert_array_equal(other.simulate([0.3, -0.2], u), expected.simulate([0.3, -0.2], u))
    assert "its outputs a, b taken as position, speed" in other.fit_note
    with pytest.raises(IncompatibleSystem, match=r"expected the outputs position, speed, .*got speed, height"):
        as_model(control.ss(A, B, np.eye(2), 0, outputs=["speed", "height"])).fit(whole, rng=0)


def test_controls_are_found_by_their_names():
    two = System(POSITION.states, (Channel("left", "", -1.0, 1.0), Channel("right", "", -1.0, 1.0)), DT)
    u = np.stack([commands(1, 40), commands(2, 40)], axis=1)
    plant = control.ss(-1.0, [[2.0, -1.0]], 1.0, 0)
    data = Dataset.from_arrays(two, [np.linspace(0.0, 1.0, 41)[:, None]], [u])
    turned = control.ss(-1.0, [[-1.0, 2.0]], 1.0, 0, inputs=["right", "left"])
    first, second = (as_model(one).fit(data, rng=0).simulate(np.zeros(1), u) for one in (plant, turned))
    np.testing.assert_array_equal(first, second)


def test_hidden_states_are_estimated_from_history(output):
    model = as_model(SEEN).fit(output, rng=0)
    assert 2 <= model.n_lags <= 66
    assert f"2 states, estimated from 1 outputs by a Kalman observer over {model.n_lags} samples" in model.fit_note
    assert model.score(output) > -0.12, "the noise alone is 0.03"
    forgetful = as_model(SEEN).fit(output, rng=0)
    forgetful.n_lags_ = 0
    assert forgetful.score(output) < 2.0 * model.score(output)


def test_the_operating_point_is_zero_the_mean_or_given(whole):
    moved = recorded(BOTH, WHOLE, offset=5.0)
    given = {"operating_states": [5.0, 5.0], "operating_controls": [0.0]}
    errors = [
        -as_model(WHOLE).set_params(**options).fit(moved, rng=0).score(moved)
        for options in ({}, {"operating_point": "mean"}, given)
    ]
    assert errors[0] > 1.0
    assert errors[1] < 0.5
    assert errors[2] < 1e-9


@pytest.mark.parametrize("thing", [WHOLE, SEEN])
def test_a_linear_system_keeps_the_contract(thing, whole, output):
    results = list(MODEL.run("lti", whole if thing is WHOLE else output, model=as_model(thing).model))
    assert not [f"{one.rule}: {one.failure}" for one in results if one.failure]


@pytest.mark.parametrize(
    ("thing", "error", "message"),
    [
        (control.ss(A, B, np.eye(2), [[0.0], [1.0]]), InvalidArgument, r"expected D = 0: a recorded state cannot"),
        (WHOLE.sample(0.1, "zoh"), InvalidArgument, r"continuous system or dt=0.05 s, as recorded; got dt=0.1 s"),
        (control.nlsys(lambda _t, x, _u, _p: -x, states=2), InvalidArgument, r"pass lambda x, u: system\.dynamics"),
        (control.frd(SEEN, [1.0, 2.0]), InvalidArgument, "pass 'linear_state_space', which is fitted"),
        (SEEN, IncompatibleSystem, r"expected 2 outputs, the states position, speed, .*; got 1 and 1"),
    ],
)
def test_a_system_that_does_not_fit_is_refused(thing, error, message, whole):
    with pytest.raises(error, match=message):
        as_model(thing).fit(whole, rng=0)


@pytest.mark.parametrize(
    ("given", "message"), [(None, "such as control.ss"), ([[[1.0]]], "makes no state space of it")]
)
def test_what_is_no_system_is_refused(given, message, whole):
    with pytest.raises(InvalidArgument, match=message):
        make_model("lti", model=given).fit(whole, rng=0)


def test_an_operating_point_of_other_lengths_and_a_hidden_unstable_state_are_refused(whole, output):
    with pytest.raises(InvalidArgument, match="operating_states: expected 2 numbers, got 1"):
        as_model(WHOLE).set_params(operating_states=[1.0]).fit(whole, rng=0)
    with pytest.raises(InvalidArgument, match="operating_controls: expected 1 numbers, got 2"):
        as_model(WHOLE).set_params(operating_controls=[1.0, 2.0]).fit(whole, rng=0)
    hidden = control.ss([[-1.0, 0.0], [0.0, 1.0]], [[1.0], [1.0]], [[1.0, 0.0]], 0)
    with pytest.raises(InvalidArgument, match="there is no observer for this system"):
        as_model(hidden).fit(output, rng=0)


def test_the_matrices_are_in_the_spec_so_that_a_run_can_be_continued_without_the_object():
    assert as_spec(control.ss(-1.0, 2.0, 1.0, 0.0)).text == "lti(model=[[[-1.0]], [[2.0]], [[1.0]], [[0.0]], 0])"
