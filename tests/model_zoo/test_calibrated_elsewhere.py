"""The spread of a model in another condition: what of, and what is left as it was."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from sysid_evo.data import Dataset
from sysid_evo.models.adaptation import ANEW, NONE, REFIT, Learned, Terms, adapted
from sysid_evo.models.adaptation.adapted import calibrated_elsewhere
from sysid_evo.models.adaptation.selection import Adaptation, Verdict
from sysid_evo.models.base import make_model
from sysid_evo.types import Array
from sysid_evo.validation import intervals
from sysid_evo.validation.intervals import LAGS, MOST_WINDOWS
from tests.fixtures.systems import FloorCar, drive

NOISE = 0.05


@pytest.fixture(scope="module")
def base() -> Any:
    """A model of the car, linear and with a spread, that hardly errs."""
    return make_model("linear", stochastic=True).fit(drive(FloorCar(), seconds=40.0, seed=1, noise=0.001), rng=_rng())


@pytest.fixture(scope="module")
def parts() -> list[Dataset]:
    """Two recordings of the same car on a floor that shakes, the second of two episodes."""
    first, second, third = (drive(FloorCar(), seconds=s, seed=s, noise=NOISE) for s in (12, 7, 9))
    return [first, second.with_episodes([*second, *third])]


def _rng() -> np.random.Generator:
    return np.random.default_rng(0)


def uncorrected(base: Any, held: Dataset | None) -> Learned:
    terms = Terms.of(drive(FloorCar(), seconds=5.0, seed=3))
    return Learned(base, terms, np.zeros(terms.shape), held)


def kept(model: Any) -> list[Array]:
    return [getattr(model, name).copy() for name in ("residual_", "persistent_", "horizon_scales_")]


def test_the_error_of_a_step_is_that_over_all_held_parts_and_the_base_keeps_its_own(
    base: Any, parts: list[Dataset]
) -> None:
    before = kept(base)
    found = calibrated_elsewhere(base, [uncorrected(base, held) for held in parts], _rng())
    assert found is not base
    assert all((one == other).all() for one, other in zip(kept(base), before, strict=True))
    assert found.residual_[:2] == pytest.approx(np.full(2, NOISE), rel=0.25)  # how it turns is not linear
    assert (found.residual_[:2] > 3.0 * before[0][:2]).all()
    assert (found.persistent_[:2] < 0.3).all()


def test_samples_of_two_parts_and_of_two_episodes_are_never_neighbours(
    base: Any, parts: list[Dataset], monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = list[Array]()

    def persistent_share(errors: Array, numbers: Array) -> Array:
        seen.append(numbers)
        return np.zeros(errors.shape[1])

    monkeypatch.setattr(intervals, "persistent_share", persistent_share)
    calibrated_elsewhere(base, [uncorrected(base, held) for held in parts], _rng())
    (numbers,) = seen
    steps = np.diff(numbers)
    assert (steps > 0).all()
    assert (np.sort(steps)[-2:] > max(LAGS)).all()
    assert (np.sort(steps)[:-2] == 1).all()


def test_every_part_is_run_with_the_error_of_all_and_has_its_share_of_windows(
    base: Any, parts: list[Dataset], monkeypatch: pytest.MonkeyPatch
) -> None:
    cases = list[Any]()

    def horizon_scales(own: list[Any], *_: Any) -> Array:
        cases.extend(own)
        return np.ones((4, 3))

    monkeypatch.setattr(adapted, "MOST_WINDOWS", 60)
    monkeypatch.setattr(adapted, "horizon_scales", horizon_scales)
    apart = [*(uncorrected(base, held) for held in parts), uncorrected(base, None)]
    found = calibrated_elsewhere(base, apart, _rng())
    assert [len(case.windows) for case in cases] == [30, 30]
    assert all((case.model.base.residual_ == found.residual_).all() for case in cases)
    assert MOST_WINDOWS > 60


def test_a_correction_is_part_of_the_step(base: Any, parts: list[Dataset]) -> None:
    """One that adds as much to every acceleration shifts every step by that, and is no noise about a mean."""
    plain, pushed = uncorrected(base, parts[0]), 1.0
    coefficients = plain.coefficients.copy()
    coefficients[0] = pushed / (plain.terms.unit * base.system.dt)
    shifted = calibrated_elsewhere(base, [replace(plain, coefficients=coefficients)], _rng())
    assert shifted.residual_ == pytest.approx(np.full(3, pushed), rel=0.1)


@pytest.mark.parametrize(
    ("chosen", "anew"),
    [(NONE, False), (ANEW, False), (REFIT, False), ("linear, ridge 3", True), ("trained further, 50 updates", True)],
)
def test_what_was_fitted_anew_and_what_did_not_change_keep_their_own_spread(
    base: Any, parts: list[Dataset], monkeypatch: pytest.MonkeyPatch, chosen: str, anew: bool
) -> None:
    learned = uncorrected(base, None)
    found = Adaptation(learned, Verdict(10.0, 3, 0.5, (), chosen), (uncorrected(base, parts[0]),))
    monkeypatch.setattr(adapted, "adaptation", lambda *_, **__: found)
    calibrated = base.variant()
    monkeypatch.setattr(adapted, "calibrated_elsewhere", lambda *_: calibrated)
    model: Any = make_model("adapted", base=None).given(base).fit(parts[0], rng=_rng())  # type: ignore[attr-defined]
    assert model.base_ is (calibrated if anew else base)
