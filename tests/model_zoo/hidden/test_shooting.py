"""The training of state spaces: derivatives, what is minimised, what is found unstable."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from model_zoo.state_space import estimation
from model_zoo.state_space.estimation import Lesson, observer, radius, stabilised
from model_zoo.state_space.nonlinear_state_space import networks
from model_zoo.state_space.recordings import ScaledEpisode, Segments
from model_zoo.state_space.shooting import FAR, Spaces, train
from model_zoo.state_space.subspace import flowing
from model_zoo.state_space.units import GATE, SHARP, SHARP_INPUT, UNITS
from sysid_evo.data import Dataset
from sysid_evo.engine.compiled.open_loop import kernel_step
from sysid_evo.models.base import make_model
from sysid_evo.types import Array
from tests.fixtures.systems import OSCILLATOR, OUTPUT_ONLY, one_output


def spaces(*, flow: bool = False) -> Spaces:
    rng, kinds = np.random.default_rng(0), [[kind, UNITS.index("gate"), UNITS.index("smooth")] for kind in range(4)]
    outer, inner = 0.3 * rng.standard_normal((4, 2, 7)), rng.standard_normal((4, 3, 4))
    return Spaces(outer, inner, np.array([0.3, 0.2]), np.array(kinds), flow)


FORMS = pytest.mark.parametrize("flow", [False, True], ids=["step by step", "differential equation"])


def linear_growth(rate: float) -> Spaces:
    """Return a space of one state that grows by ``rate`` a step."""
    return Spaces.linear(np.array([[[rate, 0.1, 0.0]]]), np.ones(1))


@FORMS
def test_derivatives_are_those_of_finite_differences(flow: bool) -> None:
    """By every parameter and every initial state, of each kind of unit."""
    many, rng = spaces(flow=flow), np.random.default_rng(1)
    segments = Segments(np.zeros((2, 7, 1)), rng.standard_normal((2, 6, 1)), np.ones((2, 7)))
    starts = rng.standard_normal((2, 2))
    flat, step = many.flat, 1e-6
    for s in range(len(many)):
        outputs, derivatives = many.sensitivities(s, starts, segments)

        def run(flat: Array, starts: Array, s: int = s) -> Array:
            return many.with_flat(flat).run(starts[None].repeat(4, axis=0), segments.controls)[s, ..., :1]

        np.testing.assert_allclose(outputs, run(flat, starts))
        for place in range(flat.shape[1]):
            found = (run(flat + step * np.eye(flat.shape[1])[place], starts) - outputs) / step
            np.testing.assert_allclose(derivatives[..., place], found, rtol=1e-4, atol=1e-4)
        for state in range(2):
            found = (run(flat, starts + step * np.eye(2)[state]) - outputs) / step
            np.testing.assert_allclose(derivatives[..., flat.shape[1] + state], found, atol=1e-4)


def test_a_free_run_is_bounded_and_what_its_derivatives_are_taken_of_is_not() -> None:
    """A bound has no slope, and training would stop at it."""
    growing, segments = linear_growth(0.5), Segments(np.zeros((1, 7, 1)), np.zeros((1, 6, 1)), np.ones((1, 7)))
    outputs, derivatives = growing.sensitivities(0, np.array([[10.0]]), segments)
    np.testing.assert_allclose(outputs[0, :, 0], 10.0 * 1.5 ** np.arange(7))
    np.testing.assert_allclose(derivatives[0, :, 0, -1], 1.5 ** np.arange(7))
    assert growing.run(np.array([[[10.0]]]), segments.controls).max() == FAR


@FORMS
def test_compiled_free_runs_are_chained_steps_and_the_slope_is_their_difference(flow: bool) -> None:
    many, rng = spaces(flow=flow), np.random.default_rng(1)
    starts, controls = rng.standard_normal((4, 3, 2)), rng.standard_normal((3, 5, 1))
    states, chained = starts, [starts]
    for k in range(5):
        states = many.step(states, controls[:, k])
        chained.append(states)
    np.testing.assert_allclose(many.run(starts, controls), np.stack(chained, axis=2), rtol=1e-9)
    for state in range(2):
        moved = many.step(starts + 1e-6 * np.eye(2)[state], controls[:, 0]) - many.step(starts, controls[:, 0])
        np.testing.assert_allclose(many.jacobian(starts, controls[:, 0])[..., state], moved / 1e-6, atol=1e-4)


def test_training_finds_the_space_that_made_the_data() -> None:
    rng, outer = np.random.default_rng(2), np.array([[[-0.5, 1.0, 0.3, 0.1], [-1.0, -0.5, 0.5, 0.0]]])
    true = Spaces.linear(outer, np.array([0.3, 0.2]))
    controls = rng.standard_normal((1, 200, 1))
    outputs = true.run(np.zeros((1, 1, 2)), controls)[0, :, :, :1]
    segments = Segments.of([ScaledEpisode(outputs[0], controls[0])], 50)
    off = true.with_flat(true.flat + 0.05 * rng.standard_normal(true.flat.shape))
    starts = np.zeros((1, len(segments), 2))
    starts[..., 0] = segments.outputs[:, 0, 0]
    trained = train(off, segments, starts, 40)
    assert trained.error[0] < 1e-8


def test_a_differential_equation_steps_as_the_linear_space_it_was_made_of() -> None:
    """To the error of the Runge-Kutta method, which is small for what changes little in a sample."""
    rates = np.array([[-0.02, 0.1, 0.05, 0.01], [-0.1, -0.05, 0.02, 0.0]])
    steps, flows = Spaces.linear(rates[None], np.ones(2)), Spaces.linear(flowing(rates)[None], np.ones(2), flow=True)
    rng = np.random.default_rng(0)
    starts, controls = rng.standard_normal((1, 2, 2)), rng.standard_normal((2, 50, 1))
    np.testing.assert_allclose(flows.run(starts, controls), steps.run(starts, controls), atol=1e-6)
    assert radius(flows) == pytest.approx(radius(steps), rel=1e-6)


def test_a_mode_that_no_differential_equation_has_becomes_one_that_decays_fast() -> None:
    flipping = Spaces.linear(flowing(np.array([[-1.8, 0.1, 0.0]]))[None], np.ones(1), flow=True)
    assert radius(flipping) < 0.6
    fixed = flipping.run(np.zeros((1, 1, 1)), np.ones((1, 60, 1)))[0, 0, -1, 0]
    assert fixed == pytest.approx(0.1 / 1.8)


def test_a_differential_equation_that_grows_is_brought_back() -> None:
    growing = Spaces.linear(np.array([[[0.2, 1.0, 0.0, 0.0], [-1.0, 0.2, 0.1, 0.0]]]), np.ones(2), flow=True)
    assert radius(growing) > 1.15
    assert radius(stabilised(growing)) == pytest.approx(0.999, abs=0.01)


def test_a_unit_of_the_controls_never_sees_states_and_none_is_no_unit() -> None:
    lesson = Lesson.of(one_output(0, bend=0.03), 100)
    linear = lesson.linear_trained(2, 3, 3, lambda: None)
    begun = networks(linear.spaces, [(SHARP_INPUT, GATE, None)], 3, np.random.default_rng(0))
    trained = lesson.learned(begun, lesson.blank(lesson.short, begun), 3, lambda: None).spaces
    assert np.abs(trained.outer[0, :, 4:6]).min() > 0.0
    assert (trained.inner[0, 0] == 0.0).tolist() == [True, True, False, False]
    assert (trained.inner[0, 1] != begun.inner[0, 1]).all()
    assert not trained.inner[0, 2].any()
    assert not trained.outer[0, :, 6].any()


def test_the_first_guess_of_the_states_does_not_depend_on_how_often_the_data_are_there() -> None:
    rng = np.random.default_rng(0)
    space = Spaces.linear(np.array([[[0.9, 0.1, 0.1, 0.0], [0.0, 0.8, 0.2, 0.0]]]), np.ones(2))
    parts = [ScaledEpisode(rng.standard_normal((61, 1)), rng.standard_normal((60, 1)))]
    runs = rng.standard_normal((20, 2))
    once, twice = (observer(space, np.tile(runs, (n, 1)), np.tile(runs[:, :1], (n, 1)), parts).first for n in (1, 2))
    np.testing.assert_allclose(once, twice, rtol=1e-11)


def test_a_sample_counts_once_whatever_the_segments() -> None:
    parts = [
        ScaledEpisode(np.arange(11.0)[:, None], np.zeros((10, 1))),
        ScaledEpisode(np.arange(20.0, 25.0)[:, None], np.ones((4, 1))),
    ]
    segments = Segments.of(parts, 4)
    assert segments.rows(segments.outputs)[:, 0].tolist() == [*range(11), *range(20, 25)]
    assert segments.rows(segments.outputs)[segments.begins, 0].tolist() == segments.outputs[:, 0, 0].tolist()


def test_an_unstable_space_is_found_and_brought_back() -> None:
    assert radius(linear_growth(0.1)) == pytest.approx(1.1)
    assert radius(stabilised(linear_growth(0.1))) == pytest.approx(0.999)
    calm = linear_growth(-0.2)
    assert stabilised(calm) is calm


def test_a_space_that_goes_astray_under_other_controls_is_told_from_one_that_does_not() -> None:
    lesson = Lesson.of(one_output(0), 100)
    trained = lesson.linear_trained(2, 3, 3, lambda: None)
    growing = trained.spaces.outer.copy()
    growing[0, 0, 0] += 0.5 / trained.spaces.pace[0]
    both = Spaces.linear(np.concatenate([trained.spaces.outer, growing]), trained.spaces.pace)
    assert lesson.escapes(both, lesson.observers(trained) * 2).tolist() == [False, True]


def quiet_recording() -> Dataset:
    """Return the same oscillator under controls that are mostly far from their ends."""
    rng, state, outputs = np.random.default_rng(4), np.zeros(2), [0.0]
    controls = np.repeat(np.clip(0.3 * rng.standard_normal(80), -1.0, 1.0), 5)
    for u in controls:
        state = OSCILLATOR @ state + np.array([0.0, 0.15 * u])
        outputs.append(state[0])
    return Dataset.from_arrays(OUTPUT_ONLY, np.array(outputs), controls)


@pytest.mark.parametrize(
    ("data", "name", "place"),
    [(one_output(0), "SLOWER", 3.1), (quiet_recording(), "LOUDER", 2.8)],
    ids=["longer", "larger"],
)
def test_a_space_that_runs_away_beyond_what_was_recorded_is_astray_though_nothing_shows_within(
    data: Dataset, name: str, place: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One of three equal spaces grows from a ``place`` on that no output reaches under the controls as recorded.

    Of a sharp unit, |s| / 2, and of s / 2 beside it a ramp is made.
    """
    lesson, steep = Lesson.of(data, 100), 4.0
    trained = lesson.linear_trained(2, 3, 3, lambda: None)
    observers = lesson.observers(trained) * 3
    three = networks(trained.spaces, [(SHARP,)] * 3, 1, np.random.default_rng(0))
    three.inner[2, 0] = [1.0, 0.0, 0.0, -place]
    three.outer[2, 0] += [steep / 2, 0.0, 0.0, -steep * place / 2, steep]
    told = getattr(estimation, name)
    for other, none in (("SLOWER", 1), ("LOUDER", 1), ("SHUFFLES", 0)):
        monkeypatch.setattr(estimation, other, none)
    assert not lesson.escapes(three, observers).any()
    monkeypatch.setattr(estimation, name, told)
    assert lesson.escapes(three, observers).tolist() == [False, False, True]
    assert not lesson.escapes(three[[0, 2]], observers[:2]).any()


@pytest.mark.parametrize("family", ["nonlinear_state_space", "latent_ode"])
def test_every_kind_of_unit_is_the_same_compiled(family: str) -> None:
    model = make_model(family, order=2, members=1, trial=2, iterations=2, horizon=50)
    model.fit(one_output(0), rng=0)
    model.inner_ = [4.0 * inner for inner in model.inner_]
    model.outer_ = [outer + 0.1 for outer in model.outer_]
    windows = one_output(1).windows(1, stride=20, history=model.n_lags)
    carry, control = model.start(windows.past_states, windows.past_controls), windows.controls[:, 0]
    for kind in range(len(UNITS)):
        model.kinds_ = [np.resize([UNITS.index("sharp"), kind], len(model.kinds_[0]))]
        compiled = kernel_step(model.kernel(), carry, control, precision="float64")
        np.testing.assert_allclose(compiled, model.step(carry, control), rtol=1e-7, atol=1e-7)


def test_a_space_that_says_what_no_other_says_is_astray() -> None:
    lesson = Lesson.of(one_output(0), 100)
    trained = lesson.linear_trained(2, 3, 3, lambda: None)
    outer = trained.spaces.outer.repeat(3, axis=0)
    outer[2, :, 2] *= 1.3
    three = Spaces.linear(outer, trained.spaces.pace)
    assert lesson.escapes(three, lesson.observers(trained) * 3).tolist() == [False, False, True]


def test_a_space_that_runs_away_is_trained_without_a_warning() -> None:
    steps = 700
    segments = Segments(np.zeros((1, steps + 1, 1)), np.zeros((1, steps, 1)), np.ones((1, steps + 1)))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        train(linear_growth(1.0), segments, np.ones((1, 1, 1)), 2)
