"""Every registered family keeps the contract, on a car with switches, a proportional car, and no car at all."""

import ast
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import model_zoo
from sysid_evo import make_task
from sysid_evo.errors import IncompatibleSystem
from sysid_evo.extras import extra_of
from sysid_evo.models.base import make_model
from sysid_evo.motion import PlanarBody
from sysid_evo.predictive_control import ImaginedTrials
from sysid_evo.randomness import trial_seeds
from sysid_evo.registry import models
from sysid_evo.system import Channel, System
from sysid_evo.testing import MODEL, example_dataset
from sysid_evo.testing.models import rows_are_independent
from sysid_evo.validation.simulation_error import error_windows
from tests.fixtures.families import SMALL, hurry, small
from tests.fixtures.systems import SMALL_SYSTEMS

ONE_OF_A_KIND = ("average", "linear_state_space", "mlp_ensemble", "narx", "nearest_neighbour")
"""One family of each structure that may describe any system; the others see a second system with --nightly."""
SLOW = ("adapted", "latent_ode", "nonlinear_state_space", "single_track", "torch_ode")
"""Families whose fits take a second even so: the contract sees them with one episode."""
CARS = ("hybrid_ode", "parametrised", "single_track")


@pytest.fixture(scope="module", autouse=True)
def few_evaluations():
    with pytest.MonkeyPatch.context() as patch:
        hurry(patch)
        yield


def at_night(names, often=()):
    """Return all families, ``names`` of them with --nightly alone unless they are among ``often``."""
    return [pytest.param(n, marks=pytest.mark.nightly) if n in names and n not in often else n for n in models.names()]


def quick(name):
    return dict(models.get(name).presets.get("quick", {}))


def broken(results):
    return [f"{check.rule}: {check.failure}" for check in results if check.failure]


@cache
def learned(family):
    """Return the family after two episodes of the car, with a search for all that it can search, and what it told."""
    options, told = quick(family), []
    searched = {key: None for key in ("state_lags", "control_lags", "degree", "terms", "neighbours") if key in options}
    model = make_model(family, **{**options, **SMALL.get(family, {}), **searched})
    train, _ = example_dataset().split(["episode-2"])
    model.fit(train, rng=np.random.default_rng(1), progress=lambda done, total: told.append(done))
    return model, told


@pytest.mark.parametrize("recording", ["car_data", pytest.param("throttle_car_data", marks=pytest.mark.nightly)])
@pytest.mark.parametrize("family", at_night(("adapted",)))  # by day tests/contract/model_zoo/test_adapted.py
def test_every_family_keeps_every_rule_of_the_contract_on_a_car(family, recording, request):
    dataset = request.getfixturevalue(recording)
    dataset = dataset[[0]] if family in SLOW else dataset[[0, 1]]
    results = list(MODEL.run(family, dataset, **SMALL.get(family, {})))
    assert not broken(results)
    assert len(results) == 1 + len(MODEL.checks)


@pytest.mark.parametrize("family", at_night(models.names(), often=(*CARS, *ONE_OF_A_KIND)))
def test_every_family_keeps_the_contract_on_what_is_no_car_or_refuses_it(family, oscillator_data):
    """Only a family that assumes physics may refuse, and it does so before it learns anything."""
    model = make_model(family)
    try:
        model.check_system(oscillator_data.system)
    except IncompatibleSystem:
        assert model.knowledge in ("grey", "white")
        with pytest.raises(IncompatibleSystem):
            model.fit(oscillator_data, rng=np.random.default_rng(0))
        with pytest.raises(IncompatibleSystem):
            list(MODEL.run(family, oscillator_data))
        assert not hasattr(model, "system_")
    else:
        assert not broken(MODEL.run(family, oscillator_data, **SMALL.get(family, {})))


@pytest.mark.parametrize("case", SMALL_SYSTEMS)
@pytest.mark.parametrize("family", at_night(models.names(), often=(*CARS, *ONE_OF_A_KIND)))
def test_a_family_works_on_a_small_system_or_says_why_not(family, case):
    """Without controls, with one state, under a control that never changes: it runs free to finite states."""
    dataset = SMALL_SYSTEMS[case].recording()
    model = small(family)
    if family in CARS:
        with pytest.raises(IncompatibleSystem, match="describes a planar body, but the system has no motion"):
            model.fit(dataset, rng=np.random.default_rng(0))
        return
    model.fit(dataset, rng=np.random.default_rng(0))
    windows = dataset.windows(10, stride=10, history=model.n_lags)
    assert np.isfinite(model.simulate(windows.past_states, windows.past_controls, windows.controls)).all()
    rows_are_independent(model, dataset)


@pytest.mark.parametrize("family", CARS)
def test_a_car_without_controls_is_refused_in_a_sentence(family):
    channels = (Channel("forward_speed"), Channel("lateral_speed"), Channel("yaw_rate"))
    with pytest.raises(IncompatibleSystem, match="expected 'drive', got no controls; name yours with drive="):
        make_model(family).check_system(System(channels, (), 0.05, PlanarBody()))


@pytest.mark.parametrize(
    ("family", "options"),
    [
        ("backprop27", {"state_lags": 1, "control_lags": 2, "epochs": 5}),
        ("evolved3", {"state_lags": 1, "control_lags": 2, "generations": 3}),
        ("linear", {"state_lags": 2, "control_lags": 1}),
        ("nearest_neighbour", {"state_lags": 1, "control_lags": 2}),
        ("parametrised", {"control_lags": 2, "generations": 3}),
    ],
)
def test_lags_asked_for_keep_the_contract(family, options, throttle_car_data):
    assert not broken(MODEL.run(family, throttle_car_data, **options))
    assert make_model(family, **options).lags == (options.get("state_lags", 0), options["control_lags"])


@pytest.mark.parametrize("family", models.names())
def test_every_family_says_how_much_it_knows_and_predicts_better_than_nothing(family, car_data):
    """Half a second ahead, a fitted model is nearer to the recording than its last measured state."""
    assert models.get(family).knowledge in ("black", "dark grey", "grey", "white")
    model, _ = learned(family)
    windows = car_data.split(["episode-2"])[1].windows(10, stride=5, history=model.n_lags)
    simulated = model.simulate(windows.past_states, windows.past_controls, windows.controls)
    forward = simulated[:, -1, 0] - windows.states[:, -1, 0]
    persistence = windows.start_states[:, 0] - windows.states[:, -1, 0]
    assert np.sqrt(np.mean(forward**2)) < np.sqrt(np.mean(persistence**2))


@pytest.mark.parametrize("given", [0, 1])
@pytest.mark.parametrize("family", models.names())
def test_a_short_history_is_padded_in_a_batch_as_in_a_single_run(family, given, car_data):
    """Its first state is repeated and the earlier controls are neutral, also where the compiled form starts from it."""
    model, _ = learned(family)
    windows = car_data.windows(10, stride=40, history=given)
    history, past, ahead = windows.past_states, windows.past_controls, windows.controls
    batch = model.simulate(history, past, ahead)
    missing = max(0, model.n_lags - given)
    rest = np.broadcast_to(model.system.neutral_control, (len(history), missing, model.system.nu))
    padded = np.concatenate([np.repeat(history[:, :1], missing, axis=1), history], axis=1)
    np.testing.assert_array_equal(batch, model.simulate(padded, np.concatenate([rest, past], axis=1), ahead))
    for row in range(0, len(history), 3):
        single = model.simulate(history[row], past[row], ahead[row])
        np.testing.assert_allclose(batch[row], single, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("family", ["narx", "mlp_ensemble", "linear_state_space", "sindy"])
def test_the_compiled_form_pads_a_short_history_too(family, car_data):
    model, _ = learned(family)
    task = make_task("point_to_point", horizon=20).bind(model.system)
    known, sequences = (
        task.hide_future(task.begin(trial_seeds(3, 4))),
        np.random.default_rng(1).uniform(-1.0, 1.0, (6, 4, 10, model.system.nu)),
    )
    assert model.n_lags > 0
    history = np.repeat(known.state[:, None], model.n_lags + 1, axis=1)
    past = np.broadcast_to(model.system.neutral_control, (4, model.n_lags, model.system.nu))
    for engine in ("reference", "float64"):
        trials = ImaginedTrials(model, task, engine=engine)
        short = trials.scores(known.state[:, None], np.zeros((4, 0, model.system.nu)), sequences, known)
        np.testing.assert_array_equal(short, trials.scores(history, past, sequences, known))


TELL = [name for name in models.names() if name in ("k_neighbours", "narx") or not models.glance(name, "fast_fit")]
"""Families whose fits take long, if only of long recordings."""


@pytest.mark.parametrize("family", TELL)
def test_a_fit_that_takes_long_tells_often_how_far_it_is(family):
    """Every family reports at least ten times, also with a small budget."""
    _, told = learned(family)
    assert len(told) >= 10
    assert told == sorted(told)


@pytest.mark.parametrize("family", ["backprop27", "evolved3", "nearest_neighbour", "parametrised"])
def test_a_family_of_the_paper_beats_persistence_at_one_second(family):
    train, held = example_dataset(episodes=4, steps=500).split(["episode-2"])
    model = make_model(family, **{**quick(family), **SMALL.get(family, {})}).fit(train, rng=np.random.default_rng(3))
    windows = error_windows(held, 0)
    truth = windows.states[:, -1]
    simulated = model.simulate(windows.past_states, windows.past_controls, windows.controls)[:, -1]
    ours, persistence = (
        np.mean(np.sqrt(np.mean((guess - truth) ** 2, axis=0)) / truth.std(axis=0))
        for guess in (simulated, windows.start_states)
    )
    assert ours < persistence


def test_only_families_that_take_little_time_for_a_million_steps_learn_from_all_of_them():
    """`linear` 3 s, `nearest_neighbour` 2 s, `parametrised` 16 s and `evolved3` 40 s."""
    everything = {name for name in models.names() if make_model(name).get_params().get("max_steps") is None}
    assert everything == {"linear", "nearest_neighbour", "parametrised", "evolved3", "adapted"}


def test_every_optional_package_that_a_family_imports_is_among_those_it_requires():
    """So that one that is missing is named before anything is learned, whichever of several it is."""
    root, imported = Path(model_zoo.__file__).parent, {}
    for file in root.rglob("*.py"):
        names = imported[".".join(file.relative_to(root.parent).with_suffix("").parts)] = set()
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.ImportFrom):
                names |= {str(node.module), *(f"{node.module}.{alias.name}" for alias in node.names)}
            elif isinstance(node, ast.Import):
                names |= {alias.name for alias in node.names}
    for family in models.names():
        kind = models.get(family)
        ahead, reached, named = {kind.__module__}, set(), set()
        while ahead:
            reached.add(module := ahead.pop())
            named |= imported.get(module, set())
            ahead |= (named & imported.keys()) - reached
        tops = {name.partition(".")[0] for name in named}
        assert {top for top in tops if extra_of(top) is not None} <= set(kind.requires), family
