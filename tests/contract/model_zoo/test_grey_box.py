"""Grey boxes find the parameters of known systems, report how sure they are, and name what they cannot know."""

import io
import math
import re
from math import atan2, sin

import numpy as np
import pytest
from rich.console import Console

from hardware.emulation.car_physics import CarParameters
from model_zoo.car.single_track import MAGIC, PARAMETERS, SingleTrack, magic, pacejka_rate, tanh_rate
from model_zoo.grey_box import HiddenState, Parameter
from sysid_evo.cli.models import card_table, model_card
from sysid_evo.data import Dataset
from sysid_evo.errors import IncompatibleSystem, InvalidArgument
from sysid_evo.laws import array_form
from sysid_evo.models import load_model, save_model
from sysid_evo.models.base import make_model
from sysid_evo.motion import PlanarBody
from sysid_evo.registry import make_robot, models
from sysid_evo.system import Channel, System
from sysid_evo.testing import MODEL
from tests.fixtures.plants import PENDULUM, Accelerated, Cylinder, HeavyPendulum, Pendulum, cylinder, pendulum, recorded

SHARE = 0.25


def positive(value):
    return value if value > 0.0 else 0.0


def everything(x, y):
    inside = (0.0 < x < 1.0 and not y > 0.5) or y < -1.0
    total = SHARE if inside else positive(x) + math.exp(-abs(y))
    for i in range(2):
        total += min(x, y, 0.3) * max(x, float(i)) + sin(y) * atan2(y, x + 5.0)
    return total, math.copysign(math.pi, y)


def test_every_construct_gives_the_same_number_for_number():
    rng = np.random.default_rng(0)
    x, y = rng.uniform(-2.0, 2.0, (2, 200))
    for found, row in zip(np.array(array_form(everything)(x, y)).T, zip(x, y, strict=True), strict=True):
        np.testing.assert_allclose(found, everything(*map(float, row)), rtol=1e-12)


def branching(x):
    if x > 0.0:
        return x
    return 0.0


def test_a_statement_that_would_choose_for_all_rows_is_refused_with_what_to_write():
    with pytest.raises(InvalidArgument, match=r"function branching, line 2 of it: 'if'.*'a if test else b'"):
        array_form(branching)


QUICK = {"starts": 2, "windows": 80}


@pytest.fixture(scope="module")
def swinging():
    return pendulum()


@pytest.fixture(scope="module")
def heavy(swinging):
    """A pendulum of whose parameters the data determine two."""
    return HeavyPendulum(**QUICK).fit(swinging, rng=0)


@pytest.fixture(autouse=True)
def registered(register):
    for family in (Pendulum, HeavyPendulum, Cylinder):
        register(models, f"grey_{family.__name__.lower()}", family)


def found(model):
    return {row["parameter"]: row["value"] for row in model.parameters_table()}


def test_the_parameters_of_a_pendulum_are_found_within_a_percent(swinging):
    """Their standard errors are about 0.3 %, of friction 2 %."""
    values = found(Pendulum(**QUICK).fit(swinging, rng=0))
    np.testing.assert_allclose([values["stiffness"], values["gain"]], [9.0, 2.0], rtol=0.01)
    assert values["friction"] == pytest.approx(0.5, abs=0.05)


def test_lag_and_delay_of_the_actuator_are_found():
    """A lag of 120 ms behind one sample of delay: together 170 ms, within a fifth of a sample of it."""
    model = Pendulum(actuator_lag=True, command_delay=True, **QUICK).fit(pendulum(lag=0.12, delay=1), rng=0)
    values = found(model)
    assert values["lag of torque"] == pytest.approx(0.12, abs=0.02)
    assert values["delay of commands"] == pytest.approx(1.0, abs=0.3)
    assert values["lag of torque"] + 0.05 * values["delay of commands"] == pytest.approx(0.17, abs=0.01)


def test_an_unmeasured_pressure_is_estimated_with_its_parameters_and_from_a_history():
    """The free run of a second is then nearly as good as the noise; without the pressure it is not."""
    learned, held = cylinder().split(0.3)
    model = Cylinder(**QUICK).fit(learned, rng=0)
    values = found(model)
    np.testing.assert_allclose(list(values.values()), [40.0, 2.5, 3.0], rtol=0.15)
    noise = 0.01 / np.concatenate([episode.states for episode in held.episodes])[:, 1].std()
    assert -model.score(held) < 2.0 * noise
    assert -make_model("linear").fit(learned).score(held) > 4.0 * noise


@pytest.mark.parametrize(
    ("family", "options", "dataset"),
    [
        ("grey_pendulum", {"actuator_lag": True, "command_delay": True, "substeps": 2}, pendulum),
        ("grey_cylinder", {"residual": True, "residual_points": 12}, cylinder),
    ],
)
def test_a_grey_box_keeps_the_contract(family, options, dataset):
    given = {**QUICK, "starts": 1, "windows": 30, **options}
    broken = [check for check in MODEL.run(family, dataset(steps=150), **given) if check.failure]
    assert not broken


def test_standard_errors_cover_the_truth_at_their_nominal_rate():
    """In 14 recordings, 3 parameters are off by less than 2 standard errors 40 times on average; 34 is 4 deviations."""
    inside = 0
    for seed in range(14):
        model = Pendulum(starts=1, windows=60).fit(pendulum(seed=seed, steps=150), rng=0)
        off = np.abs(model.parameters_ - [9.0, 0.5, 2.0]) / model.standard_errors_
        inside += int((off < 2.0).sum())
        assert (model.standard_errors_ < [0.2, 0.1, 0.1]).all()
    assert inside >= 34


def test_what_the_data_do_not_determine_is_named(heavy):
    model = heavy
    together = [sentence for sentence in model.undetermined_ if "combination" in sentence]
    assert len(together) == 1
    assert re.search("(motor and inertia|inertia and motor) may grow together", together[0])
    assert any("unused is not determined by the data" in sentence for sentence in model.undetermined_)
    assert [row["parameter"] for row in model.parameters_table() if row["determined"]][:2] == ["stiffness", "friction"]
    assert "unused" in model.fit_note
    correlations = {row["parameter"]: row.get("correlations", {}) for row in model.parameters_table()}
    assert correlations["motor"]["inertia"] == correlations["inertia"]["motor"] > 0.9
    assert not correlations["stiffness"]


def test_a_measurement_of_one_of_two_decides_the_other(swinging):
    class Weighed(HeavyPendulum):
        parameters = tuple(
            Parameter("inertia", 3.0, 0.1, 10.0, "kg m^2", spread=0.05) if one.name == "inertia" else one
            for one in HeavyPendulum.parameters
        )

    model = Weighed(**QUICK).fit(swinging, rng=0)
    assert found(model)["inertia"] == pytest.approx(3.0, abs=0.2)
    assert found(model)["motor"] == pytest.approx(6.0, abs=0.5)
    assert not any("combination" in sentence for sentence in model.undetermined_)


def test_a_robust_fit_is_not_moved_by_a_sensor_that_jumps(swinging):
    """Of every fiftieth sample the rate is wrong by 3 rad/s."""
    states = [episode.states.copy() for episode in swinging.episodes]
    for run in states:
        run[::50, 1] += 3.0
    jumping = Dataset.from_arrays(swinging.system, states, [episode.controls for episode in swinging.episodes])
    off = [abs(found(Pendulum(robust=robust, **QUICK).fit(jumping, rng=0))["gain"] - 2.0) for robust in (True, False)]
    assert off[0] < 0.05
    assert off[0] < off[1]


def test_a_stored_grey_box_has_its_table(swinging, tmp_path):
    model = Pendulum(starts=1, windows=30, command_delay=True).fit(swinging, rng=0)
    assert load_model(save_model(model, tmp_path / "model")).parameters_table() == model.parameters_table()


def test_an_acceleration_is_a_shorter_way_to_write_the_same_law(swinging):
    whole, short = (family(starts=1, windows=30).fit(swinging, rng=0) for family in (Pendulum, Accelerated))
    np.testing.assert_allclose(short.parameters_, whole.parameters_, rtol=1e-4)
    states, control = np.array([[0.7, -1.5], [0.1, 2.0]]), np.array([[0.4], [-1.0]])
    short.parameters_ = whole.parameters_
    np.testing.assert_allclose(short.step(states, control), whole.step(states, control), rtol=1e-12)


def half(state, control, p):
    return (state[1],)


@pytest.mark.parametrize(
    ("law", "changed", "error", "said"),
    [
        (
            Pendulum,
            {"hidden_states": (HiddenState("warmth", "K"),)},
            InvalidArgument,
            "rates from 3 states.*too many values to",
        ),
        (Pendulum, {"rate": staticmethod(half)}, InvalidArgument, "expected 2 rates, of angle, spin; got 1"),
        (Pendulum, {"controls": ("force",)}, IncompatibleSystem, "needs the control 'force': the system has torque"),
        (Pendulum, {"states": ("spin",)}, IncompatibleSystem, "lacks angle"),
        (Pendulum, {"rate_of": {"angle": "spin"}}, InvalidArgument, "rate returns those of all states"),
        (
            Accelerated,
            {"rate_of": {}},
            InvalidArgument,
            r"of angle, spin; got 1\. .* name both in rate_of",
        ),
    ],
)
def test_a_law_that_does_not_fit_the_system_is_refused_before_the_fit(law, changed, error, said, swinging):
    with pytest.raises(error, match=said):
        type("Changed", (law,), changed)().fit(swinging)


def stopped(**options):
    """Return a pendulum with a stop that the law does not know: beyond 0.8 rad it is pushed back."""

    def rate(x, u):
        stop = 30.0 * max(abs(x[0]) - 0.8, 0.0) * (1.0 if x[0] > 0.0 else -1.0)
        return [x[1], -9.0 * np.sin(x[0]) - 0.5 * x[1] + 4.0 * u - stop]

    return recorded(PENDULUM, rate, [0.5, 0.0], noise=(0.003, 0.01), **options)


def test_a_residual_learns_what_the_law_lacks_and_is_nothing_far_from_the_data():
    learned, fresh = stopped(), stopped(seed=1)
    physics = Pendulum(**QUICK).fit(learned, rng=0)
    model = Pendulum(residual=True, **QUICK).fit(learned, rng=0)
    np.testing.assert_array_equal(model.parameters_, physics.parameters_)
    assert -model.score(fresh) < -0.7 * physics.score(fresh)
    assert "100 % of the residual is kept" in model.fit_note
    far = np.array([[0.5, 400.0]])
    np.testing.assert_allclose(model.step(far, np.zeros((1, 1))), physics.step(far, np.zeros((1, 1))), rtol=1e-9)


def test_a_residual_of_a_law_that_lacks_nothing_is_not_kept(swinging):
    model = Pendulum(residual=True, **QUICK).fit(swinging, rng=0)
    assert model.residual_share_ == 0.0


def test_the_card_of_a_stored_grey_box_prints_its_parameters(heavy, tmp_path):
    card = model_card(save_model(heavy, tmp_path / "model"))
    assert "unused is not determined by the data" in card["note"]
    console = Console(width=100, record=True, file=io.StringIO())
    for part in card_table(card):
        console.print(part)
    printed = console.export_text()
    assert re.search(r"stiffness +[89]\S* +0\.\d+ +1/s\^2", printed)
    assert re.search(r"unused .* m +not determined", printed)


GUESS = tuple(parameter.guess for parameter in (*PARAMETERS, *MAGIC))


@pytest.mark.nightly
def test_the_parameters_of_the_emulated_car_are_found(monkeypatch):
    """Within a fifth: thrust, grip of the front, where the rear axle is; the lags within 30 ms, with the delay 15 ms.

    The car has battery sag, play, noise and other drags, which this one has not.
    """
    monkeypatch.setenv("SYSID_EVO_ENGINE", "auto")
    dataset, car = make_robot("emulated_car").record(seed=0, duration=180.0).dataset, CarParameters()
    learned = SingleTrack(tyre="tanh", starts=1, windows=150).fit(dataset, rng=0)
    found = {row["parameter"]: row["value"] for row in learned.parameters_table()}
    assert found["thrust_forward"] == pytest.approx(car.thrust_forward, rel=0.2)
    assert found["thrust_backward"] == pytest.approx(car.thrust_backward, rel=0.2)
    assert found["rolling_resistance"] == pytest.approx(car.rolling_resistance, rel=0.3)
    assert found["front_grip"] == pytest.approx(car.front_grip / car.mass, rel=0.25)
    assert found["steer_left"] / found["steer_right"] == pytest.approx(car.steer_left / car.steer_right, rel=0.1)
    late = 0.05 * found["delay of commands"]
    assert found["lag of drive"] + late == pytest.approx(car.motor_lag + 0.05, abs=0.03)
    assert found["lag of steer"] + late == pytest.approx(car.steering_lag + 0.05, abs=0.03)


@pytest.mark.parametrize("law", [pacejka_rate, tanh_rate])
def test_tyres_push_to_the_side_that_is_steered_to_and_no_more_than_their_grip(law):
    along, across, turning = law((1.5, 0.0, 0.0), (0.0, 0.5), GUESS)
    mirrored = law((1.5, 0.0, 0.0), (0.0, -0.5), GUESS)
    assert across > 0.0
    assert turning > 0.0
    np.testing.assert_allclose(mirrored, (along, -across, -turning))
    sliding = law((1.5, -9.0, 0.0), (0.0, 0.0), GUESS)
    grip = (
        GUESS[[p.name for p in PARAMETERS].index("front_grip")] + GUESS[[p.name for p in PARAMETERS].index("rear_grip")]
    )
    assert 0.5 * grip < sliding[1] <= grip


def test_the_magic_formula_begins_with_slope_c_and_has_its_peak_at_one():
    assert magic(1e-6, 1.4, 0.3) == pytest.approx(1.4e-6, rel=1e-6)
    assert max(magic(slip, 1.4, 0.0) for slip in np.linspace(0.0, 20.0, 2001)) == pytest.approx(1.0, abs=1e-4)
    assert magic(50.0, 1.4, 0.0) == pytest.approx(math.sin(1.4 * math.atan(50.0)))


def test_a_car_whose_sideways_speed_is_not_measured_is_refused():
    states = (Channel("forward_speed"), Channel("yaw_rate"))
    system = System(states, (Channel("drive"), Channel("steer")), 0.05, PlanarBody(lateral=None))
    with pytest.raises(IncompatibleSystem, match="needs the lateral speed"):
        SingleTrack().check_system(system)
