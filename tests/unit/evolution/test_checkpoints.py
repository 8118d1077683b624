"""Checkpoints: what is stored is what comes back, and an evolution that was stopped ends as it would have."""

import resource
import time
from dataclasses import replace

import numpy as np
import pytest

from sysid_evo.artefacts import CheckpointFile, read_checkpoint
from sysid_evo.engine import DynamicsRunner
from sysid_evo.errors import CheckpointWarning, InvalidArgument
from sysid_evo.evolution import polish
from sysid_evo.evolution.strategies.mu_plus_lambda import MuPlusLambda
from sysid_evo.models.base import make_model
from sysid_evo.registry import strategies
from sysid_evo.testing import example_dataset
from tests.fixtures.checkpoints import AlwaysDue, Stop, StopAfter
from tests.fixtures.evolutions import SETTINGS, assert_same, evolved

STATE = {
    "matrix": np.arange(6.0).reshape(2, 3).T,
    "odd": np.array([np.nan, np.inf, -0.0, 5e-324]),
    "none": np.empty((0, 3)),
    "count": 2**200,
    "best": -np.inf,
    "third": 1 / 3,
    "text": "niche é\n",
}


@pytest.fixture(scope="module")
def whole():
    """The champion of an evolution that nothing stopped."""
    return evolved(SETTINGS)


def test_a_state_comes_back_bit_for_bit(tmp_path):
    CheckpointFile(tmp_path / "c").save("mine", STATE)
    found = CheckpointFile(tmp_path / "c").load("mine")
    assert set(found) == set(STATE)
    for name, value in STATE.items():
        assert type(found[name]) is type(value)
        assert np.shape(found[name]) == np.shape(value)
        if isinstance(value, np.ndarray):
            assert np.ascontiguousarray(found[name]).tobytes() == np.ascontiguousarray(value).tobytes()
        else:
            assert found[name] == value


def test_a_byte_that_is_changed_anywhere_is_noticed(tmp_path):
    file = CheckpointFile(tmp_path / "c")
    file.save("mine", STATE)
    written = file.path.read_bytes()
    for place in range(0, len(written), 7):
        changed = bytearray(written)
        changed[place] ^= 1
        file.path.write_bytes(changed)
        with pytest.warns(CheckpointWarning, match="ignored"):
            assert file.load("mine") is None
    for length in (0, 5, len(written) // 2, len(written) - 1):
        file.path.write_bytes(written[:length])
        with pytest.warns(CheckpointWarning, match="expected a checkpoint"):
            assert file.load("mine") is None


def test_a_checkpoint_is_only_for_its_own_work(tmp_path):
    file = CheckpointFile(tmp_path / "c")
    assert file.load("mine") is None
    file.save("mine", STATE)
    with pytest.warns(CheckpointWarning, match="of other work"):
        assert file.load("yours") is None


def test_a_file_is_due_after_its_time_and_never_costs_more_than_a_hundredth(tmp_path, monkeypatch):
    clock = iter([0.0, 4.9, 5.0, 6.0, 6.2, 25.0, 26.3])
    monkeypatch.setattr(time, "monotonic", lambda: next(clock))
    file = CheckpointFile(tmp_path / "c", every=5.0)
    assert (file.due(), file.due()) == (False, True)
    file.save("mine", STATE)  # takes 0.2 s, so that the next is due after 20 s
    assert (file.due(), file.due()) == (False, True)
    with pytest.raises(InvalidArgument, match="expected every >= 0 s"):
        CheckpointFile(tmp_path / "c", every=-1.0)


def test_a_checkpoint_that_cannot_be_written_stops_nothing(whole, tmp_path):
    """The system refuses files of more than 500 bytes, as a full disk does."""
    file, before = AlwaysDue(tmp_path / "c"), resource.getrlimit(resource.RLIMIT_FSIZE)
    file.save("mine", {})
    kept = file.path.read_bytes()
    assert len(kept) < 500
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (500, before[1]))
        with pytest.warns(CheckpointWarning) as told:
            found = evolved(SETTINGS, file)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert_same(found, whole)
    unwritten = [str(warning.message) for warning in told if "cannot be written" in str(warning.message)]
    assert unwritten == [
        f"{file.path}: cannot be written (File too large). The work continues; if it is interrupted now, it resumes "
        "from the previous checkpoint"
    ]
    assert [path.read_bytes() for path in tmp_path.iterdir()] == [kept]


@pytest.mark.parametrize("after", [1, 4, 8, *(pytest.param(n, marks=pytest.mark.nightly) for n in (2, 3, 5, 6, 7))])
def test_an_evolution_stopped_after_any_generation_resumes_to_the_same_champion(after, whole, tmp_path):
    with pytest.raises(Stop):  # the file is not due: being stopped is what saves it
        evolved(SETTINGS, CheckpointFile(tmp_path / "c"), threads=1, progress=StopAfter(after))
    watched = StopAfter(0)
    found = evolved(SETTINGS, CheckpointFile(tmp_path / "c"), threads=2, progress=watched)
    assert_same(found, whole)
    assert watched.told == list(range(after, 9))


def test_a_polish_that_is_stopped_resumes_to_the_same_champion(whole, tmp_path):
    dataset = example_dataset()
    runners = {name: DynamicsRunner(make_model(name).fit(dataset, rng=0)) for name in ("linear", "nearest_neighbour")}

    def polished(checkpoint, progress=None):
        return polish("p", whole, runners, SETTINGS, seed=1, generations=4, checkpoint=checkpoint, progress=progress)

    for after in (2, 4, 7):
        with pytest.raises(Stop):
            polished(CheckpointFile(tmp_path / "c"), StopAfter(after))
    assert_same(polished(CheckpointFile(tmp_path / "c")), polished(None))


def test_an_evolution_that_has_ended_is_not_done_again(whole, tmp_path):
    for steps in ([*range(1, 9)], [8]):
        watched = StopAfter(0)
        assert_same(evolved(SETTINGS, CheckpointFile(tmp_path / "c"), progress=watched), whole)
        assert watched.told == steps


def test_settings_seeds_and_models_that_differ_are_other_work(whole, tmp_path):
    def again(settings=SETTINGS, **options):
        return evolved(settings, CheckpointFile(tmp_path / "c"), **options)

    with pytest.raises(Stop):
        again(dataset=example_dataset(episodes=2), progress=StopAfter(6))
    with pytest.warns(CheckpointWarning, match="of other work"):
        assert_same(again(), whole)
    for settings, seed in ((replace(SETTINGS, trials=3), 3), (SETTINGS, 4)):
        with pytest.warns(CheckpointWarning, match="of other work"):
            again(settings, seed=seed)


@pytest.mark.parametrize("family", ["evolved3", "parametrised"])
def test_a_fit_by_evolution_that_was_stopped_resumes_to_the_same_model(family, car_data, tmp_path):
    def fitted(data, checkpoint, progress=None):
        model = make_model(family, generations=6, windows=20)
        model.checkpoint = checkpoint
        return model.fit(data, rng=1, progress=progress).parameters_

    for after in (1, 4):
        with pytest.raises(Stop):
            fitted(car_data, CheckpointFile(tmp_path / "c"), StopAfter(after))
    watched = StopAfter(-1)
    np.testing.assert_array_equal(fitted(car_data, CheckpointFile(tmp_path / "c"), watched), fitted(car_data, None))
    assert watched.told == [0, 4, 5, 6]
    with pytest.warns(CheckpointWarning, match="of other work"):
        fitted(car_data.with_episodes(car_data.episodes[:2]), CheckpointFile(tmp_path / "c"))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("runs", "two"),
        ("history", np.zeros((3, 2))),
        ("strategy.parents", np.zeros((9, 9))),
        ("ended.0.finalists", None),  # None leaves it out
    ],
)
def test_a_state_that_makes_no_sense_is_ignored(name, value, whole, tmp_path):
    file = CheckpointFile(tmp_path / "c")
    with pytest.raises(Stop):
        evolved(SETTINGS, file, progress=StopAfter(6))
    identity, state = read_checkpoint(file.path)
    others = {key: kept for key, kept in state.items() if key != name}
    file.save(identity, others if value is None else {**others, name: value})
    with pytest.warns(CheckpointWarning, match="the checkpoint is ignored"):
        assert_same(evolved(SETTINGS, file), whole)


def test_a_stop_while_a_strategy_learns_leaves_what_was_kept_last(tmp_path, whole, register):
    class Torn(MuPlusLambda):
        stop = True

        def _update(self, population, fitness, behaviour):
            if self.generation == 3 and Torn.stop:
                self._parents = self._parents[::-1]
                raise Stop
            super()._update(population, fitness, behaviour)

    register(strategies, "torn", Torn)
    settings = replace(SETTINGS, strategy="torn(parents=4, children=4)")
    for checkpoint, kept in (
        (AlwaysDue(tmp_path / "always"), True),
        (CheckpointFile(tmp_path / "c", every=1e9), False),
    ):
        Torn.stop = True
        with pytest.raises(Stop):
            evolved(settings, checkpoint)
        assert checkpoint.path.exists() == kept
        Torn.stop = False
        np.testing.assert_array_equal(evolved(settings, checkpoint).parameters, whole.parameters)
