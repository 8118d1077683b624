"""Coverage of 90 % intervals after 1, 10, 20 and 60 steps, on held-out recordings.

    python -m tests.benchmarks.coverage [FAMILY ...] [--preset quick] [--seeds 1] [--logs slippery_20hz emulated_car]
    python -m tests.benchmarks.coverage [FAMILY ...] --conditions cars emulated

Every family is fitted with ``stochastic``. For each horizon the share of moving test targets inside the central 90 % of
100 samples is printed, over all channels and for each, with the mean width of the intervals in standard deviations, N
of the simulation without noise and the time of the fit.
By default all families are used that give a spread and fit in seconds. With ``--conditions`` (groups of
`tests.benchmarks.shift`) each family is fitted in one condition and tested in this and in others, before and after
adaptation to 30 s of data; ``--unadapted`` leaves the latter out.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from rich.console import Console
from rich.table import Table

from sysid_evo.types import Array
from sysid_evo.validation.intervals import SHARE
from tests.benchmarks.markdown import add_markdown, per_cents, print_tables, thousandths

if TYPE_CHECKING:
    from evaluation.prediction.cases import MeasuredCases
    from sysid_evo.models import DynamicsModel

FAMILIES = ("mlp_ensemble", "gaussian_process", "linear", "sindy", "sindy_discrete", "narx")
FAMILIES += ("k_neighbours", "parametrised", "neural_ode")
ADAPTED = 30.0  # s


def coverage(samples: Array, truth: Array, *, share: float = SHARE) -> Array:
    """Return the coverage (nx,): share of ``truth`` (N, nx) in the central ``share`` of ``samples`` (S, N, nx)."""
    low, high = np.quantile(samples, [0.5 - share / 2, 0.5 + share / 2], axis=0, method="weibull")
    return ((truth >= low) & (truth <= high)).mean(axis=0)


def uncertain(name: str, preset: str) -> DynamicsModel:
    """Return a family with its preset that is to learn its spread."""
    from evaluation.chosen_models import with_preset
    from sysid_evo.models.base import make_model
    from sysid_evo.registry import Spec

    return make_model(with_preset(Spec(name, {"stochastic": True}), preset))


def covered(label: str, model: DynamicsModel, cases: MeasuredCases) -> str:
    """Write coverage, width and N at each horizon; return coverage and mean width over all channels and horizons."""
    from evaluation.prediction.scoring import score_model

    scores = score_model(label, model, cases, family=label)
    shares = per_cents(np.mean(held.inside) for held in scores.coverage)
    channels = "  ".join(f"({per_cents(held.inside)})" for held in scores.coverage)
    widths = [float(np.nanmean(held.width)) for held in scores.coverage]
    errors = thousandths(score.n for score in scores.scores)
    sys.stdout.write(f"  {label:20s} {shares}  {channels}  width {thousandths(widths)}  N {errors}\n")
    sys.stdout.flush()
    return f"{shares} ({np.mean(widths):.1f})"


def on_logs(families: Sequence[str], preset: str, seeds: int, logs: Sequence[str]) -> Table:
    """Return the coverage of the intervals on the test part of each log, a row for each family."""
    from evaluation.prediction.cases import PredictionProtocol, measured_cases
    from sysid_evo.errors import IncompatibleSystem
    from tests.benchmarks.cars import recording

    found: dict[tuple[str, str], list[str]] = {}
    for log in logs:
        training, test = recording(log)
        cases = measured_cases(training, test, PredictionProtocol())
        sys.stdout.write(f"\n{log}: % inside 90 % intervals (each channel), N after {cases.horizons} steps\n")
        for name in families:
            for seed in range(seeds):
                model, began = uncertain(name, preset), time.process_time()
                try:
                    model.fit(training, rng=seed)
                except IncompatibleSystem as error:
                    sys.stdout.write(f"  {name:20s} {error}\n")
                    continue
                taken = time.process_time() - began
                found.setdefault((name, log), []).append(covered(name, model, cases))
                sys.stdout.write(f"    fit {taken:.1f} s\n")
    table = Table("family", *logs)
    for name in families:
        table.add_row(f"`{name}`", *("\n".join(found.get((name, log), [])) for log in logs))
    return table


def across_conditions(
    families: Sequence[str], preset: str, seeds: int, groups: Sequence[str], *, adapted: bool
) -> Table:
    """Return the coverage in the condition of the fit and in others: a row for each, and one after adaptation."""
    from evaluation.prediction.cases import PredictionProtocol, measured_cases
    from sysid_evo.models.adaptation.selection import NONE
    from tests.benchmarks.shift.recordings import cases

    found: dict[str, dict[str, list[str]]] = {}
    for name in families:
        fitted: dict[tuple[int, str], DynamicsModel] = {}
        for case in (case for group in groups for case in cases(group)):
            measured = measured_cases(case.training, case.test, PredictionProtocol())
            sys.stdout.write(f"\n{case.name}, {name}: % inside 90 % intervals after {measured.horizons} steps\n")
            before, after = (found.setdefault(f"{case.name}{word}", {}) for word in ("", ", adapted"))
            for seed in range(seeds):
                key = seed, case.training.fingerprint
                if key not in fitted:
                    fitted[key] = uncertain(name, preset).fit(case.training, rng=seed)
                before.setdefault(name, []).append(covered("as it was", fitted[key], measured))
                if not adapted:
                    continue
                there = fitted[key].adapt(case.first(ADAPTED), rng=seed)
                if vars(there)["chosen_"] == NONE:
                    sys.stdout.write("  nothing was learned there\n")
                else:
                    after.setdefault(name, []).append(covered("adapted", there, measured))
                    sys.stdout.write(f"    {there.fit_note}\n")
    table = Table("fitted in -> used in", *(f"`{name}`" for name in families))
    for condition, row in found.items():
        if row:
            table.add_row(condition, *("\n".join(row.get(name, [])) for name in families))
    return table


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the benchmark."""
    from tests.benchmarks.cars import EMULATED, TEST_EPISODE
    from tests.benchmarks.shift.recordings import GROUPS

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("families", nargs="*", default=list(FAMILIES))
    parser.add_argument("--preset", default="quick")
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--logs", nargs="+", default=[*TEST_EPISODE, EMULATED], choices=[*TEST_EPISODE, EMULATED])
    parser.add_argument("--conditions", nargs="+", default=[], choices=GROUPS)
    parser.add_argument("--unadapted", action="store_true")
    add_markdown(parser)
    given = parser.parse_args(arguments)
    if given.conditions:
        table = across_conditions(
            given.families, given.preset, given.seeds, given.conditions, adapted=not given.unadapted
        )
    else:
        table = on_logs(given.families, given.preset, given.seeds, given.logs)
    print_tables([table], given.markdown, Console(width=140))


if __name__ == "__main__":
    main()
