"""The contract of probes: all that are listed keep it, each broken one is caught with its sentence."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from evaluation import testing as kit
from evaluation.exploitability.probes import Probe
from evaluation.exploitability.steps import PlanarSteps
from evaluation.testing import check_probe, run_probe_checks
from sysid_evo.arrays import Array, BoolArray
from sysid_evo.errors import ContractViolation
from sysid_evo.registry import probes
from tests.broken import broken, sentence


class Sliding(Probe):
    """A sound one: how far a body slides to the side of where it points."""

    unit, phrase, needs_lateral = "rad", "slide to the side of where they point", True

    def measure(self, steps: PlanarSteps, slow: float) -> tuple[Array, BoolArray]:
        return np.arctan2(steps.lateral_speed, np.abs(steps.forward_speed)), np.abs(steps.forward_speed) >= slow


class Needy(Sliding):
    def __init__(self, *, scale: float) -> None:
        self.scale = scale


class Sentence(Sliding):
    phrase = "Slides to the side."


class SinglePrecision(Sliding):
    def measure(self, steps: PlanarSteps, slow: float) -> tuple[Array, BoolArray]:
        values, defined = super().measure(steps, slow)
        return values.astype(np.float32), defined


class Dividing(Sliding):
    def measure(self, steps: PlanarSteps, slow: float) -> tuple[Array, BoolArray]:
        return steps.lateral_speed / steps.forward_speed, np.abs(steps.forward_speed) >= slow


class InPlace(Sliding):
    def measure(self, steps: PlanarSteps, slow: float) -> tuple[Array, BoolArray]:
        np.abs(steps.lateral_speed, out=steps.lateral_speed)
        return super().measure(steps, slow)


class Comparing(Sliding):
    def measure(self, steps: PlanarSteps, slow: float) -> tuple[Array, BoolArray]:
        values, defined = super().measure(steps, slow)
        return values - (values.mean() if len(values) else 0.0), defined


class Nowhere(Sliding):
    def measure(self, steps: PlanarSteps, slow: float) -> tuple[Array, BoolArray]:
        return super().measure(steps, np.inf)


BROKEN: list[tuple[type[Probe], Callable[..., None], str]] = [
    (Needy, kit.it_is_made_without_arguments, "TypeError: .*scale"),
    (Sentence, kit.it_says_what_it_looks_at, "got 'Slides to the side.'"),
    (SinglePrecision, kit.it_measures_every_step, r"quantity: expected \(50,\) float64, got \(50,\) float32"),
    (Dividing, kit.it_bears_standstill, "FloatingPointError"),
    (InPlace, kit.measuring_is_pure, "measure overwrites its arguments"),
    (Comparing, kit.steps_are_independent, "step 1 is measured otherwise when it is alone"),
    (Nowhere, kit.it_tells_steps_apart, "it is defined nowhere"),
]


@pytest.mark.parametrize("name", probes.names())
def test_every_probe_keeps_every_sentence(name: str) -> None:
    check_probe(name)


def test_a_sound_probe_keeps_every_sentence(register: Callable[..., Any]) -> None:
    register(probes, "sliding", Sliding)
    results = list(run_probe_checks("sliding"))
    assert broken(results) == {}
    assert len(results) == 1 + len(kit.CHECKS)


@pytest.mark.parametrize(("made", "check", "reason"), BROKEN)
def test_a_broken_probe_is_caught_with_the_one_sentence_it_breaks(
    made: type[Probe], check: Callable[..., None], reason: str, register: Callable[..., Any]
) -> None:
    register(probes, "broken", made)
    given = {"scale": 1.0} if made is Needy else {}
    found = broken(run_probe_checks("broken", **given))
    assert list(found) == [sentence(check)]
    with pytest.raises(ContractViolation, match=f"probe 'broken' breaks 1 of .*\n- .*{reason}"):
        check_probe("broken", **given)


def test_every_sentence_has_something_that_breaks_it() -> None:
    assert {check for _, check, _ in BROKEN} == set(kit.CHECKS)
