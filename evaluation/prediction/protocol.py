"""The rules under which every model's prediction error is measured."""

from __future__ import annotations

from dataclasses import dataclass

from sysid_evo.errors import InvalidArgument


@dataclass(frozen=True)
class PredictionProtocol:
    """Which windows are simulated, which errors count, and how the intervals are drawn.

    A window starts at every ``stride``-th sample from sample ``first``, wherever the body moves, and is
    simulated freely for the longest of ``horizons`` (steps) under the recorded controls. A model is given
    as many earlier samples as it wants, if the record has them, but ``history`` at most. The error counts *at*
    each horizon, not averaged over the way to it, and only where the target moves. A free run starts at sample
    ``first`` of each episode and goes on to its end.

    Windows overlap, so intervals come from a bootstrap over blocks: ``block_windows`` consecutive
    windows, or ``block_samples`` consecutive samples of a free run, drawn ``resamples`` times.

    Predictions are clipped to ``guard_multiple`` times the largest absolute training value.
    """

    horizons: tuple[int, ...] = (1, 10, 20, 60)
    stride: int = 4
    history: int | None = None
    first: int = 5
    block_windows: int = 15
    block_samples: int = 100
    resamples: int = 1000
    confidence: float = 0.95
    guard_multiple: float = 2.0
    seed: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "horizons", tuple(sorted({int(horizon) for horizon in self.horizons})))
        if not self.horizons or self.horizons[0] < 1:
            raise InvalidArgument(f"protocol: expected horizons of one step or more, got {self.horizons}")
        for name in ("stride", "block_windows", "block_samples", "resamples"):
            if getattr(self, name) < 1:
                raise InvalidArgument(f"protocol: expected {name} >= 1, got {getattr(self, name)}")
        if not 0 <= self.given <= self.first:
            raise InvalidArgument(
                f"protocol: expected 0 <= history <= first, got history {self.history}, first {self.first}"
            )
        if not 0.0 < self.confidence < 1.0 or self.guard_multiple <= 0.0:
            raise InvalidArgument(
                "protocol: expected a confidence between 0 and 1 and a guard_multiple > 0, "
                f"got {self.confidence} and {self.guard_multiple}"
            )

    @property
    def given(self) -> int:
        """Earlier samples that every window has."""
        return self.first if self.history is None else self.history

    @property
    def history_in_words(self) -> str:
        """How much history models are given."""
        return "as much history as a model wants" if self.history is None else f"{self.history} samples of history"

    def describe(self, dt: float) -> str:
        """Return the rules in one sentence; ``dt`` is in seconds."""
        return (
            f"Free run under recorded controls from measured states with {self.history_in_words}; "
            f"starts every {self.stride} samples where the body moves; error at the horizon; dt {dt:g} s; "
            f"{100 * self.confidence:g} % intervals by bootstrap over blocks of {self.block_windows} windows."
        )
