"""A fit by gradients that was stopped or killed goes on to the same model."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from model_zoo.networks.training import TrainingState
from sysid_evo.artefacts import CheckpointFile, read_checkpoint
from sysid_evo.data import Dataset
from sysid_evo.errors import CheckpointWarning
from sysid_evo.models.base import make_model
from sysid_evo.progress import Progress
from sysid_evo.registry import models
from sysid_evo.testing import example_dataset
from sysid_evo.types import Array
from tests.unit.evolution.test_checkpoints import AlwaysDue, Stop, StopAfter

ROOT = Path(__file__).parents[2]
SHORT: dict[str, Any] = {"hidden": [6], "one_step_updates": 30, "updates": 30, "horizon": 5}
FAMILIES: dict[str, dict[str, Any]] = {
    "mlp_ensemble": {"members": 2, "folds": 3, "stochastic": True, "state_lags": 1, "control_lags": None},
    "neural_ode": {},
    "hybrid_ode": {"state_lags": 0},
}
"""Families that are trained by gradients: with a search for lags, with rough fits, with physical parameters."""

PROGRAM = """
import sys
from tests.model_zoo.test_trainings import AlwaysDue, fitted

def told(done, total, note=""):
    print(done, flush=True)

fitted("neural_ode", AlwaysDue(sys.argv[1]), told, updates=100000)
"""


def fitted(
    family: str,
    checkpoint: CheckpointFile | None = None,
    progress: Progress | None = None,
    dataset: Dataset | None = None,
    seed: int = 1,
    **parameters: Any,
) -> dict[str, list[Array]]:
    """Return what a family learns, and what its source of random numbers draws next."""
    model = make_model(family, **{**SHORT, **FAMILIES[family], **parameters})
    model.checkpoint = checkpoint
    rng = np.random.default_rng(seed)
    model.fit(dataset or example_dataset(), rng=rng, progress=progress)
    learned = {name: value for name, value in vars(model).items() if name.endswith("_") and name != "system_"}
    arrays = {name: [np.asarray(one) for one in _listed(value)] for name, value in learned.items()}
    return {**arrays, "next": [rng.random(3)]}


def _listed(value: Any) -> list[Any]:
    return value if isinstance(value, list) else [value]


def assert_same(one: dict[str, list[Array]], other: dict[str, list[Array]]) -> None:
    assert one.keys() == other.keys()
    for name, arrays in one.items():
        for left, right in zip(arrays, other[name], strict=True):
            np.testing.assert_array_equal(left, right)


@pytest.mark.parametrize("family", FAMILIES)
def test_a_fit_that_is_stopped_again_and_again_ends_as_it_would_have(family: str, tmp_path: Path) -> None:
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


def standing(seed: int) -> TrainingState:
    """Return how a made-up training of two members stands after three updates."""
    rng = np.random.default_rng(seed)
    found = TrainingState.at(rng.standard_normal((2, 3)).astype(np.float32))
    for _ in range(3 + seed):
        found.descend(rng.standard_normal((2, 3)).astype(np.float32), 0.1)
        found.average(0.5)
    found.keep(np.array([0.5 + seed, np.inf]))
    return found


def test_a_step_of_adam_is_as_the_paper_has_it() -> None:
    """Its first step is the learning rate against the sign of the gradient; a gradient that is no number does none."""
    one = TrainingState.at(np.zeros((1, 3), dtype=np.float32))
    one.descend(np.array([[0.1, -0.2, np.nan]], dtype=np.float32), 0.01)
    assert not one.parameters.any()
    one.descend(np.array([[0.1, -0.2, 0.0]], dtype=np.float32), 0.01)
    np.testing.assert_allclose(one.parameters, [[-0.01, 0.01, 0.0]], rtol=1e-5)
    long = TrainingState.at(np.zeros((1, 2), dtype=np.float32))
    long.descend(np.array([[300.0, 400.0]], dtype=np.float32), 0.01)
    np.testing.assert_allclose(long.first, [[0.06, 0.08]], rtol=1e-4)  # a tenth of a gradient of length 1


def test_all_that_changes_in_a_training_is_stored_and_comes_back() -> None:
    one, other = standing(1), standing(2)
    kept, unlike = one.copies(), other.copies()
    assert all(not np.array_equal(kept[name], unlike[name]) for name in kept)
    other.restore(kept)
    assert_same({name: [value] for name, value in other.copies().items()}, {name: [kept[name]] for name in kept})
    assert kept["steps"] == 4.0


def test_ctrl_c_keeps_the_updates_that_were_told(tmp_path: Path) -> None:
    def interrupted(done: int, total: int, note: str = "") -> None:
        if done == 41:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fitted("neural_ode", CheckpointFile(tmp_path / "c"), interrupted)
    _, state = read_checkpoint(tmp_path / "c")
    assert state["updates"] == 41
    assert state["ended"] == 0


def test_a_fit_without_a_checkpoint_is_the_same(tmp_path: Path) -> None:
    assert_same(fitted("neural_ode", AlwaysDue(tmp_path / "c")), fitted("neural_ode"))


def test_other_data_parameters_and_seeds_are_other_work(tmp_path: Path) -> None:
    file = CheckpointFile(tmp_path / "c")
    fitted("neural_ode", file)
    for changed in ({"updates": 31}, {"seed": 2}, {"dataset": example_dataset(episodes=2)}):
        with pytest.warns(CheckpointWarning, match="of other work"):
            fitted("neural_ode", file, **changed)  # type: ignore[arg-type]  # of several types


def test_a_state_that_makes_no_sense_is_ignored(tmp_path: Path) -> None:
    file = CheckpointFile(tmp_path / "c")
    with pytest.raises(Stop):
        fitted("neural_ode", file, StopAfter(41))
    identity, state = read_checkpoint(file.path)
    file.save(identity, {**state, "now/mean": np.zeros((1, 2))})
    with pytest.warns(CheckpointWarning, match="the checkpoint is ignored in this training: expected the shape"):
        assert_same(fitted("neural_ode", file), fitted("neural_ode"))


def test_every_family_that_is_trained_by_gradients_can_go_on() -> None:
    trained = [name for name in models.names() if "one_step_updates" in make_model(name).get_params()]
    assert {*FAMILIES} <= {*trained}
    assert all(models.get(name).resumable for name in trained)


def test_a_fit_killed_at_random_moments_loses_nothing_that_was_saved(tmp_path: Path) -> None:
    path, reached = tmp_path / "c", 0
    for updates in (60, 120):
        process = subprocess.Popen(
            [sys.executable, "-c", PROGRAM, str(path)], cwd=ROOT, stdout=subprocess.PIPE, text=True
        )
        assert process.stdout is not None
        told = [int(process.stdout.readline()) for _ in range(2)]
        assert told[1] >= reached
        for line in process.stdout:
            reached = int(line)
            if reached >= updates:
                break
        process.send_signal(signal.SIGKILL)
        process.communicate()
    _, state = read_checkpoint(path)
    assert int(state["updates"]) >= reached
    watched = StopAfter(161)
    with pytest.raises(Stop):
        fitted("neural_ode", CheckpointFile(path), watched, updates=100000)
    straight = CheckpointFile(tmp_path / "straight")
    with pytest.raises(Stop):
        fitted("neural_ode", straight, StopAfter(161), updates=100000)
    one, other = (read_checkpoint(file)[1] for file in (path, straight.path))
    assert one.keys() == other.keys()
    for name, value in one.items():
        np.testing.assert_array_equal(value, other[name])
