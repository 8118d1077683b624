"""Any family on a long past: earlier outputs and controls, thinned to powers of two, are its further controls."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np

from model_zoo.validation.held_out import HeldOut, best, trials
from sysid_evo import Channel, Dataset, DynamicsModel, System, register_model
from sysid_evo.arrays import Array
from sysid_evo.data import Trajectory
from sysid_evo.errors import IncompatibleSystem
from sysid_evo.hyperparameters import Limit, at_least
from sysid_evo.progress import Counter, Progress
from sysid_evo.registry import Spec, make_model

if TYPE_CHECKING:
    from sysid_evo.engine.kernels import Predictor

OFFERED = (1, 3, 15, 63)
EPISODE_SHARE = 12
"""The past takes at most one part in so many of the longest episode."""
TABLES = ("levels", "evolved3", "parametrised")
"""Families with one of these, as a hyper-parameter or by name, keep something for each command, or for a car."""


@register_model("delay_embedding")
class DelayEmbedding(DynamicsModel):
    """The model ``family``, whose controls are the control now and means of the past: 1, 2-3, 4-7, 8-15, ... ago.

    Takens (1981): what is not measured is in the past of what is. Means over times that double hold a long past in
    few numbers, and average its noise. ``longest`` samples (rounded up to 2^j - 1) of outputs and of controls are
    remembered; None chooses among 1, 3, 15 and 63 by free runs on held-out blocks of time. ``family`` is any text
    for `make_model`, such as ``mlp_ensemble(members=3)``; its own lags are 0 unless the text says otherwise. Families
    that keep a table or a network for each command are refused, since every further control would multiply them.
    """

    knowledge = "black"
    presets: ClassVar[dict[str, dict[str, Any]]] = {"quick": {"folds": 1}}
    limits: ClassVar[dict[str, Limit]] = {"longest": at_least(1), "folds": at_least(1, at_most=3)}
    state_lags = None
    control_lags = None

    family: str = "narx"
    longest: int | None = None
    folds: int = 2
    rest_hold: bool = False
    most_steps: int | None = 100_000

    def check_system(self, system: System) -> None:
        inner = self._inner()
        inner.check_system(_further(system, 1))

    def uses(self) -> tuple[str, ...]:
        return (Spec.parse(self.family).name,)

    def fit(self, dataset: Dataset, *, rng: np.random.Generator, progress: Progress | None = None) -> Self:
        room = max(len(episode) for episode in dataset.episodes) // EPISODE_SHARE
        offered = [pasts for pasts in OFFERED if pasts <= room] or [1]
        offered = offered if self.longest is None else [2 ** int(np.ceil(np.log2(self.longest + 1))) - 1]
        counter = Counter(progress, trials(offered) * self.folds + 1)
        blocks = HeldOut.of(dataset, self.folds)
        seed = int(rng.integers(2**32))

        def learned(part: Dataset, longest: int) -> DynamicsModel:
            trial = self.variant(longest=longest)
            trial._learn(part, longest, seed, lambda: counter.advance(0))
            return trial

        def error(longest: int) -> float:
            return blocks.error(lambda part: learned(part, longest), told=counter.advance)

        self._learn(dataset, best(offered, error), seed, lambda: counter.advance(0))
        counter.advance()
        return self

    def _learn(self, dataset: Dataset, longest: int, seed: int, still: Callable[[], None]) -> None:
        self.keep_lags((longest, longest))
        system = _further(dataset.system, longest)
        episodes = []
        for episode in (episode for episode in dataset.episodes if len(episode) > longest):
            windows = dataset.with_episodes([episode]).windows(1, history=longest)
            carry = self.lagged(windows.past_states, windows.past_controls)
            controls = self._seen(carry, windows.controls[:, 0])
            episodes.append(Trajectory(episode.states[longest:], controls, episode.dt, name=episode.name))
        inner = self._inner()
        inner.fit(Dataset(system, tuple(episodes)), rng=np.random.default_rng(seed), progress=lambda *_: still())
        if inner.n_carry != system.nx or inner.n_noise:
            raise IncompatibleSystem(
                f"delay_embedding: expected a family that remembers nothing and adds no noise, got {self.family}: it "
                f"has {inner.n_carry - system.nx} numbers beside the states and {inner.n_noise} of noise"
            )
        self.model_ = inner

    def _inner(self) -> DynamicsModel:
        """Return the family that learns, without lags of its own and not yet fitted."""
        spec = Spec.parse(self.family)
        model = make_model(spec.text)
        known = model.get_params()
        if "levels" in known or spec.name in TABLES:
            raise IncompatibleSystem(
                f"delay_embedding: {spec.name} keeps something for each command, and the past would be further "
                "commands; take another family, such as narx, mlp_ensemble or gaussian_process"
            )
        own = {name: 0 for name in ("state_lags", "control_lags") if name in known and name not in spec.parameters}
        inner: DynamicsModel = model.set_params(**own)
        return inner

    def next_state(self, carry: Array, control: Array) -> Array:
        after: Array = self.model_.step(carry[:, : self.system.nx], self._seen(carry, control))
        return after

    def _seen(self, carry: Array, control: Array) -> Array:
        """Return the controls of the inner model: those now, then means of the past over times that double."""
        layout, longest = self.layout, self.lags[0]
        begins = 2 ** np.arange((longest + 1).bit_length() - 1) - 1
        parts = [control]
        for past, count in (
            (carry[:, layout.nx : layout.earlier_controls.start], layout.nx),
            (carry[:, layout.earlier_controls], layout.nu),
        ):
            by_age = past.reshape(len(carry), longest, count)
            means = np.add.reduceat(by_age, begins, axis=1) / (begins + 1)[:, None]
            parts.append(means.reshape(len(carry), -1))
        return np.concatenate(parts, axis=1)

    def predictor(self) -> Predictor | None:
        from model_zoo.kernels.past import with_past

        kernel = self.model_.kernel()
        return None if kernel is None else with_past(kernel, self.system.nx, self.system.nu, self.lags[0])


def _further(system: System, longest: int) -> System:
    """Return ``system`` with means of the past among its controls."""
    channels = []
    begins = [2**j for j in range((longest + 1).bit_length() - 1)]
    for own in (system.states, system.controls):
        for begin in begins:
            channels += [_mean_channel(channel, begin, 2 * begin - 1) for channel in own]
    return replace(system, controls=(*system.controls, *channels))


def _mean_channel(channel: Channel, newest: int, oldest: int) -> Channel:
    return Channel(f"{channel.name}_{newest}_to_{oldest}_ago", channel.unit)
