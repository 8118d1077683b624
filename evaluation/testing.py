"""The contract of a probe, sentence by sentence; see `sysid_evo.testing` for the other kinds."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields
from typing import Any

import numpy as np

from evaluation.exploitability.probes import Probe
from evaluation.exploitability.steps import PlanarSteps
from sysid_evo.arrays import Array, BoolArray
from sysid_evo.errors import ContractViolation
from sysid_evo.registry import probes
from sysid_evo.testing.arrays import twice
from sysid_evo.testing.verdicts import Check, CheckResult, expect, raise_broken, verdicts

STEPS = 50
SLOW = 0.2


def check_probe(name: str, **parameters: Any) -> None:
    """Raise `ContractViolation` listing every sentence that the registered probe ``name`` breaks."""
    raise_broken("probe", name, run_probe_checks(name, **parameters))


def run_probe_checks(name: str, **parameters: Any) -> Iterator[CheckResult]:
    """Yield the result of every check of the registered probe ``name``."""
    return verdicts(lambda: probes.make(name, **parameters), CHECKS)


def it_is_made_without_arguments(probe: Probe) -> None:
    """Its class can be called without arguments"""
    type(probe)()


def it_says_what_it_looks_at(probe: Probe) -> None:
    """It has a unit, and a phrase that goes on after the words: its controllers"""
    expect(isinstance(probe.unit, str), f"expected a unit such as m/s, got {probe.unit!r}")
    sound = isinstance(probe.phrase, str) and probe.phrase and not probe.phrase.endswith(".")
    expect(sound and probe.phrase[0].islower(), f"expected a phrase such as 'turn on the spot', got {probe.phrase!r}")
    expect(isinstance(probe.needs_lateral, bool), f"expected needs_lateral to be true or false: {probe.needs_lateral}")


def it_measures_every_step(probe: Probe) -> None:
    """measure gives one float64 number for each step and where it is defined; there it is finite"""
    for steps in (_steps(), _rows(_steps(), slice(0, 1)), _rows(_steps(), slice(0, 0))):
        _expect_measured(probe, steps)


def it_bears_standstill(probe: Probe) -> None:
    """It can be measured at standstill"""
    still = PlanarSteps(*(np.zeros(3) for _ in fields(PlanarSteps)))
    with np.errstate(divide="raise", invalid="raise"):
        values, defined = probe.measure(still, SLOW)
    expect(np.isfinite(values[defined]).all(), "it is not finite where it is defined")


def measuring_is_pure(probe: Probe) -> None:
    """measure changes neither its arguments nor its own later results"""
    twice("measure", probe.measure, _steps(), SLOW)


def steps_are_independent(probe: Probe) -> None:
    """Every step is measured for itself"""
    values, defined = probe.measure(_steps(), SLOW)
    for i in range(STEPS):
        one = slice(i, i + 1)
        value, known = probe.measure(_rows(_steps(), one), SLOW)
        expect(
            known[0] == defined[i] and (not known[0] or np.allclose(value, values[one], rtol=1e-12)),
            f"step {i} is measured otherwise when it is alone",
        )


def it_tells_steps_apart(probe: Probe) -> None:
    """Among steps of all kinds some are defined, and not all of them are alike"""
    values, defined = probe.measure(_steps(), SLOW)
    expect(defined.any(), "it is defined nowhere")
    expect(len(np.unique(np.abs(values[defined]))) > 1, "it gives the same number for every step")


CHECKS: tuple[Check[Probe], ...] = (
    it_is_made_without_arguments,
    it_says_what_it_looks_at,
    it_measures_every_step,
    it_bears_standstill,
    measuring_is_pure,
    steps_are_independent,
    it_tells_steps_apart,
)


def _steps() -> PlanarSteps:
    """Return steps of every kind: a third of them slow."""
    rng = np.random.default_rng(2)
    columns: list[Array] = [rng.standard_normal(STEPS) for _ in fields(PlanarSteps)]
    columns[0][::3] *= 0.1
    return PlanarSteps(*columns)


def _rows(steps: PlanarSteps, rows: slice) -> PlanarSteps:
    return PlanarSteps(*(getattr(steps, item.name)[rows] for item in fields(PlanarSteps)))


def _expect_measured(probe: Probe, steps: PlanarSteps) -> None:
    count = len(steps.forward_speed)
    measured: tuple[Array, BoolArray] = probe.measure(steps, SLOW)
    values, defined = measured
    for name, array, kind in (("quantity", values, np.float64), ("where it is defined", defined, np.bool_)):
        if np.shape(array) != (count,) or np.asarray(array).dtype != kind:
            raise ContractViolation(
                f"{name}: expected ({count},) {np.dtype(kind)}, got {np.shape(array)} {np.asarray(array).dtype}"
            )
    expect(np.isfinite(values[defined]).all(), "it is not finite where it is defined")
