"""A fit by gradients that was stopped goes on to the same model."""

import numpy as np
import pytest

from model_zoo.networks.training import TrainingState
from sysid_evo.artefacts import CheckpointFile, read_checkpoint
from sysid_evo.errors import CheckpointWarning
from sysid_evo.models.base import make_model
from sysid_evo.registry import models
from sysid_evo.testing import example_dataset
from tests.fixtures.checkpoints import AlwaysDue, Stop, StopAfter

SHORT = {"hidden": [6], "one_step_updates": 30, "updates": 30, "horizon": 5}
FAMILIES = {
    "mlp_ensemble": {"members": 2, "folds": 3, "stochastic": True, "state_lags": 1, "control_lags": None},
    "neural_ode": {},
    "hybrid_ode": {"state_lags": 0},
}
"""Families that are trained by gradients: with a search for lags, with rough fits, with physical parameters."""


def fitted(family, checkpoint=None, progress=None, dataset=None, seed=1, **parameters):
    """Return what a family learns, and what its source of random numbers draws next."""
    model = make_model(family, **{**SHORT, **FAMILIES[family], **parameters})
    model.checkpoint = checkpoint
    rng = np.random.default_rng(seed)
    model.fit(dataset or example_dataset(), rng=rng, progress=progress)
    learned = {name: value for name, value in vars(model).items() if name.endswith("_") and name != "system_"}
    arrays = {name: [np.asarray(one) for one in _listed(value)] for name, value in learned.items()}
    return {**arrays, "next": [rng.random(3)]}


def _listed(value):
    return value if isinstance(value, list) else [value]


def assert_same(one, other):
    assert one.keys() == other.keys()
    for name, arrays in one.items():
        for left, right in zip(arrays, other[name], strict=True):
            np.testing.assert_array_equal(left, right)


@pytest.mark.parametrize("family", FAMILIES)
def test_a_fit_that_is_stopped_again_and_again_ends_as_it_would_have(family, tmp_path):
    whole = StopAfter(-1)
    expected = fitted(family, None, whole)
    told = sorted(set(whole.told))
    stops = [told[1], told[4], told[5], told[len(told) // 2], told[-3]]
    for number, after in enumerate(dict.fromkeys(stops)):
        watched = StopAfter(after)
        with pytest.raises(Stop):
            fitted(family, CheckpointFile(tmp_path / "c"), watched)
        assert number == 0 or min(watched.told[1:]) > 0
    watched = StopAfter(-1)
    assert_same(fitted(family, CheckpointFile(tmp_path / "c"), watched), expected)
    assert len(set(watched.told)) < len(told) - 3  # most of it was not done again


def standing(seed):
    """Return how a made-up training of two members stands after three updates."""
    rng = np.random.default_rng(seed)
    found = TrainingState.at(rng.standard_normal((2, 3)).astype(np.float32))
    for _ in range(3 + seed):
        found.descend(rng.standard_normal((2, 3)).astype(np.float32), 0.1)
        found.average(0.5)
    found.keep(np.array([0.5 + seed, np.inf]))
    return found


def test_a_step_of_adam_is_as_the_paper_has_it():
    """Its first step is the learning rate against the sign of the gradient; a gradient that is no number does none."""
    one = TrainingState.at(np.zeros((1, 3), dtype=np.float32))
    one.descend(np.array([[0.1, -0.2, np.nan]], dtype=np.float32), 0.01)
    assert not one.parameters.any()
    one.descend(np.array([[0.1, -0.2, 0.0]], dtype=np.float32), 0.01)
    np.testing.assert_allclose(one.parameters, [[-0.01, 0.01, 0.0]], rtol=1e-5)
    long = TrainingState.at(np.zeros((1, 2), dtype=np.float32))
    long.descend(np.array([[300.0, 400.0]], dtype=np.float32), 0.01)
    np.testing.assert_allclose(long.first, [[0.06, 0.08]], rtol=1e-4)  # a tenth of a gradient of length 1


def test_all_that_changes_in_a_training_is_stored_and_comes_back():
    one, other = standing(1), standing(2)
    kept, unlike = one.copies(), other.copies()
    assert all(not np.array_equal(kept[name], unlike[name]) for name in kept)
    other.restore(kept)
    assert_same({name: [value] for name, value in other.copies().items()}, {name: [kept[name]] for name in kept})
    assert kept["steps"] == 4.0


def test_ctrl_c_keeps_the_updates_that_were_reported(tmp_path):
    def interrupted(done, total, note=""):
        if done == 41:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fitted("neural_ode", CheckpointFile(tmp_path / "c"), interrupted)
    _, state = read_checkpoint(tmp_path / "c")
    assert state["updates"] == 41
    assert state["ended"] == 0


def test_a_fit_without_a_checkpoint_is_the_same(tmp_path):
    assert_same(fitted("neural_ode", AlwaysDue(tmp_path / "c")), fitted("neural_ode"))


def test_other_data_parameters_and_seeds_are_other_work(tmp_path):
    file = CheckpointFile(tmp_path / "c")
    fitted("neural_ode", file)
    for changed in ({"updates": 31}, {"seed": 2}, {"dataset": example_dataset(episodes=2)}):
        with pytest.warns(CheckpointWarning, match="of other work"):
            fitted("neural_ode", file, **changed)


def test_a_state_that_makes_no_sense_is_ignored(tmp_path):
    file = CheckpointFile(tmp_path / "c")
    with pytest.raises(Stop):
        fitted("neural_ode", file, StopAfter(41))
    identity, state = read_checkpoint(file.path)
    file.save(identity, {**state, "now/mean": np.zeros((1, 2))})
    with pytest.warns(CheckpointWarning, match="the checkpoint is ignored in this training: expected the shape"):
        assert_same(fitted("neural_ode", file), fitted("neural_ode"))


def test_every_family_trained_by_gradients_is_resumable():
    trained = [name for name in models.names() if "one_step_updates" in make_model(name).get_params()]
    assert {*FAMILIES} <= {*trained}
    assert all(models.get(name).resumable for name in trained)
