"""How often 90 % intervals over evolution seeds and trials hold the truth: ``python -m tests.benchmarks.nested``.

    python -m tests.benchmarks.nested [--repeats 1000] [--seeds 3 5 10] [--trials 10 100]

Fitness is made up: of a controller on a model the sum of a mean, of what the evolution seed does everywhere and on this
model, of what the trial does everywhere and on this model, and of noise. What seeds do is normal, skewed, or one of two
(``basins``: a search that ends forwards or backwards). For each figure the share of repetitions is printed in which the
interval of `Nested` holds what is true over all seeds and trials, and that of a nested percentile bootstrap.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Mapping

import numpy as np

from evaluation.transfer.nested import SHARE, Nested, regrets
from sysid_evo.arrays import Array
from sysid_evo.registry import make_aggregate

MEANS = np.array([12.0, 11.0, 9.0, 8.0, 5.0])
"""Of the controller on five systems: where it was evolved, on other models, on a robot last but one."""
RIVALS = np.array([0.0, 0.5, -1.0, -3.0])
"""How much better than the controller its rivals are on the robot."""
RESAMPLES = 200

KINDS: Mapping[str, Callable[[np.random.Generator, tuple[int, ...]], Array]] = {
    "normal": lambda rng, shape: rng.normal(size=shape),
    "skewed": lambda rng, shape: rng.exponential(size=shape) - 1.0,
    "basins": lambda rng, shape: rng.choice([-1.0, 1.0], size=shape),
    "no": lambda rng, shape: np.zeros(shape),
}


def made_up(kind: str, seeds: int, trials: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return the fitness of the controller on the systems (5, seeds, trials), and of its rivals on the robot."""
    models, rivals = len(MEANS), len(RIVALS)
    of_trial = 0.8 * rng.normal(size=trials)
    on_model = 0.5 * rng.normal(size=(models, 1, trials))

    def drawn(means: Array, here: Array, own: Array) -> Array:
        count = len(means)
        there = 0.5 * KINDS[kind](rng, (count, seeds, 1))
        noise = rng.normal(size=(count, seeds, trials))
        found: Array = means[:, None, None] + own + there + of_trial + here + noise
        return found

    everywhere = KINDS[kind](rng, (1, seeds, 1))
    controller = drawn(MEANS, on_model, everywhere)
    others = drawn(MEANS[3] + RIVALS, on_model[[3]], KINDS[kind](rng, (rivals, seeds, 1)))
    return controller, others


def figures(controller: Array, others: Array) -> dict[str, Nested]:
    """Return every figure of the transfer matrix by its name."""
    achieved = Nested.of("c", controller[[3]])
    claimed = Nested.of("c", controller[[0, 1]], make_aggregate("min"))
    rivals = {f"rival {i}": Nested.of(f"rival {i}", one[None]) for i, one in enumerate(others)}
    systems = [Nested.of("c", controller[[i]]) for i in range(2, 5)]
    return {
        "achieved": achieved,
        "claimed": claimed,
        "gap": claimed - achieved,
        "kept": achieved.over(claimed),
        "worst": min(systems, key=lambda one: one.value),
        "regret": regrets({"c": achieved, **rivals})["c"],
    }


TRUTH = {"achieved": 8.0, "claimed": 11.0, "gap": 3.0, "kept": 8.0 / 11.0, "worst": 5.0, "regret": 0.5}


def resampled(controller: Array, others: Array, rng: np.random.Generator) -> dict[str, tuple[float, float]]:
    """Return the percentile intervals of a nested bootstrap: seeds are drawn, then trials, the same for all."""
    _, seeds, trials = controller.shape
    drawn: dict[str, list[float]] = {name: [] for name in TRUTH}
    for _ in range(RESAMPLES):
        when = rng.integers(0, trials, trials)
        who = rng.integers(0, seeds, (1 + len(others), seeds))
        own = controller[:, who[0]][:, :, when].mean(axis=2)
        best = max(other[one][:, when].mean() for other, one in zip(others, who[1:], strict=True))
        claimed, achieved = own[:2].min(axis=0).mean(), own[3].mean()
        values = (
            achieved,
            claimed,
            claimed - achieved,
            achieved / claimed,
            own[2:].mean(axis=1).min(),
            best - achieved,
        )
        for name, value in zip(TRUTH, values, strict=True):
            drawn[name].append(float(value))
    ends = [0.5 - SHARE / 2.0, 0.5 + SHARE / 2.0]
    return {name: tuple(np.quantile(values, ends)) for name, values in drawn.items()}


def coverage(kind: str, seeds: int, trials: int, repeats: int, *, bootstrap: bool = False) -> dict[str, float]:
    """Return for each figure how often its interval holds the truth."""
    held = dict.fromkeys(TRUTH, 0)
    for repeat in range(repeats):
        rng = np.random.default_rng((repeat, seeds, trials))
        controller, others = made_up(kind, seeds, trials, rng)
        found = (
            resampled(controller, others, rng)
            if bootstrap
            else {name: one.interval() for name, one in figures(controller, others).items()}
        )
        for name, (low, high) in found.items():
            held[name] += low <= TRUTH[name] <= high
    return {name: count / repeats for name, count in held.items()}


def main(arguments: list[str] | None = None) -> int:
    """Print the coverage of every figure."""
    parser = argparse.ArgumentParser(prog="tests.benchmarks.nested", description=__doc__)
    parser.add_argument("--repeats", type=int, default=1000)
    parser.add_argument("--seeds", type=int, nargs="+", default=[3, 5, 10])
    parser.add_argument("--trials", type=int, nargs="+", default=[10, 100])
    parser.add_argument("--no-bootstrap", action="store_true", help="leave the nested percentile bootstrap out")
    given = parser.parse_args(arguments)
    for kind in KINDS:
        for seeds in given.seeds:
            for trials in given.trials:
                for bootstrap in (False,) if given.no_bootstrap else (False, True):
                    repeats = given.repeats // 4 if bootstrap else given.repeats
                    shares = coverage(kind, seeds, trials, repeats, bootstrap=bootstrap)
                    told = "  ".join(f"{name} {100 * share:3.0f}" for name, share in shares.items())
                    method = "percentile" if bootstrap else "nested"
                    sys.stdout.write(f"{kind:7s} {seeds:3d} seeds {trials:4d} trials  {method:10s}  {told}\n")
                    sys.stdout.flush()
    return 0


if __name__ == "__main__":
    sys.exit(main())
