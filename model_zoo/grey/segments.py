"""The pieces of a recording that a grey box is fitted to, and its free runs in them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from model_zoo.channels.standard import positive
from model_zoo.grey.compiled import kernel_parameters, structure_kernel
from model_zoo.grey.observer import follow
from model_zoo.grey.structure import Structure
from sysid_evo.arrays import Array, IntArray
from sysid_evo.cross_validation import recording
from sysid_evo.data import Dataset, Windows
from sysid_evo.engine.compiled.open_loop import free_runs
from sysid_evo.errors import InvalidData
from sysid_evo.kernels import DynamicsKernel

FEWEST = 60
"""Windows that a short recording is cut into, which then overlap."""


@dataclass(frozen=True)
class Segments:
    """W windows of H steps with what is measured in them, and the ``group`` (condition, or recording) of each, (W,).

    ``scale`` (nx,) is the spread of every state, in which errors are counted; ``limits`` (2, nx) are where free runs
    are clipped; ``order`` (W,) is when each window begins, in steps since the first episode began.
    """

    windows: Windows
    scale: Array
    limits: Array
    group: IntArray
    groups: tuple[str, ...]
    order: IntArray

    @classmethod
    def of(cls, dataset: Dataset, horizon: int, *, history: int, most: int, limits: Array) -> Segments:
        """Cut ``most`` windows or fewer, evenly over the recording, wherever the system moves; they overlap if few."""
        longest = max(len(episode) for episode in dataset.episodes) - history
        if longest < 1:
            raise InvalidData(f"data set: no episode is longer than {history} steps, the history asked for")
        horizon = min(horizon, longest)
        room = sum(max(0, len(episode) - history - horizon + 1) for episode in dataset.episodes)
        stride = max(1, min(horizon, room // FEWEST))
        places = dataset.window_places(horizon, stride=stride, history=history, moving=True)
        if len(places) < FEWEST // 2:
            places = dataset.window_places(horizon, stride=stride, history=history)
        rows = np.unique(np.linspace(0, len(places) - 1, min(most, len(places))).round().astype(np.int64))
        windows = places[rows]
        names = [episode.condition or recording(episode.name) for episode in dataset.episodes]
        groups = tuple(dict.fromkeys(names))
        group = np.array([groups.index(name) for name in names], dtype=np.int64)
        begins = np.cumsum([0, *(len(episode) for episode in dataset.episodes)])[:-1]
        scale = positive(dataset.system.spread(np.concatenate([episode.states for episode in dataset.episodes])))
        return cls(windows, scale, limits, group[windows.episode], groups, begins[windows.episode] + windows.start)

    def __len__(self) -> int:
        return len(self.windows)

    def __getitem__(self, rows: IntArray) -> Segments:
        """Return some of the windows."""
        return replace(self, windows=self.windows[rows], group=self.group[rows], order=self.order[rows])

    def runs(self, structure: Structure, p: Array, hidden: Array) -> Array:
        """Return free runs (P, W, H, nx) with parameters (n, P, 1 or W), from ``hidden`` states (n, P or 1, W).

        Compiled where the motion has a compiled form. Where parameters differ from window to window, they are the same
        in all of a group.
        """
        w = self.windows
        if p.shape[2] > 1:
            out = np.empty((p.shape[1], *w.states.shape))
            for number in range(len(self.groups)):
                rows = np.flatnonzero(self.group == number)
                if len(rows):
                    out[:, rows] = self[rows].runs(structure, p[:, :, rows[:1]], hidden[:, :, rows])
            return out
        with np.errstate(all="ignore"):
            carry = structure.start(p, w.past_states, w.past_controls, hidden)
            carry = np.broadcast_to(carry, (len(carry), *np.broadcast_shapes(p.shape[1:], carry.shape[1:])))
            kernel = self._kernel(structure)
            if kernel is None:
                return self._stepped(structure, p, carry)
        own = kernel_parameters(structure, p[:, :, 0].T)
        start = np.moveaxis(carry, 0, -1)
        return free_runs(
            kernel.source,
            kernel.n_scratch,
            kernel.of_candidates(own),
            start,
            w.controls,
            self.limits,
            precision=kernel.precision,
        )

    def _kernel(self, structure: Structure) -> DynamicsKernel | None:
        guess = np.array([parameter.guess for parameter in structure.parameters])
        return structure_kernel(structure, guess)

    def _stepped(self, structure: Structure, p: Array, carry: Array) -> Array:
        """Return the same in NumPy, from carries (n_carry, P, W)."""
        controls, nx = self.windows.controls, structure.system.nx
        low, high = (side.reshape(-1, 1, 1) for side in self.limits)
        out = np.empty((*carry.shape[1:], controls.shape[1], nx))
        for k in range(controls.shape[1]):
            after, past = structure.step(p, carry, controls[:, k].T[:, None])
            after[:nx] = np.fmin(np.fmax(after[:nx], low), high)
            after[nx:] = np.nan_to_num(after[nx:])
            carry, out[:, :, k] = np.concatenate([after, past]), np.moveaxis(after[:nx], 0, -1)
        return out

    def errors(self, structure: Structure, p: Array, hidden: Array) -> Array:
        """Return the errors (P, W, H * nx) of these runs in units of ``scale``, of angles the shortest way round."""
        off = structure.system.difference(self.runs(structure, p, hidden), self.windows.states) / self.scale
        return off.reshape(*off.shape[:2], -1)

    def followed(self, structure: Structure, p: Array) -> Array:
        """Return the hidden states (n, P, W) at the start of the windows, after a history that begins at rest.

        All other states are the measured ones throughout.
        """
        w, rows = self.windows, structure.hidden_rows
        rest = np.array([hidden.initial for hidden in structure.hidden])[:, None, None]
        with np.errstate(all="ignore"):
            found = follow(structure, p, w.past_states, w.past_controls, rest)
        low, high = structure.extended.limits[:, rows, None, None]
        return np.clip(np.nan_to_num(found), low, high)
