"""What sparse families see of states and controls, which setting they choose, and the units they print."""

import numpy as np
import pytest

from evaluation.chosen_models import with_preset
from model_zoo.features import Features, powers, quotient
from model_zoo.polynomial.narx import forward_selection
from model_zoo.polynomial.sindy import SindyDiscrete
from sysid_evo.data import Dataset
from sysid_evo.errors import InvalidArgument
from sysid_evo.models.base import make_model
from sysid_evo.registry import Spec
from sysid_evo.system import Channel, System
from sysid_evo.validation.held_out import HeldOutError, best_candidate, lag_candidates
from tests.fixtures.families import PERIODIC
from tests.fixtures.systems import DRIVEN, SWING, swung


@pytest.fixture(scope="module", autouse=True)
def pysindy():
    """SINDy imports it in its first fit, which takes longer than a unit test may."""
    return pytest.importorskip("pysindy")


def test_a_periodic_state_enters_as_sine_and_cosine_with_its_lags():
    features = Features(SWING, (1, 1))
    carry, control = np.array([[0.5, 2.0, 0.25, 3.0, 7.0]]), np.array([[8.0]])
    expected = [np.sin(0.5), np.cos(0.5), 2.0, np.sin(0.25), np.cos(0.25), 3.0, 7.0, 8.0]
    np.testing.assert_allclose(features(carry, control)[0], expected)
    assert features.names[3:5] == ["sin angle[-1]", "cos angle[-1]"]
    assert features.units == ["", "", "rad/s", "", "", "rad/s", "N m", "N m"]
    assert not features.plain


def test_functions_of_single_channels_join_the_features():
    system = System((Channel("speed", "m/s"),), (Channel("drive"),), 0.1)
    features = Features(system, (0, 1), ("abs(speed)", "tanh(drive)"))
    found = features(np.array([[-2.0, 0.5]]), np.array([[1.0]]))
    np.testing.assert_allclose(found[0], [-2.0, 0.5, 1.0, 2.0, np.tanh(1.0)])
    assert features.names[-2:] == ["abs(speed)", "tanh(drive)"]
    assert features.units[-2:] == ["m/s", ""]
    for wrong in ("cube(speed)", "abs(height)", "speed"):
        with pytest.raises(InvalidArgument, match=r"expected NAME\(CHANNEL\) with one of abs, .*speed, drive, got"):
            make_model("sindy", functions=[wrong]).check_system(system)


def test_a_pendulum_is_recovered_over_the_top():
    """Sine and cosine of the angle are in the library, and a free run goes round as the pendulum does."""
    data = swung(1)
    assert max(np.abs(e.states[:, 0]).max() for e in data) > np.pi
    model = make_model("sindy_discrete", degree=1, threshold=1e-4, ridge=0.0, state_lags=0, control_lags=0)
    model.fit(data)
    assert model.score(data) > -1e-6
    assert "sin angle" in model.equations()[1]
    assert model.equations()[0].startswith("angle[+1] - angle = 0.05 [s] rate")
    turn = np.array([2 * np.pi, 0.0])
    carry, control = data.episodes[0].states[:-1], data.episodes[0].controls
    np.testing.assert_allclose(model.step(carry + turn, control), model.step(carry, control) + turn)


@pytest.mark.parametrize("family", PERIODIC)
def test_a_full_turn_of_a_periodic_state_changes_nothing(family):
    """Also for lags: every family that compares or multiplies states sees sine and cosine."""
    data = swung(1, steps=120)
    model = make_model(family, **PERIODIC[family], state_lags=1, control_lags=1).fit(data)
    steps = data.transitions(state_lags=1, control_lags=1)
    turn = np.array([2 * np.pi, 0.0, 2 * np.pi, 0.0, 0.0])
    expected = model.step(steps.carry, steps.control)
    np.testing.assert_allclose(model.step(steps.carry + turn, steps.control), expected + turn, atol=1e-7)
    assert model.score(data) > -0.8


def test_drag_that_is_no_polynomial_is_found_among_the_functions_asked_for():
    system = System((Channel("speed", "m/s"),), (Channel("drive", low=-1.0, high=1.0),), 0.02)
    rng = np.random.default_rng(0)
    drive = np.repeat(rng.uniform(-1.0, 1.0, (60, 1)), 10, axis=0)
    speed = [np.zeros(1)]
    for u in drive:
        speed.append(speed[-1] + 0.02 * (3.0 * u - 0.8 * speed[-1] * np.abs(speed[-1])))
    data = Dataset.from_arrays(system, [np.array(speed)], [drive])
    options = {"degree": 2, "threshold": 0.001, "ridge": 0.0, "control_lags": 0, "state_lags": 0}
    with_drag = make_model("sindy_discrete", functions=["abs(speed)"], **options).fit(data)
    assert "0.016 [s/m] speed abs(speed)" in with_drag.equations()[0]
    assert with_drag.score(data) > -1e-6 > make_model("sindy_discrete", **options).fit(data).score(data)


def test_among_settings_as_good_as_each_other_the_smallest_is_chosen():
    errors, sizes = {"large": 1.0, "small": 1.04, "smaller": 1.2}, {"large": 9, "small": 3, "smaller": 1}
    assert best_candidate(list(errors), errors.__getitem__) == "large"
    assert best_candidate(list(errors), errors.__getitem__, size=sizes.__getitem__) == "small"
    assert best_candidate(["only"], errors.__getitem__) == "only"


@pytest.mark.parametrize(
    ("unit", "divisors", "expected"),
    [
        ("m/s/s", [("m/s", 1)], "1/s"),
        ("m/s^2", [("", 3)], "m/s^2"),
        ("rad/s/s", [("m/s", 1), ("", 1)], "rad/s/m"),
        ("m/s", [("m/s", 1)], ""),
        ("m/s/s", [("m/s", 2)], "1/m"),
        ("rad/s", [("N m", 1)], "rad/s/N/m"),
        ("1/s", [], "1/s"),
        ("m s", [("s", 1)], "m"),
    ],
)
def test_units_are_reduced(unit, divisors, expected):
    assert quotient(unit, divisors) == expected


def test_what_cannot_be_read_as_a_unit_stays_one_symbol():
    assert powers("(m/s)^x") == {"(m/s)^x": 1}


SYSTEM = System(
    (Channel("speed", "m/s"), Channel("angle", "rad")), (Channel("force", "N", low=-1.0, high=1.0),), dt=0.1
)


def recorded(dead_time):
    """Return recordings of a body whose force acts ``dead_time`` samples late."""
    rng = np.random.default_rng(2)
    states, controls = [], []
    for _ in range(4):
        force = np.repeat(rng.uniform(-1.0, 1.0, 40), 4)
        state = [np.zeros(2)]
        for k in range(len(force)):
            speed, angle = state[-1]
            late = force[k - dead_time] if k >= dead_time else 0.0
            after = [speed + 0.1 * (3.0 * late - 2.0 * angle - 0.5 * speed), angle + 0.1 * speed]
            state.append(np.array(after))
        states.append(np.array(state))
        controls.append(force[:, None])
    return Dataset.from_arrays(SYSTEM, states, controls)


@pytest.mark.parametrize("dead_time", [0, 2])
@pytest.mark.parametrize("family", ["narx", "sindy", "sindy_discrete"])
def test_a_quick_model_has_lags_where_a_force_acts_late_and_none_where_it_acts_at_once(family, dead_time):
    lags = make_model(with_preset(Spec(family), "quick")).fit(recorded(dead_time), rng=0).lags
    assert lags[1] == 3 if dead_time else lags == (0, 0)


def test_given_lags_are_kept():
    assert lag_candidates(2, 3) == [(2, 3)]
    assert lag_candidates(None, 0, ((0, 0), (1, 3))) == [(0, 0), (1, 0)]


def test_a_delayed_control_is_found_by_simulation():
    system = System((Channel("speed", "m/s"),), (Channel("drive", low=-1.0, high=1.0),), 0.05)
    rng = np.random.default_rng(2)
    control = np.repeat(rng.uniform(-1, 1, (100, 1)), 4, axis=0)
    state = np.zeros((401, 1))
    for k in range(2, 400):
        state[k + 1] = 0.8 * state[k] + 0.3 * control[k - 2]
    dataset = Dataset.from_arrays(system, [state], [control])
    model = SindyDiscrete(degree=1).fit(dataset, rng=0)
    assert model.lags[1] >= 2
    assert any("drive[-2]" in line for line in model.equations())


def test_forward_selection_takes_the_largest_share_first():
    library = np.random.default_rng(0).standard_normal((300, 6))
    target = 3.0 * library[:, 4] + library[:, 1]
    assert forward_selection(library, target, 4).tolist()[:2] == [4, 1]
    assert len(forward_selection(library, target, 4)) == 2


def test_narx_never_chooses_a_setting_that_diverges(monkeypatch):
    """The one it would choose, said to diverge."""
    learned = DRIVEN.recording(seed=3)
    free = make_model("narx", degree=1, state_lags=0, control_lags=0, terms=None).fit(learned)
    usual = free.terms_
    diverges = HeldOutError.diverges
    monkeypatch.setattr(
        HeldOutError, "diverges", lambda self, model, run: model.terms == usual or diverges(self, model, run)
    )
    assert make_model("narx", degree=1, state_lags=0, control_lags=0).fit(learned).terms_ != usual
