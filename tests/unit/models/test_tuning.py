"""The search for parameters: where it looks, that it finds, that it goes on, and that it is the same again."""

from typing import ClassVar, Literal

import numpy as np
import pytest

from sysid_evo.data import Dataset
from sysid_evo.errors import InvalidArgument
from sysid_evo.models import DynamicsModel
from sysid_evo.models.base import make_model
from sysid_evo.models.parameters import OneOf, Within, at_least
from sysid_evo.registry import models
from sysid_evo.system import Channel, System
from sysid_evo.tuning import Tuning, search_space, tune


def decaying(truth=2.0):
    """Return three runs of one state that decays by ``truth`` a second."""
    system = System((Channel("level"),), (Channel("push", low=-1.0, high=1.0),), 0.05)
    rng = np.random.default_rng(0)
    states, controls = [], []
    for _ in range(3):
        push = np.repeat(rng.uniform(-1.0, 1.0, 20), 5)
        level = [1.0]
        for u in push:
            level.append(level[-1] + 0.05 * (u - truth * level[-1]))
        states.append(np.array(level)[:, None])
        controls.append(push[:, None])
    return Dataset.from_arrays(system, states, controls)


@pytest.fixture
def guess(register):
    """A family outside the zoo that learns nothing: the decay is a parameter, and one of its kinds always fails."""

    class Guess(DynamicsModel):
        """The state decays as the parameter says."""

        limits: ClassVar = {"decay": at_least(0, at_most=4)}
        search_ranges: ClassVar = {"decay": Within(0.0, 4.0)}
        presets: ClassVar = {"quick": {"rounds": 2}}

        decay: float = 0.5
        rounds: int = 10
        kind: Literal["plain", "broken"] = "plain"
        label: str = "x"
        shift: float = 0.0
        dead_band: bool = False

        def fit(self, dataset, *, rng, progress=None):
            if self.kind == "broken":
                raise ValueError("this kind cannot learn")
            return self

        def acceleration(self, carry, control):
            return control - self.decay * carry + self.shift

    return register(models, "made_up_guess", Guess)


def test_the_space_follows_from_what_a_family_declares_and_from_types_limits_and_defaults(guess):
    space = search_space("made_up_guess")
    assert space == {
        "decay": Within(0.0, 4.0),
        "kind": OneOf(("plain", "broken")),
        "shift": Within(1e-6, 1.0, log=True),
    }, "neither text, nor what a preset changes, nor what has nothing to do with predicting"
    assert search_space("made_up_guess", parameters=["rounds"]) == {"rounds": Within(1.25, 80.0, log=True)}
    assert set(search_space("made_up_guess", fixed=["kind"])) == {"decay", "shift"}
    with pytest.raises(InvalidArgument, match="no parameter to search among label"):
        search_space("made_up_guess", parameters=["label"])


@pytest.mark.parametrize("family", ["mlp_ensemble", "neural_ode", "hybrid_ode"])
def test_input_noise_is_searched_in_every_family_of_networks_that_has_it(family):
    assert search_space(family)["input_noise"] == Within(0.02, 4.0, log=True)


NOTHING_TO_SEARCH = {"adapted", "average"}
"""What stands around another family, without parameters of that kind."""


@pytest.mark.parametrize("family", sorted({*models.names()} - NOTHING_TO_SEARCH))
def test_what_is_searched_in_a_family_of_the_zoo_can_be_set(family):
    for key, where in search_space(family).items():
        values = where.values if isinstance(where, OneOf) else [where.low, where.high]
        for value in values:
            whole = isinstance(where, Within) and isinstance(models.parameters(family)[key], int)
            lags = key.endswith("_lags") or key in ("degree", "terms", "neighbours")
            make_model(family, **{key: round(value) if whole or lags else value})


def test_the_best_is_near_the_truth_and_never_worse_than_the_defaults(guess):
    found = tune("made_up_guess(kind=plain, shift=0.0)", decaying(), trials=16, seed=1)
    assert found.best.spec.parameters["kind"] == "plain"
    assert abs(found.best.spec.parameters["decay"] - 2.0) < 0.2
    default = next(one for one in found.trials if one.spec.parameters["decay"] == 0.5)
    assert default.error is not None
    assert found.best.error is not None
    assert found.best.error < default.error
    assert make_model(found.best.spec.text).get_params()["decay"] == found.best.spec.parameters["decay"]


def test_a_trial_that_fails_is_reported_with_its_reason_and_the_others_continue(guess):
    found = tune("made_up_guess(shift=0.0)", decaying(), trials=12, seed=0)
    failed = [one for one in found.trials if one.reason.startswith("ValueError")]
    assert failed
    assert str(failed[0].reason).startswith("ValueError: this kind cannot learn (")
    assert found.best.spec.parameters["kind"] == "plain"
    assert set(found.importance) <= {"decay", "kind"}


def test_a_search_goes_on_in_its_file_and_the_same_seed_gives_the_same_trials(guess, tmp_path):
    settings = {"parameters": ["decay"], "seed": 3}
    first = tune("made_up_guess", decaying(), trials=4, file=tmp_path / "a", **settings)
    again = tune("made_up_guess", decaying(), trials=4, file=tmp_path / "b", **settings)
    begun = {one.spec for one in first.trials}
    assert begun == {one.spec for one in again.trials}
    further = tune("made_up_guess", decaying(), trials=7, file=tmp_path / "a", **settings)
    assert len(further.trials) == 7
    assert begun < {one.spec for one in further.trials}
    other_data = Tuning("made_up_guess", decaying(1.0), file=tmp_path / "a", **settings)
    assert not other_data.trials


def test_what_stops_a_search_keeps_the_trials_that_had_ended(guess, tmp_path):
    search = Tuning("made_up_guess", decaying(), parameters=["decay"], file=tmp_path / "a")

    def stopping(done, total, note=""):
        if note.startswith("4 trials"):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        list(search.run(trials=50, progress=stopping))
    assert len(Tuning("made_up_guess", decaying(), parameters=["decay"], file=tmp_path / "a").trials) == 4


def test_a_horizon_that_does_not_fit_is_refused(guess):
    with pytest.raises(InvalidArgument, match="at most 50, got 50, 300"):
        Tuning("made_up_guess", decaying(), horizons=[50, 300])
