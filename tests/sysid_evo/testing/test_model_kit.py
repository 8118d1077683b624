"""The contract's own tests: each broken model is caught, with the sentence that it breaks."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any, ClassVar, Self

import numpy as np
import pytest

from sysid_evo.data import Dataset
from sysid_evo.errors import ContractViolation, IncompatibleSystem, RegistrationError
from sysid_evo.kernels import DynamicsKernel
from sysid_evo.kernels import Lifted as LiftedStep
from sysid_evo.models import DynamicsModel, require_planar
from sysid_evo.registry import models
from sysid_evo.system import Channel, System
from sysid_evo.testing import check_model, run_checks
from sysid_evo.types import Array


class Fading(DynamicsModel):
    """A model that keeps the contract: states fade by a factor drawn in `fit`."""

    def __init__(self, *, share: float = 0.9) -> None:
        self.share = share

    def fit(self, dataset: Dataset, *, rng: np.random.Generator, progress: Any = None) -> Self:
        self.factor_ = np.array([self.share + 0.05 * rng.random()])
        return self

    def next_state(self, carry: Array, control: Array) -> Array:
        return carry * self.factor_ + 0.01 * control.sum(axis=1, keepdims=True)


class Stochastic(Fading):
    """A model with noise in every step and in an offset that it remembers."""

    n_noise = 3
    n_draws = 1

    @property
    def n_carry(self) -> int:
        return super().n_carry + 1

    def start(self, states: Array, controls: Array, draws: Array | None = None) -> Array:
        assert draws is not None
        return np.concatenate([states[:, -1], draws], axis=1)

    def step(self, carry: Array, control: Array, noise: Array | None = None) -> Array:
        assert noise is not None
        after = 0.5 * carry[:, :3] + 0.01 * noise + 0.01 * carry[:, 3:]
        return np.concatenate([after, carry[:, 3:]], axis=1)


class Impure(Fading):
    def next_state(self, carry: Array, control: Array) -> Array:
        self.calls = getattr(self, "calls", 0) + 1
        return super().next_state(carry, control) + 1e-6 * self.calls


class Overwriting(Fading):
    def next_state(self, carry: Array, control: Array) -> Array:
        carry *= self.factor_
        return carry.copy()


class BatchDependent(Fading):
    def next_state(self, carry: Array, control: Array) -> Array:
        return super().next_state(carry, control) + 1e-3 * carry.mean(axis=0)


class SinglePrecision(Fading):
    def next_state(self, carry: Array, control: Array) -> Array:
        return super().next_state(carry, control).astype(np.float32)


class WrongShape(Fading):
    def next_state(self, carry: Array, control: Array) -> Array:
        return super().next_state(carry, control)[:, :-1]


class OneForAll(Fading):
    """One number for all states, which NumPy would spread over them."""

    def next_state(self, carry: Array, control: Array) -> Array:
        return DynamicsModel.next_state(self, carry, control)

    def acceleration(self, carry: Array, control: Array) -> Array:
        return carry[:, :1] * self.factor_


class NotFinite(Fading):
    def next_state(self, carry: Array, control: Array) -> Array:
        return np.full_like(carry, np.nan)


class OtherStart(Fading):
    def start(self, states: Array, controls: Array, draws: Array | None = None) -> Array:
        return super().start(states, controls) + 0.1


class OtherSimulation(Fading):
    def simulate(self, *arguments: Any, **keywords: Any) -> Array:
        return super().simulate(*arguments, **keywords) + 0.01


class ReturningNothing(Fading):
    def fit(self, dataset: Dataset, *, rng: np.random.Generator, progress: Any = None) -> Self:
        super().fit(dataset, rng=rng)
        return None  # type: ignore[return-value]


class Failing(Fading):
    def fit(self, dataset: Dataset, *, rng: np.random.Generator, progress: Any = None) -> Self:
        raise ZeroDivisionError("nothing to learn from")


class Scribbling(Fading):
    def fit(self, dataset: Dataset, *, rng: np.random.Generator, progress: Any = None) -> Self:
        super().fit(dataset, rng=rng)
        states = dataset.episodes[0].states
        kept = states.copy()
        states *= 2.0
        Scribbling.undo = lambda: states.__setitem__(slice(None), kept)
        return self


class GloballyRandom(Fading):
    def fit(self, dataset: Dataset, *, rng: np.random.Generator, progress: Any = None) -> Self:
        self.factor_ = np.array([0.9 + 0.01 * GLOBAL.random()])
        return self


class Unsavable(Fading):
    def fit(self, dataset: Dataset, *, rng: np.random.Generator, progress: Any = None) -> Self:
        super().fit(dataset, rng=rng)
        self.cache_ = {"factor": self.factor_}
        return self


class Forgetful(Fading):
    """Steps with something learned whose name does not end in an underscore."""

    def fit(self, dataset: Dataset, *, rng: np.random.Generator, progress: Any = None) -> Self:
        super().fit(dataset, rng=rng)
        self.bonus = 1.0
        return self

    def next_state(self, carry: Array, control: Array) -> Array:
        return super().next_state(carry, control) + getattr(self, "bonus", 0.0)


class Meddling(Fading):
    """A constructor that does more than store its arguments."""

    def __init__(self, *, share: float = 0.9) -> None:
        self.share = share * 0.5


class BlindToFitting(Fading):
    def simulate(self, *arguments: Any, **keywords: Any) -> Array:
        return np.zeros((1, 1, 3)) if not hasattr(self, "system_") else super().simulate(*arguments, **keywords)


class Lifted(Fading):
    """Brings a compiled form of its step; ``faster`` is a factor that step has not."""

    faster: ClassVar[float] = 1.0

    def kernel(self) -> DynamicsKernel:
        return DynamicsKernel(LiftedStep(fade, n_carry=3, nu=2), self.factor_ * self.faster)


class OtherKernel(Lifted):
    faster: ClassVar[float] = 1.00001


class Retelling(Fading):
    """Says in its note what it learned, and nothing of how much it learned from."""

    most_steps: int | None = 100_000

    def __init__(self, *, share: float = 0.9, most_steps: int | None = 100_000) -> None:
        self.share, self.most_steps = share, most_steps

    @property
    def fit_note(self) -> str:
        return f"fades by {self.factor_[0]:.2f}"


class Drifting(Fading):
    """Says that it holds a body at rest, and has a step of its own that does not."""

    rest_hold = True

    def step(self, carry: Array, control: Array, noise: Array | None = None) -> Array:
        return self.next_state(carry, control) + 0.001


class Deaf(Fading):
    """Holds a body at rest whatever the controls were that have yet to act."""

    rest_hold = True
    control_lags = 2

    def __init__(self, *, share: float = 0.9, rest_hold: bool = True) -> None:
        self.share = share
        self.rest_hold = rest_hold

    def next_state(self, carry: Array, control: Array) -> Array:
        return carry[:, :3] * self.factor_ + 0.01 * carry[:, -2:].sum(axis=1, keepdims=True)

    def held(self, carry: Array, control: Array, after: Array) -> Array:
        still = (np.abs(carry[:, :3]) <= 0.001).all(axis=1) & (control == 0.0).all(axis=1)
        return np.where(still[:, None] & self.rest_hold, 0.0, after)


class Unstoppable(Fading):
    """Carries on whatever progress raises."""

    def fit(self, dataset: Dataset, *, rng: np.random.Generator, progress: Any = None) -> Self:
        for done in range(5):
            try:
                progress(done, 5)
            except Exception:
                continue
        return super().fit(dataset, rng=rng, progress=progress)


class LearningInPlace(Fading):
    """Learns into what it had learned before, so that a stopped fit spoils it."""

    def fit(self, dataset: Dataset, *, rng: np.random.Generator, progress: Any = None) -> Self:
        if not hasattr(self, "factor_"):
            self.factor_ = np.zeros(1)
        self.factor_ *= 0.0
        progress = progress or (lambda done, total: None)
        progress(1, 2)
        self.factor_ += self.share + 0.05 * rng.random()
        progress(2, 2)
        return self


class Overstating(Fading):
    """Has done more than there is."""

    def fit(self, dataset: Dataset, *, rng: np.random.Generator, progress: Any = None) -> Self:
        if progress is not None:
            progress(3, 2)
        return super().fit(dataset, rng=rng, progress=progress)


def fade(x, u, p):  # type: ignore[no-untyped-def]  # read by Numba
    push = 0.01 * (u[0] + u[1])
    return x[0] * p[0] + push, x[1] * p[0] + push, x[2] * p[0] + push


GLOBAL = np.random.default_rng(0)

RIGHT_SHAPE = "A step turns a carry (B, n_carry) into a carry of the same shape, in float64"
FIT = "fit learns from a recording, leaves it as it is, and returns the model itself"
PURE = "A step changes neither its arguments nor its own later results"
STOPPED = "fit says how far it is, and what progress raises stops it and leaves the model as it was"
STORED = "A stored model steps bit for bit as before"
CLONE = "get_params and clone give back the constructor's arguments, unfitted"


def broken(results: Any) -> dict[str, str]:
    return {result.sentence: result.failure for result in results if result.failure is not None}


@pytest.mark.parametrize("family", [Fading, Stochastic, Lifted])
def test_a_sound_model_keeps_every_sentence(family: type[Fading], register: Callable[..., Any]) -> None:
    register(models, "fading", family)
    results = list(run_checks("fading"))
    assert broken(results) == {}
    assert len({result.sentence for result in results}) == len(results) >= 10
    check_model("fading", share=0.8)


def test_what_is_not_finite_breaks_no_other_sentence(register: Callable[..., Any]) -> None:
    register(models, "broken", NotFinite)
    assert list(broken(run_checks("broken"))) == [RIGHT_SHAPE]


@pytest.mark.parametrize(
    "family, sentence, reason",
    [
        (Impure, PURE, "the same step twice gives two results"),
        (Overwriting, PURE, "step overwrites its arguments"),
        (BatchDependent, "Every row of a batch is computed for itself", "changes with the other rows"),
        (SinglePrecision, RIGHT_SHAPE, "float64, got .* float32"),
        (WrongShape, RIGHT_SHAPE, r"WrongShape.next_state: expected shape \(\d+, 3\), got \(\d+, 2\)"),
        (OneForAll, RIGHT_SHAPE, r"OneForAll.acceleration: expected shape \(\d+, 3\), got \(\d+, 1\)"),
        (NotFinite, RIGHT_SHAPE, "a step from a training state is not finite"),
        (OtherStart, "The carry begins with the state", "is not the last measured state"),
        (OtherSimulation, "A free run equals its steps one after the other", "they differ at step 1"),
        (OtherKernel, "The compiled form steps as step does", r"\d+ of \d+ rows differ after one step in float64"),
        (Drifting, "A model at rest with neutral control stays at rest", "it moves off by itself"),
        (Deaf, "A body at rest answers to a pulse", "an earlier control in its carry is not neutral"),
        (Unstoppable, STOPPED, "an exception from progress does not stop the fit"),
        (LearningInPlace, STOPPED, "a fitted model steps differently after a second fit was stopped"),
        (Overstating, STOPPED, "expected progress from 0 to all of the steps"),
        (ReturningNothing, FIT, "ReturningNothing.fit must return self, got NoneType"),
        (Failing, FIT, r"ZeroDivisionError: nothing to learn from \(test_model_kit.py, line \d+: raise ZeroDiv"),
        (GloballyRandom, "The same data and seed give the same model", "two fits with the same seed step differently"),
        (
            Retelling,
            "Of a recording longer than most_steps",
            "fit_note is .fades by .* after a fit with most_st",
        ),
        (Unsavable, STORED, "cache_ is a dict; what a model learns must be arrays"),
        (Forgetful, STORED, "it steps differently after loading"),
        (Meddling, CLONE, "RuntimeError: Cannot clone"),
        (BlindToFitting, "A model that is not fitted says so", "simulate before fit: expected NotFitted, got no error"),
    ],
)
def test_a_broken_model_is_caught_with_the_sentence_it_breaks(
    family: type[Fading], sentence: str, reason: str, register: Callable[..., Any]
) -> None:
    register(models, "broken", family)
    found = broken(run_checks("broken"))
    (key,) = [key for key in found if key.startswith(sentence)]
    assert re.search(reason, found[key])
    with pytest.raises(ContractViolation, match="model 'broken' breaks") as raised:
        check_model("broken")
    assert f"- {key}: {found[key]}" in str(raised.value)


def test_a_fit_that_overwrites_the_recording_is_caught(register: Callable[..., Any], recording: Dataset) -> None:
    register(models, "broken", Scribbling)
    assert broken(run_checks("broken", recording))[FIT] == "fit overwrites the recording"
    Scribbling.undo()


def test_after_a_failed_fit_nothing_else_is_checked(register: Callable[..., Any]) -> None:
    register(models, "broken", Failing)
    assert [result.sentence for result in run_checks("broken")][-1] == FIT


def test_a_system_that_the_family_refuses_is_no_broken_sentence(register: Callable[..., Any]) -> None:
    class Planar(Fading):
        def check_system(self, system: System) -> None:
            require_planar(self, system)

    register(models, "planar", Planar)
    system = System((Channel("x"),), (Channel("u", low=-1.0, high=1.0),), dt=0.1)
    rng = np.random.default_rng(0)
    dataset = Dataset.from_arrays(system, [rng.standard_normal((30, 1))], [rng.uniform(-1, 1, (29, 1))])
    with pytest.raises(IncompatibleSystem, match="Planar describes a planar body"):
        list(run_checks("planar", dataset))


def test_the_quick_preset_gives_way_to_what_is_asked_for(register: Callable[..., Any]) -> None:
    seen: list[float] = []

    class Preset(Fading):
        presets: ClassVar = {"quick": {"share": 0.5}}

        def fit(self, dataset: Dataset, *, rng: np.random.Generator, progress: Any = None) -> Self:
            seen.append(self.share)
            return super().fit(dataset, rng=rng)

    register(models, "preset", Preset)
    check_model("preset")
    assert set(seen) == {0.5}
    seen.clear()
    check_model("preset", share=0.25)
    assert set(seen) == {0.25}


def test_a_class_without_what_every_model_has_is_refused_where_it_is_registered() -> None:
    with pytest.raises(RegistrationError, match=r"model 'unfinished': .*Unfinished does not define fit, which every"):

        @models.register("unfinished")
        class Unfinished(DynamicsModel):
            def next_state(self, carry: Array, control: Array) -> Array:
                return carry

    assert "unfinished" not in models.names()
