"""Every registered family keeps the contract, on a car with switches, a proportional car, and no car at all."""

from __future__ import annotations

import ast
from typing import Any

import numpy as np
import pytest

from sysid_evo.data import Dataset
from sysid_evo.errors import IncompatibleSystem
from sysid_evo.extras import extra_of
from sysid_evo.models.base import make_model
from sysid_evo.registry import models
from sysid_evo.testing import CHECKS, run_checks
from tests.layout import imports, trees

SMALL_NETWORK: dict[str, Any] = {"hidden": [12], "one_step_updates": 60, "updates": 30, "horizon": 5}
SMALL: dict[str, dict[str, Any]] = {
    "mlp_ensemble": {**SMALL_NETWORK, "members": 2, "control_lags": 2},
    "neural_ode": SMALL_NETWORK,
    "neural_ode_history": SMALL_NETWORK,
    "hybrid_ode": SMALL_NETWORK,
    "torch_ode": {"hidden": [8], "updates": 20, "horizon": 3, "control_lags": 1},
    "linear_state_space": {"order": 3, "iterations": 5, "folds": 1, "horizon": 100},
    "nonlinear_state_space": {"members": 2, "order": 3, "trial": 3, "iterations": 3, "hidden": 4, "horizon": 100},
    "latent_ode": {"members": 2, "order": 3, "trial": 3, "iterations": 3, "hidden": 4, "horizon": 100},
    "gaussian_process": {"inducing": 40},
    "evolved3": {"generations": 30},
    "parametrised": {"generations": 60},
    "backprop27": {"epochs": 100},
    "auto": {
        "candidates": [f"linear(state_lags=1, control_lags=2, ridge={ridge})" for ridge in (0.0, 1.0)],
        "gate": 9.0,
    },
    "single_track": {"starts": 1, "windows": 40},
}
"""The contract does not ask for accuracy."""
TRAINED = ("hybrid_ode", "mlp_ensemble", "neural_ode", "neural_ode_history", "torch_ode")
"""Families whose every fit takes seconds; on a second system they are tried with --nightly."""
SLOWEST = ("adapted", "hybrid_ode", "torch_ode")
"""Those that are tried on a car with --nightly alone."""
OFTEN = [pytest.param(name, marks=pytest.mark.nightly) if name in TRAINED else name for name in models.names()]
SLOW_TO_LEARN = [name for name in (*TRAINED, "auto", "latent_ode") if name != "neural_ode"]
"""Families that learn as `neural_ode` and `nonlinear_state_space` do; how well they do is asked with --nightly."""
ONE_OF_A_KIND = [
    pytest.param(name, marks=pytest.mark.nightly) if name in SLOW_TO_LEARN else name for name in models.names()
]


@pytest.mark.parametrize("recording", ["switched", pytest.param("proportional", marks=pytest.mark.nightly)])
@pytest.mark.parametrize(
    "family",
    [pytest.param(name, marks=pytest.mark.nightly) if name in SLOWEST else name for name in models.names()],
)
def test_every_family_keeps_every_sentence_of_the_contract_on_a_car(
    family: str, recording: str, request: pytest.FixtureRequest
) -> None:
    """Where a family can hold a body at rest, it does so on the car with switches."""
    dataset = request.getfixturevalue(recording)
    can_hold = recording == "switched" and "rest_hold" in make_model(family).get_params()
    options = {**SMALL.get(family, {}), **({"rest_hold": True} if can_hold else {})}
    results = list(run_checks(family, dataset, **options))
    assert not [f"{check.sentence}: {check.failure}" for check in results if check.failure]
    assert len(results) == 2 + len(CHECKS)


def test_only_families_that_take_little_time_for_a_million_steps_learn_from_all_of_them() -> None:
    """`linear` 3 s, `nearest_neighbour` 2 s, `parametrised` 16 s and `evolved3` 40 s."""
    everything = {name for name in models.names() if "most_steps" not in make_model(name).get_params()}
    assert everything == {"linear", "nearest_neighbour", "parametrised", "evolved3", "adapted"}


@pytest.mark.parametrize("family", models.names())
def test_every_optional_package_that_a_family_imports_is_among_those_it_requires(family: str) -> None:
    """So that one that is missing is named before anything is learned, whichever of several it is."""
    kind = models.get(family)
    reached, ahead = set[str](), [kind.__module__]
    while ahead:
        module = ahead.pop()
        reached.add(module)
        ahead += [name for name, _ in imports(module) if name.startswith("model_zoo.") and name not in reached]
    nodes = [node for module in reached if module in trees() for node in ast.walk(trees()[module])]
    named = {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
    named |= {str(node.module) for node in nodes if isinstance(node, ast.ImportFrom)}
    tops = {name.partition(".")[0] for name in named}
    assert {top for top in tops if extra_of(top) is not None} <= set(kind.requires)


@pytest.mark.parametrize("family", models.names())
def test_every_family_can_hold_a_body_at_rest(family: str) -> None:
    assert "rest_hold" in make_model(family).get_params()


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
def test_lags_asked_for_keep_the_contract(family: str, options: dict[str, int], proportional: Dataset) -> None:
    broken = [check for check in run_checks(family, proportional, rest_hold=True, **options) if check.failure]
    assert not broken
    lags = make_model(family, **options).lags
    assert lags == (options.get("state_lags", 0), options["control_lags"])


@pytest.mark.parametrize("family", OFTEN)
def test_every_family_keeps_the_contract_on_what_is_no_car_or_refuses_it(family: str, oscillator: Dataset) -> None:
    """Only a family that assumes physics may refuse, and it does so before it learns anything."""
    model = make_model(family)
    try:
        model.check_system(oscillator.system)
    except IncompatibleSystem:
        assert model.knowledge in ("grey", "white")
        with pytest.raises(IncompatibleSystem):
            model.fit(oscillator, rng=np.random.default_rng(0))
        with pytest.raises(IncompatibleSystem):
            list(run_checks(family, oscillator))
        assert not hasattr(model, "system_")
    else:
        results = run_checks(family, oscillator, **SMALL.get(family, {}))
        broken = [f"{check.sentence}: {check.failure}" for check in results if check.failure]
        assert not broken


@pytest.mark.parametrize("family", ONE_OF_A_KIND)
def test_every_family_says_how_much_it_knows_and_predicts_better_than_nothing(family: str, switched: Dataset) -> None:
    """Half a second ahead, a fitted model is nearer to the recording than its last measured state."""
    assert models.get(family).knowledge in ("black", "dark grey", "grey", "white")
    train, test = switched.split(["episode-2"])
    quick = dict(models.get(family).presets.get("quick", {}))
    model = make_model(family, **quick).fit(train, rng=np.random.default_rng(1))
    windows = test.windows(10, stride=5, history=model.n_lags)
    simulated = model.simulate(windows.past_states, windows.past_controls, windows.controls)
    forward = simulated[:, -1, 0] - windows.states[:, -1, 0]
    persistence = windows.start_states[:, 0] - windows.states[:, -1, 0]
    assert np.sqrt(np.mean(forward**2)) < np.sqrt(np.mean(persistence**2))
