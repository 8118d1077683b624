"""How often 90 % intervals over evolution seeds and trials hold the truth: ``python -m tests.benchmarks.nested``.

    python -m tests.benchmarks.nested [--repeats 1000] [--seeds 3 5 10] [--trials 10 100]

Fitness is made up: of a controller on a model the sum of a mean, of what the evolution seed does everywhere and on this
model, of what the trial does everywhere and on this model, and of noise. What seeds do is normal, skewed, or one of two
(``basins``: a search that ends forwards or backwards); or normal, and how far they differ from controller to controller
(``unequal``), or three times as far in the first controller as in all others (``odd``). For each figure of the first
controller the share of repetitions is printed in which its interval holds what is true over all seeds and trials: from
what all controllers together tell of seeds (`alike`), from its own seeds only, and, where asked for, that of a nested
percentile bootstrap.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Mapping

import numpy as np

from evaluation.transfer.nested import SHARE, Nested, alike, regrets
from sysid_evo.arrays import Array
from sysid_evo.registry import make_aggregate

MEANS = np.array([12.0, 11.0, 9.0, 8.0, 5.0])
"""Of the controller on five systems: where it was evolved, on other models, on a robot last but one."""
RIVALS = np.array([0.0, 0.5, -1.0, -3.0])
"""How much better than the controller its rivals are on every system."""
RESAMPLES = 200

METHODS = ("alike", "own seeds", "percentile")

KINDS: Mapping[str, Callable[[np.random.Generator, tuple[int, ...]], Array]] = {
    "normal": lambda rng, shape: rng.normal(size=shape),
    "skewed": lambda rng, shape: rng.exponential(size=shape) - 1.0,
    "basins": lambda rng, shape: rng.choice([-1.0, 1.0], size=shape),
    "no": lambda rng, shape: np.zeros(shape),
}
SCALES: Mapping[str, Callable[[np.random.Generator, int], Array]] = {
    "unequal": lambda rng, count: np.exp(0.7 * rng.normal(size=count)),
    "odd": lambda rng, count: np.where(np.arange(count) == 0, 3.0, 1.0),
}
"""How far normal seeds differ in each of several controllers."""


def made_up(kind: str, seeds: int, trials: int, rng: np.random.Generator) -> Array:
    """Return the fitness of the controller and its rivals on the systems, (controllers, systems, seeds, trials)."""
    controllers, systems = 1 + len(RIVALS), len(MEANS)
    effect = KINDS.get(kind, KINDS["normal"])
    scale = SCALES[kind](rng, controllers) if kind in SCALES else np.ones(controllers)
    means = MEANS + np.concatenate([[0.0], RIVALS])[:, None]
    of_trial = 0.8 * rng.normal(size=trials) + 0.5 * rng.normal(size=(systems, 1, trials))
    of_seed = effect(rng, (controllers, 1, seeds)) + 0.5 * effect(rng, (controllers, systems, seeds))
    noise = rng.normal(size=(controllers, systems, seeds, trials))
    found: Array = means[:, :, None, None] + (scale[:, None, None] * of_seed)[..., None] + of_trial + noise
    return found


def figures(fitness: Array, *, together: bool = True) -> dict[str, Nested]:
    """Return every figure of the first controller by its name; ``together`` with what the others tell of seeds."""
    names = [f"controller {number}" for number in range(len(fitness))]
    tell = alike if together else dict[str, Nested]
    claimed = {
        name: Nested.of(name, one[[0, 1]], make_aggregate("min")) for name, one in zip(names, fitness, strict=True)
    }
    on = [tell({name: Nested.of(name, one[[i]]) for name, one in zip(names, fitness, strict=True)}) for i in range(5)]
    gaps = tell({name: claimed[name] - on[3][name] for name in names})
    shares = tell({name: on[3][name].over(claimed[name]) for name in names})
    return {
        "achieved": on[3][names[0]],
        "claimed": tell(claimed)[names[0]],
        "gap": gaps[names[0]],
        "kept": shares[names[0]],
        "worst": min((one[names[0]] for one in on[2:]), key=lambda one: one.value),
        "regret": regrets(on[3])[names[0]],
    }


TRUTH = {"achieved": 8.0, "claimed": 11.0, "gap": 3.0, "kept": 8.0 / 11.0, "worst": 5.0, "regret": 0.5}


def resampled(fitness: Array, rng: np.random.Generator) -> dict[str, tuple[float, float]]:
    """Return the percentile intervals of a nested bootstrap: seeds are drawn, then trials, the same for all."""
    controllers, _, seeds, trials = fitness.shape
    drawn: dict[str, list[float]] = {name: [] for name in TRUTH}
    for _ in range(RESAMPLES):
        when = rng.integers(0, trials, trials)
        who = rng.integers(0, seeds, (controllers, seeds))
        own = fitness[0][:, who[0]][:, :, when].mean(axis=2)
        best = max(other[3, one][:, when].mean() for other, one in zip(fitness[1:], who[1:], strict=True))
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


def coverage(kind: str, seeds: int, trials: int, repeats: int, *, method: str = METHODS[0]) -> dict[str, float]:
    """Return for each figure how often its interval holds the truth; ``method`` is one of `METHODS`."""
    held = dict.fromkeys(TRUTH, 0)
    for repeat in range(repeats):
        rng = np.random.default_rng((repeat, seeds, trials))
        fitness = made_up(kind, seeds, trials, rng)
        found = (
            resampled(fitness, rng)
            if method == "percentile"
            else {name: one.interval() for name, one in figures(fitness, together=method == "alike").items()}
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
    parser.add_argument("--methods", choices=METHODS, nargs="+", default=METHODS[:2])
    given = parser.parse_args(arguments)
    for kind in (*KINDS, *SCALES):
        for seeds in given.seeds:
            for trials in given.trials:
                for method in given.methods:
                    shares = coverage(kind, seeds, trials, given.repeats, method=method)
                    told = "  ".join(f"{name} {100 * share:3.0f}" for name, share in shares.items())
                    sys.stdout.write(f"{kind:7s} {seeds:3d} seeds {trials:4d} trials  {method:10s}  {told}\n")
                    sys.stdout.flush()
    return 0


if __name__ == "__main__":
    sys.exit(main())
