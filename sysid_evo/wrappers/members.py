"""Several dynamics of one system that step side by side from the same state."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.dynamics import Dynamics
from sysid_evo.errors import IncompatibleSystem, InvalidArgument


class Members:
    """``models`` of one system: where their carries (n_carry) and their noise stand one after the other."""

    def __init__(self, models: Sequence[Dynamics]) -> None:
        self.models = tuple(models)
        self.system = self.models[0].system
        for model in self.models:
            differences = self.system.differences(model.system)
            if differences:
                raise IncompatibleSystem(f"several models: their systems differ: {'; '.join(differences)}")
            if model.observed_at != 0:
                raise InvalidArgument(
                    "several models: one is observed late; let it be observed so together with the others"
                )
        self.n_lags = max(model.n_lags for model in self.models)
        self.places = _places([model.n_carry for model in self.models])
        self.noise_places = _places([model.n_noise for model in self.models])
        self.draw_places = _places([model.n_draws for model in self.models])
        self.n_carry, self.n_noise, self.n_draws = (
            sum(getattr(model, name) for model in self.models) for name in ("n_carry", "n_noise", "n_draws")
        )

    def start(self, states: Array, controls: Array, draws: Array) -> Array:
        """Return the carries (B, n_carry) after a history, with ``draws`` (B, n_draws)."""
        carries = []
        for model, at in zip(self.models, self.draw_places, strict=True):
            lags = model.n_lags
            own_states, own_controls = states[:, states.shape[1] - 1 - lags :], controls[:, controls.shape[1] - lags :]
            carries.append(model.start(own_states, own_controls, draws[:, at : at + model.n_draws]))
        return np.concatenate(carries, axis=1)

    def step(self, state: Array, carries: Array, control: Array, noise: Array | None) -> tuple[Array, list[Array]]:
        """Return what each predicts from ``state`` (M, B, nx), and what each remembers beside its state."""
        nx = self.system.nx
        predicted, rests = [], []
        for model, at, drawn in zip(self.models, self.places, self.noise_places, strict=True):
            given = noise[:, drawn : drawn + model.n_noise] if noise is not None and model.n_noise else None
            after = model.step(
                np.concatenate([state, carries[:, at + nx : at + model.n_carry]], axis=1), control, given
            )
            predicted.append(after[:, :nx])
            rests.append(after[:, nx:])
        return np.stack(predicted), rests

    def joined(self, state: Array, rests: list[Array]) -> Array:
        """Return the carries (B, n_carry) of all, each with the same ``state`` (B, nx)."""
        return np.concatenate([part for rest in rests for part in (state, rest)], axis=1)


def _places(sizes: list[int]) -> list[int]:
    """Return where each of several parts begins that stand one after the other."""
    return [sum(sizes[:i]) for i in range(len(sizes))]
