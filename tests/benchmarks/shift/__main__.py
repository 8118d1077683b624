"""Benefit of adaptation in another condition: ``python -m tests.benchmarks.shift [FAMILY ...] [--groups cars ...]``.

Every family is fitted in one condition and tested in another: on the other of two real cars and on the same car, on
each of four floors after a fit to the other three, on an emulated car, heater, pendulum and cart-pole with changed
parameters, and unchanged. Each seed adapts to another recording, or to another part of it. N (mean over channels of
RMSE / standard deviation) after 1, 10, 20 and 60 steps is printed before adaptation, after adaptation to 10 and 30 s,
for a fit from scratch to the same 30 s, and for a fit in-domain; ``--ways`` selects among these. The mean is over
``--seeds``; a star marks a difference from "before" at 20 steps according to a paired bootstrap over blocks of three
seconds (95 %). The decisions after 30 s are printed below, and at the end the comparison with the requirements. With
``--keep`` fitted models are stored in a folder and reused.

``--out`` writes a row for each case, family and seed as JSON; ``--read FILE ...`` measures nothing, but prints the
tables of all these rows, and writes them with ``--markdown``.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import numpy as np

from evaluation.chosen_models import with_preset
from evaluation.prediction.cases import MeasuredCases, PredictionProtocol, measured_cases
from sysid_evo.data import Dataset
from sysid_evo.errors import InvalidData
from sysid_evo.models import DynamicsModel, load_model, save_model
from sysid_evo.models.base import make_model
from sysid_evo.registry import Spec
from sysid_evo.types import Array
from sysid_evo.validation.estimates import Draws, drawn_rms
from tests.benchmarks.markdown import add_markdown, write_markdown
from tests.benchmarks.shift.recordings import GROUPS, Case, cases
from tests.benchmarks.shift.rows import MARKED, Row, errors_table, read_rows, verdicts_table, write_rows

HORIZONS = (1, 10, 20, 60)


def new_model(name: str, preset: str) -> DynamicsModel:
    """Return a family with its preset."""
    return make_model(with_preset(Spec(name), preset))


def resampled(measured: MeasuredCases, predicted: Array) -> dict[int, Draws]:
    """Return N at each horizon with its draws of blocks."""
    low, high = measured.guard
    predicted = np.clip(np.where(np.isfinite(predicted), predicted, high), low, high)
    found = {}
    for horizon in (h for h in HORIZONS if h in measured.horizons):
        rows = measured.moving[:, horizon - 1]
        errors = predicted[rows, horizon - 1] - measured.windows.states[rows, horizon - 1]
        blocks = measured.window_block[rows]
        found[horizon] = Draws((drawn_rms(errors, blocks) / measured.std).mean(axis=1), len(np.unique(blocks)))
    return found


def simulated(model: DynamicsModel, measured: MeasuredCases) -> Array:
    """Return simulations of the measured windows, with a short history padded."""
    w = measured.windows
    missing = max(0, model.n_lags - w.past_controls.shape[1])
    states = np.concatenate([np.repeat(w.past_states[:, :1], missing, axis=1), w.past_states], axis=1)
    controls = np.concatenate([np.repeat(w.past_controls[:, :1], missing, axis=1), w.past_controls], axis=1)
    return model.without_noise().simulate(states, controls, w.controls)


WAYS = ("10 s", "30 s", "scratch", "in-domain")


@dataclass(frozen=True)
class Fits:
    """A family fitted with its preset, once to each data set with each seed; kept in a folder, if there is one."""

    name: str
    preset: str
    folder: Path | None
    known: dict[tuple[int, str], DynamicsModel] = field(default_factory=dict)

    def fitted(self, data: Dataset, seed: int) -> DynamicsModel:
        """Return the model of ``data``."""
        key = seed, data.fingerprint
        if key not in self.known:
            self.known[key] = self._fitted(data, seed)
        return self.known[key]

    def _fitted(self, data: Dataset, seed: int) -> DynamicsModel:
        if self.folder is None:
            return new_model(self.name, self.preset).fit(data, rng=seed)
        file = self.folder / f"{self.name}-{self.preset}-{seed}-{data.fingerprint[:16]}"
        stored = file.with_name(f"{file.name}.json")
        if not stored.is_file():
            save_model(new_model(self.name, self.preset).fit(data, rng=seed), file, seed=seed)
        return load_model(stored)


def measure(case: Case, fits: Fits, seed: int, wanted: Sequence[str]) -> tuple[dict[str, dict[int, Draws]], str]:
    """Return N of every way to handle the other condition, and the decision after 30 s."""
    protocol, base = PredictionProtocol(), fits.fitted(case.training, seed)
    measured = measured_cases(case.training, case.test, protocol)
    found = {"before": resampled(measured, simulated(base, measured))}

    @cache
    def there() -> DynamicsModel:
        return base.adapt(case.first(30.0, seed), rng=seed)

    ways: dict[str, Callable[[], Array]] = {
        "10 s": lambda: simulated(base.adapt(case.first(10.0, seed), rng=seed), measured),
        "30 s": lambda: simulated(there(), measured),
        "scratch": lambda: simulated(fits.fitted(case.first(30.0, seed), seed), measured),
        "in-domain": lambda: simulated(fits.fitted(case.own, seed), measured),
    }
    for way, run in ((way, run) for way, run in ways.items() if way in wanted):
        try:
            found[way] = resampled(measured, run())
        except (InvalidData, np.linalg.LinAlgError) as error:
            sys.stderr.write(f"{case.name}, {way}: {error}\n")
    return found, there().fit_note if "30 s" in wanted else ""


def table(case: Case, name: str, runs: list[dict[str, dict[int, Draws]]]) -> str:
    """Return a line for every way, means over the seeds."""
    before = Draws.joined([run["before"][MARKED] for run in runs])
    lines = [f"{case.name}, {name}{'' if case.shifted else ' (nothing shifted)'}"]
    for way in runs[0]:
        of_way = [run[way] for run in runs if way in run]
        mean = {h: Draws.joined([one[h] for one in of_way]) for h in of_way[0]}
        figures = "/".join(f"{mean[h].value:.3f}" for h in mean)
        gain = mean[MARKED].value / before.value - 1.0
        star = " *" if way != "before" and (mean[MARKED] - before).estimate.differs_from(0.0) else ""
        lines.append(f"    {way:20s} {figures}  {100.0 * gain:+.0f} %{star}")
    return "\n".join(lines)


def report(case: Case, fits: Fits, seeds: int, ways: Sequence[str]) -> list[Row]:
    """Print what is measured in ``case`` with each seed, and return it; nothing where the family cannot be fitted."""
    write, began = sys.stdout.write, time.process_time()
    runs, rows = list[dict[str, dict[int, Draws]]](), list[Row]()
    try:
        for seed in range(seeds):
            run, note = measure(case, fits, seed, ways)
            runs.append(run)
            n = {way: {steps: found.value for steps, found in at.items()} for way, at in run.items()}
            rows.append(Row(case.name, case.shifted, fits.name, fits.preset, seed, n, note))
    except InvalidData as error:
        write(f"{case.name}, {fits.name}: {error}\n")
        return []
    notes = dict.fromkeys(row.note for row in rows if row.note)
    spent = f"{time.process_time() - began:.0f} s of processor time\n"
    write("\n    ".join([table(case, fits.name, runs), *notes, spent]))
    sys.stdout.flush()
    return rows


def main(arguments: list[str] | None = None) -> int:
    """Run the benchmark from the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("families", nargs="*", default=["sindy", "neural_ode", "mlp_ensemble", "parametrised"])
    parser.add_argument("--groups", nargs="+", default=["cars", "emulated", "floors"], choices=GROUPS)
    parser.add_argument("--preset", default="quick")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--ways", nargs="+", default=WAYS, choices=WAYS)
    parser.add_argument("--keep", type=Path)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--read", type=Path, nargs="+", default=[])
    add_markdown(parser)
    options = parser.parse_args(arguments)
    if options.keep is not None:
        options.keep.mkdir(parents=True, exist_ok=True)
    write = sys.stdout.write
    rows = read_rows(options.read)
    if rows:
        found = f"{errors_table(rows)}\n\n{verdicts_table(rows)}"
        write(f"{found}\n")
        if options.markdown is not None:
            write_markdown(options.markdown, found)
        return 0
    for name in options.families:
        fits = Fits(name, options.preset, options.keep)
        for case in (case for group in options.groups for case in cases(group)):
            rows += report(case, fits, options.seeds, options.ways)
            if options.out is not None:
                write_rows(options.out, rows)
    write(f"\n{verdicts_table(rows)}\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
