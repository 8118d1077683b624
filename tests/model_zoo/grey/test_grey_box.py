"""Grey boxes find the parameters of systems that are known, say how sure they are, and what they cannot know."""

from __future__ import annotations

import io
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from rich.console import Console

from model_zoo.grey_box import GreyBox, Hidden, Parameter
from sysid_evo.cli.models import card_table, model_card
from sysid_evo.data import Dataset
from sysid_evo.engine.compiled.open_loop import kernel_step
from sysid_evo.errors import IncompatibleSystem, InvalidArgument
from sysid_evo.models import load_model, save_model
from sysid_evo.models.base import make_model
from sysid_evo.registry import models
from sysid_evo.testing import run_checks
from tests.fixtures.plants import PENDULUM, Cylinder, HeavyPendulum, Pendulum, cylinder, pendulum, recorded

QUICK: dict[str, Any] = {"starts": 2, "windows": 80}


@pytest.fixture(autouse=True)
def registered(register: Callable[..., Any]) -> None:
    for family in (Pendulum, HeavyPendulum, Cylinder):
        register(models, f"grey_{family.__name__.lower()}", family)


@pytest.fixture(scope="module")
def swinging() -> Dataset:
    return pendulum()


def found(model: GreyBox) -> dict[str, float]:
    return {row["parameter"]: row["value"] for row in model.parameters_table()}


def test_the_parameters_of_a_pendulum_are_found_within_a_percent(swinging: Dataset) -> None:
    """Their standard errors are about 0.3 %, of friction 2 %."""
    values = found(Pendulum(**QUICK).fit(swinging, rng=0))
    np.testing.assert_allclose([values["stiffness"], values["gain"]], [9.0, 2.0], rtol=0.01)
    assert values["friction"] == pytest.approx(0.5, abs=0.05)


def test_lag_and_delay_of_the_actuator_are_found() -> None:
    """A lag of 120 ms behind one sample of delay: together 170 ms, within a fifth of a sample of it."""
    model = Pendulum(actuator_lag=True, command_delay=True, **QUICK).fit(pendulum(lag=0.12, delay=1), rng=0)
    values = found(model)
    assert values["lag of torque"] == pytest.approx(0.12, abs=0.02)
    assert values["delay of commands"] == pytest.approx(1.0, abs=0.3)
    assert values["lag of torque"] + 0.05 * values["delay of commands"] == pytest.approx(0.17, abs=0.01)


def test_a_pressure_that_nobody_measures_is_found_with_its_parameters_and_from_a_history() -> None:
    """The free run of a second is then nearly as good as the noise; without the pressure it is not."""
    learned, held = cylinder().split(0.3)
    model = Cylinder(**QUICK).fit(learned, rng=0)
    values = found(model)
    np.testing.assert_allclose(list(values.values()), [40.0, 2.5, 3.0], rtol=0.15)
    noise = 0.01 / np.concatenate([episode.states for episode in held.episodes])[:, 1].std()
    assert -model.score(held) < 2.0 * noise
    assert -make_model("linear").fit(learned).score(held) > 4.0 * noise


@pytest.mark.parametrize(
    "family, options, dataset",
    [
        ("grey_pendulum", {"actuator_lag": True, "command_delay": True, "substeps": 2, "rest_hold": True}, pendulum),
        ("grey_cylinder", {"residual": True, "residual_points": 12}, cylinder),
    ],
)
def test_a_grey_box_keeps_the_contract_compiled_too(family: str, options: dict[str, Any], dataset: Any) -> None:
    given = {**QUICK, "starts": 1, "windows": 30, **options}
    broken = [check for check in run_checks(family, dataset(steps=150), **given) if check.failure]
    assert not broken


def test_standard_errors_cover_the_truth_as_often_as_they_say() -> None:
    """In 14 recordings, 3 parameters are off by less than 2 standard errors 40 times on average; 34 is 4 deviations."""
    inside = 0
    for seed in range(14):
        model = Pendulum(starts=1, windows=60).fit(pendulum(seed=seed, steps=150), rng=0)
        off = np.abs(model.parameters_ - [9.0, 0.5, 2.0]) / model.standard_errors_
        inside += int((off < 2.0).sum())
        assert (model.standard_errors_ < [0.2, 0.1, 0.1]).all()
    assert inside >= 34


def test_what_the_data_do_not_determine_is_named(swinging: Dataset) -> None:
    model = HeavyPendulum(**QUICK).fit(swinging, rng=0)
    together = [sentence for sentence in model.undetermined_ if "combination" in sentence]
    assert len(together) == 1
    assert re.search("(motor and inertia|inertia and motor) may grow together", together[0])
    assert any("do not determine unused" in sentence for sentence in model.undetermined_)
    assert [row["parameter"] for row in model.parameters_table() if row["determined"]][:2] == ["stiffness", "friction"]
    assert "unused" in model.fit_note


def test_a_measurement_of_one_of_two_decides_the_other(swinging: Dataset) -> None:
    class Weighed(HeavyPendulum):
        parameters = tuple(
            Parameter("inertia", 3.0, 0.1, 10.0, "kg m^2", spread=0.05) if one.name == "inertia" else one
            for one in HeavyPendulum.parameters
        )

    model = Weighed(**QUICK).fit(swinging, rng=0)
    assert found(model)["inertia"] == pytest.approx(3.0, abs=0.2)
    assert found(model)["motor"] == pytest.approx(6.0, abs=0.5)
    assert not any("combination" in sentence for sentence in model.undetermined_)


def test_a_robust_fit_is_not_moved_by_a_sensor_that_jumps(swinging: Dataset) -> None:
    """Of every fiftieth sample the rate is wrong by 3 rad/s."""
    states = [episode.states.copy() for episode in swinging.episodes]
    for run in states:
        run[::50, 1] += 3.0
    jumping = Dataset.from_arrays(swinging.system, states, [episode.controls for episode in swinging.episodes])
    off = [abs(found(Pendulum(robust=robust, **QUICK).fit(jumping, rng=0))["gain"] - 2.0) for robust in (True, False)]
    assert off[0] < 0.05
    assert off[0] < off[1]


def test_a_stored_grey_box_has_its_table(swinging: Dataset, tmp_path: Any) -> None:
    model = Pendulum(starts=1, windows=30, command_delay=True).fit(swinging, rng=0)
    assert load_model(save_model(model, tmp_path / "model")).parameters_table() == model.parameters_table()
    assert model.parameter_names == tuple(row["parameter"] for row in model.parameters_table())


def test_a_law_with_the_wrong_number_of_rates_is_refused_before_the_fit(swinging: Dataset) -> None:
    class Short(Pendulum):
        hidden = (Hidden("warmth", "K"),)

    with pytest.raises(InvalidArgument, match=r"expected a tuple of rates from 3 states.*too many values to unpack"):
        Short().fit(swinging)

    class Half(Pendulum):
        @staticmethod
        def rate(state, control, p):
            return (state[1],)

    with pytest.raises(InvalidArgument, match="expected 2 rates, of angle, spin; got 1"):
        Half().fit(swinging)


def test_a_channel_that_is_not_there_or_not_described_is_named(swinging: Dataset) -> None:
    class Other(Pendulum):
        controls = ("force",)

    with pytest.raises(IncompatibleSystem, match="needs the control 'force': the system has torque"):
        Other().fit(swinging)

    class Part(Pendulum):
        states = ("spin",)

    with pytest.raises(IncompatibleSystem, match="says nothing of angle"):
        Part().fit(swinging)


class Accelerated(Pendulum):
    """The pendulum again, of which only the acceleration is written."""

    speeds: ClassVar[Mapping[str, str]] = {"angle": "spin"}

    @staticmethod
    def acceleration(state, control, p):
        angle, spin = state
        (torque,) = control
        stiffness, friction, gain = p
        return (-stiffness * math.sin(angle) - friction * spin + gain * torque,)


def test_an_acceleration_is_a_shorter_way_to_write_the_same_law_in_both_forms(swinging: Dataset) -> None:
    whole, short = (family(starts=1, windows=30).fit(swinging, rng=0) for family in (Pendulum, Accelerated))
    np.testing.assert_allclose(short.parameters_, whole.parameters_, rtol=1e-4)
    states, control = np.array([[0.7, -1.5], [0.1, 2.0]]), np.array([[0.4], [-1.0]])
    short.parameters_ = whole.parameters_
    np.testing.assert_allclose(short.step(states, control), whole.step(states, control), rtol=1e-12)
    compiled = kernel_step(short.kernel(), states, control, precision="float64")
    np.testing.assert_allclose(compiled, short.step(states, control), rtol=1e-9)


def test_which_state_is_the_rate_of_which_is_told_where_it_is_wanted_alone(swinging: Dataset) -> None:
    class Silent(Accelerated):
        speeds: ClassVar[Mapping[str, str]] = {}

    with pytest.raises(InvalidArgument, match=r"expected 2 rates, of angle, spin; got 1\. .* tell so in speeds"):
        Silent().fit(swinging)

    class Both(Pendulum):
        speeds: ClassVar[Mapping[str, str]] = {"angle": "spin"}

    with pytest.raises(InvalidArgument, match="rate gives those of all states"):
        Both().fit(swinging)


def spring(**options: Any) -> Dataset:
    """Return a pendulum with a stop that the law does not know: beyond 0.8 rad it is pushed back."""

    def rate(x: Any, u: float) -> list[float]:
        stop = 30.0 * max(abs(x[0]) - 0.8, 0.0) * (1.0 if x[0] > 0.0 else -1.0)
        return [x[1], -9.0 * np.sin(x[0]) - 0.5 * x[1] + 4.0 * u - stop]

    return recorded(PENDULUM, rate, [0.5, 0.0], noise=(0.003, 0.01), **options)


def test_a_residual_learns_what_the_law_lacks_and_is_nothing_far_from_the_data() -> None:
    learned, fresh = spring(), spring(seed=1)
    physics = Pendulum(**QUICK).fit(learned, rng=0)
    model = Pendulum(residual=True, **QUICK).fit(learned, rng=0)
    np.testing.assert_array_equal(model.parameters_, physics.parameters_)
    assert -model.score(fresh) < -0.7 * physics.score(fresh)
    assert "100 % of the residual is kept" in model.fit_note
    far = np.array([[0.5, 400.0]])
    np.testing.assert_allclose(model.step(far, np.zeros((1, 1))), physics.step(far, np.zeros((1, 1))), rtol=1e-9)


def test_a_residual_of_a_law_that_lacks_nothing_is_not_kept(swinging: Dataset) -> None:
    model = Pendulum(residual=True, **QUICK).fit(swinging, rng=0)
    assert model.residual_share_ == 0.0


GAINS = (1.6, 1.8, 2.0, 2.2, 2.4, 2.0)


def several(gains: tuple[float, ...] = GAINS) -> Dataset:
    """Return recordings of pendulums that are the same but for the gain of their motors."""
    episodes = []
    for number, gain in enumerate(gains):

        def rate(x: Any, u: float, gain: float = gain) -> list[float]:
            return [x[1], -9.0 * np.sin(x[0]) - 0.5 * x[1] + gain * u]

        short = recorded(PENDULUM, rate, [1.0, 0.0], noise=(0.01, 0.03), seed=number, steps=200, episodes=1)
        episodes.append(replace(short.episodes[0], name=f"day-{number}"))
    return Dataset(PENDULUM, tuple(episodes))


def test_what_differs_from_recording_to_recording_is_told_and_the_common_value_predicts() -> None:
    model = Pendulum(offsets=["gain", "friction"], **QUICK).fit(several(), rng=0)
    assert found(model)["gain"] == pytest.approx(2.0, abs=0.06)
    rows = [row["offset"] for row in model.offsets_table() if row["parameter"] == "gain"]
    np.testing.assert_allclose(rows, np.array(GAINS) - 2.0, atol=0.08)
    spreads = dict(zip(("gain", "friction"), model.offset_spreads_, strict=True))
    assert spreads["gain"] == pytest.approx(np.std(GAINS), rel=0.3)
    assert spreads["friction"] < 0.05
    assert "there differ gain by 0.2" in model.fit_note
    assert all(row["unit"] for row in model.offsets_table())


def test_recordings_of_one_condition_share_their_offsets() -> None:
    data = several().labelled({"cold": "day-[012]", "warm": "day-[345]"})
    model = Pendulum(offsets=["gain"], starts=1, windows=60).fit(data, rng=0)
    assert [row["recording"] for row in model.offsets_table()] == ["cold", "warm"]


def test_where_nothing_differs_offsets_shrink_to_nothing() -> None:
    model = Pendulum(offsets=["gain"], **QUICK).fit(several((2.0,) * 6), rng=0)
    assert np.abs(model.offsets_).max() < 0.03


def test_an_offset_of_what_is_no_parameter_is_refused() -> None:
    with pytest.raises(InvalidArgument, match="there is no parameter 'grip'; there are stiffness, friction, gain"):
        Pendulum(offsets=["grip"])


def test_the_card_of_a_stored_grey_box_prints_its_parameters(swinging: Dataset, tmp_path: Path) -> None:
    model = HeavyPendulum(starts=1, windows=30).fit(swinging, rng=0)
    card = model_card(save_model(model, tmp_path / "model"))
    assert "do not determine unused" in card["note"]
    console = Console(width=100, record=True, file=io.StringIO())
    for part in card_table(card):
        console.print(part)
    printed = console.export_text()
    assert re.search(r"stiffness +[89]\S* +0\.\d+ +1/s\^2", printed)
    assert re.search(r"unused .* m +not determined", printed)
