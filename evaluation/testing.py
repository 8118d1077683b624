"""The contract of a probe, sentence by sentence; see `sysid_evo.testing` for the other kinds."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, TypeAlias

import numpy as np

from evaluation.exploitability.anywhere import GenericProbe, Usual
from evaluation.exploitability.probes import Probe
from evaluation.exploitability.steps import Steps
from sysid_evo.arrays import Array, BoolArray
from sysid_evo.data import Trajectory
from sysid_evo.errors import ContractViolation
from sysid_evo.registry import probes
from sysid_evo.testing.arrays import twice
from sysid_evo.testing.examples import switched_car
from sysid_evo.testing.verdicts import Check, CheckResult, expect, raise_broken, verdicts

STEPS = 50
SLOW = 0.2
CAR = switched_car()
AnyProbe: TypeAlias = Probe | GenericProbe


def check_probe(name: str, **parameters: Any) -> None:
    """Raise `ContractViolation` listing every sentence that the registered probe ``name`` breaks."""
    raise_broken("probe", name, run_probe_checks(name, **parameters))


def run_probe_checks(name: str, **parameters: Any) -> Iterator[CheckResult]:
    """Yield the result of every check of the registered probe ``name``."""
    return verdicts(lambda: probes.make(name, **parameters), CHECKS)


def it_is_made_without_arguments(probe: AnyProbe) -> None:
    """Its class can be called without arguments"""
    type(probe)()


def it_says_what_it_looks_at(probe: AnyProbe) -> None:
    """It has a unit, and a phrase that goes on after the words: its controllers"""
    expect(isinstance(probe.unit, str), f"expected a unit such as m/s, got {probe.unit!r}")
    sound = isinstance(probe.phrase, str) and probe.phrase and not probe.phrase.endswith(".")
    expect(sound and probe.phrase[0].islower(), f"expected a phrase such as 'turn on the spot', got {probe.phrase!r}")
    if isinstance(probe, Probe):
        said = isinstance(probe.needs_lateral, bool)
        expect(said, f"expected needs_lateral to be true or false: {probe.needs_lateral}")


def it_measures_every_step(probe: AnyProbe) -> None:
    """measure gives one float64 number for each step and where it is defined; there it is finite"""
    for steps in (_steps(), _steps()[:1], _steps()[:0]):
        _expect_measured(probe, steps)


def it_bears_standstill(probe: AnyProbe) -> None:
    """It can be measured at standstill"""
    zero = np.zeros((3, CAR.nx))
    still = Steps(CAR, zero, np.zeros((3, CAR.nu)), zero)
    with np.errstate(divide="raise", invalid="raise"):
        values, defined = _measure(probe, still)
    expect(np.isfinite(values[defined]).all(), "it is not finite where it is defined")


def measuring_is_pure(probe: AnyProbe) -> None:
    """measure changes neither its arguments nor its own later results"""
    steps = _steps()
    if isinstance(probe, GenericProbe):
        twice("measure", probe.measure, steps, _usual())
    else:
        twice("measure", probe.measure, steps.planar, SLOW)


def steps_are_independent(probe: AnyProbe) -> None:
    """Every step is measured for itself"""
    values, defined = _measure(probe, _steps())
    for i in range(STEPS):
        one = slice(i, i + 1)
        value, known = _measure(probe, _steps()[one])
        expect(
            known[0] == defined[i] and (not known[0] or np.allclose(value, values[one], rtol=1e-12)),
            f"step {i} is measured otherwise when it is alone",
        )


def it_tells_steps_apart(probe: AnyProbe) -> None:
    """Among steps of all kinds some are defined, and not all of them are alike"""
    values, defined = _measure(probe, _steps())
    expect(defined.any(), "it is defined nowhere")
    expect(len(np.unique(np.abs(values[defined]))) > 1, "it gives the same number for every step")


CHECKS: tuple[Check[AnyProbe], ...] = (
    it_is_made_without_arguments,
    it_says_what_it_looks_at,
    it_measures_every_step,
    it_bears_standstill,
    measuring_is_pure,
    steps_are_independent,
    it_tells_steps_apart,
)


def _steps() -> Steps:
    """Return steps of every kind: a third of them slow, some after a new command, some after long without one."""
    rng = np.random.default_rng(2)
    states = rng.standard_normal((STEPS + 1, CAR.nx))
    states[::3, 0] *= 0.1
    controls = rng.choice([-1.0, 0.0, 1.0], (STEPS, CAR.nu))
    controls[10:36] = 0.0
    controls[36:43], controls[43:] = 1.0, -1.0
    return Steps.of(CAR, [Trajectory(states, controls, CAR.dt)])


def _usual() -> Usual:
    return Usual.of(_steps())


def _measure(probe: AnyProbe, steps: Steps) -> tuple[Array, BoolArray]:
    if isinstance(probe, GenericProbe):
        return probe.measure(steps, _usual())
    return probe.measure(steps.planar, SLOW)


def _expect_measured(probe: AnyProbe, steps: Steps) -> None:
    count = len(steps)
    values, defined = _measure(probe, steps)
    for name, array, kind in (("quantity", values, np.float64), ("where it is defined", defined, np.bool_)):
        if np.shape(array) != (count,) or np.asarray(array).dtype != kind:
            raise ContractViolation(
                f"{name}: expected ({count},) {np.dtype(kind)}, got {np.shape(array)} {np.asarray(array).dtype}"
            )
    expect(np.isfinite(values[defined]).all(), "it is not finite where it is defined")
