"""A simulation that contains networks, its gradient by backpropagation through time, and its training.

Inputs are standardised features; training excludes held-out blocks of time.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import ClassVar

import numpy as np

from model_zoo.networks.network import Array32, Layers, Network, random_network
from model_zoo.networks.training import (
    Batches,
    ResumableTrainings,
    TrainingSchedule,
    TrainingState,
    TrainingWindows,
    schedule,
    step_weights,
)
from model_zoo.scaling import ChannelScaling, Mirror
from sysid_evo.angles import TURN
from sysid_evo.carry import CarryLayout
from sysid_evo.data import Dataset
from sysid_evo.types import Array
from sysid_evo.validation.simulation_error import error_windows


class DifferentiableSimulation(ABC):
    """Simulation of ``members`` random networks with ``further`` inputs in addition to `Features`, and its gradient.

    The networks give nx rates, in units of each state's RMS change in one step, per second. The ``further`` input, if
    any, is ``flag`` (M, B or 1, 1): 1 for data as recorded, -1 for mirrored data (``mirror``). Each step calls the
    network ``calls`` times, at different states. Derived classes define a step (`advance`) and its gradient
    (`pull_back`).
    """

    calls: ClassVar[int] = 1

    def __init__(
        self,
        dataset: Dataset,
        lags: tuple[int, int],
        *,
        hidden: Sequence[int],
        rng: np.random.Generator,
        members: int = 1,
        further: int = 0,
        mirror: Mirror | None = None,
    ) -> None:
        self.system = dataset.system
        self.motion = self.system.motion_gradient()
        self.layout = CarryLayout(self.system.nx, self.system.nu, *lags)
        self.standard = ChannelScaling.of(dataset, mirror)
        self.centre, self.scale = self.standard.of_inputs(self.layout)
        self.rates = self.standard.change / self.system.dt
        self.layers = Layers(
            [len(self.centre) + further, *hidden, self.system.nx],
            members,
            centre=np.concatenate([self.centre, np.zeros(further)]),
            scale=np.concatenate([self.scale, np.ones(further)]),
            output_scale=self.rates,
        )
        self.parameters = self.layers.flat(random_network(self.layers.sizes, members, rng))
        self.mirror = mirror
        self.flag: Array32 = np.ones((1, 1, further), dtype=np.float32)
        self.recorded = self.flag

    def run(self, samples: Array32) -> Array32:
        """Return the states (H, M, B, nx) of simulations that start from the history in a batch, under its controls."""
        self.layers.take(self.parameters)
        history, nx = self.layout.n_lags, self.system.nx
        members, batch, horizon = *samples.shape[1:3], len(samples) - 1 - history
        self.states: Array32 = np.empty((len(samples), members, batch, nx), dtype=np.float32)
        self.states[: history + 1] = samples[: history + 1, ..., :nx]
        controls = samples[:-1, ..., nx:]
        self.controls: Array32 = controls[history:]
        inputs = self.layers.reserve(horizon * self.calls, batch)
        self.inputs: Array32 = inputs.reshape(horizon, self.calls, *inputs.shape[1:])
        self._fill_controls(controls)
        self.prepare(horizon)
        for step in range(horizon):
            self._fill_earlier_states(step)
            self.states[history + step + 1] = self.advance(step, self.states[history + step])
        return self.states[history + 1 :]

    def gradient(self, by_states: Array32) -> Array32:
        """Return the gradient (M, P) of a scalar, from its gradient by the states (H, M, B, nx) of the last run."""
        by_after = by_states.copy()
        self.by_seen: Array32 = np.zeros((*by_after.shape[:3], self._n_seen), dtype=np.float32)
        for step in range(len(by_after) - 1, -1, -1):
            by_state = self.pull_back(step, by_after[step])
            if step:
                by_after[step - 1] += by_state
                if self.layout.state_lags:
                    state = self.states[self.layout.n_lags + step]
                    by_after[step - 1] += self._pulled_to_state(state, self.by_seen[step])
        return self.layers.gradient()

    def prepare(self, horizon: int) -> None:
        """Allocate memory for a run of this many steps."""
        return

    @abstractmethod
    def advance(self, step: int, state: Array32) -> Array32:
        """Return the state (M, B, nx) after ``step``."""

    @abstractmethod
    def pull_back(self, step: int, gradient: Array32) -> Array32:
        """Return the gradient by the state before ``step``, from that by the state after it (M, B, nx)."""

    def network_output(self, step: int, call: int, state: Array32) -> Array32:
        """Return the network outputs (M, B, nx) in one of the calls of ``step``, for this present state."""
        self.inputs[step, call, ..., : self._n_seen] = self._seen(state)
        return self.layers.forward(step * self.calls + call)

    def backpropagated(self, step: int, call: int, state: Array32, gradient: Array32) -> Array32:
        """Return the gradient by the present state of a call, from that by the network outputs (M, B, nx)."""
        seen, lags = self._n_seen, self.layout.state_lags
        if step == call == 0:  # the state is measured
            self.layers.backward(0, gradient, 0)
            return np.zeros_like(state)
        by_inputs = self.layers.backward(step * self.calls + call, gradient, seen * (1 + lags))
        for lag in range(1, min(lags, step) + 1):
            self.by_seen[step - lag] += by_inputs[..., seen * lag : seen * (lag + 1)]
        return self._pulled_to_state(state, by_inputs[..., :seen])

    def augmented(self, samples: Array32, rng: np.random.Generator) -> Array32:
        """Return a batch (L + 1 + H, M, B, nx + nu) for training: half of the windows are mirrored."""
        if self.mirror is None:
            return samples
        mirrored = rng.random((*samples.shape[1:3], 1), dtype=np.float32) < 0.5
        self.flag = np.where(mirrored, np.float32(-1.0), np.float32(1.0))
        signs = np.concatenate([self.mirror.states, self.mirror.controls]).astype(np.float32)
        return np.asarray(samples * np.where(mirrored, signs, np.float32(1.0)))

    def learn(
        self,
        splits: Sequence[tuple[Dataset, Dataset]],
        plan: TrainingSchedule,
        trainings: ResumableTrainings,
    ) -> tuple[Array32, Array]:
        """Train on the first parts of the splits; return the best parameters and their errors (M,) on the others."""
        history = self.layout.n_lags
        held = []
        for _, part in splits:
            windows = error_windows(part, history)
            held.append(TrainingWindows.at(part, windows.episode, windows.start, windows.states.shape[1]))

        def validate(parameters: Array32) -> Array:
            return validation_errors(self, parameters, held)

        learned = train(
            self,
            [TrainingWindows.of(part, plan.horizon, history) for part, _ in splits],
            plan,
            trainings=trainings,
            validate=validate,
        )
        return learned, validate(learned)

    def network(self, parameters: Array32) -> Network:
        """Return ``parameters`` (M, P) as networks of features of (carry, control), with the ``further`` input at 1."""
        known = len(self.centre)
        learned = self.layers.network(parameters)
        weights, biases = list(learned.weights), list(learned.biases)
        biases[0] = biases[0] + weights[0][:, known:].sum(axis=1)
        weights[0] = weights[0][:, :known]
        return Network(weights, biases).folded(self.centre, self.scale, self.rates)

    def start_from(self, network: Network) -> None:
        """Undo `network`: start from networks that do not use the ``further`` input."""
        scaled = network.unfolded(self.centre, self.scale, self.rates)
        more = self.layers.sizes[0] - len(self.centre)
        first = np.pad(scaled.weights[0], ((0, 0), (0, more), (0, 0)))
        flat = self.layers.flat(Network([first, *scaled.weights[1:]], scaled.biases))
        self.parameters = np.concatenate([flat, self.parameters[:, self.layers.size :]], axis=1)

    def fine_tune(self, dataset: Dataset, plan: TrainingSchedule, trainings: ResumableTrainings) -> Array32:
        """Continue training of all members on the whole ``dataset``; return the parameters (M, P)."""
        windows = TrainingWindows.of(dataset, plan.horizon, self.layout.n_lags)
        return train(self, [windows] * self.layers.members, plan, trainings=trainings)

    @property
    def _n_seen(self) -> int:
        """Number of features of one state."""
        return len(self.standard.seen_centre)

    def _fill_controls(self, controls: Array32) -> None:
        """Write the controls (L + H, M, B, nu), and the flag, into the inputs of all steps."""
        history, horizon, nu = self.layout.n_lags, len(self.inputs), self.system.nu
        place = self._n_seen * (1 + self.layout.state_lags)
        for lag in (*range(1, self.layout.control_lags + 1), 0):
            begin = history - lag
            self.inputs[..., place : place + nu] = controls[begin : begin + horizon, None]
            place += nu
        self.inputs[..., place:] = self.flag

    def _fill_earlier_states(self, step: int) -> None:
        """Write the features of earlier states into the inputs of one step."""
        seen, history = self._n_seen, self.layout.n_lags
        for lag in range(1, self.layout.state_lags + 1):
            known = step >= lag
            earlier = self.inputs[step - lag, 0, ..., :seen] if known else self._seen(self.states[history + step - lag])
            self.inputs[step, ..., seen * lag : seen * (lag + 1)] = earlier

    def _seen(self, states: Array32) -> Array32:
        """Return the features of states (..., nx)."""
        return self.system.regressors(states) if self.system.periods else states

    def _pulled_to_state(self, state: Array32, gradient: Array32) -> Array32:
        """Return the gradient by states (..., nx) from that by their features."""
        if not self.system.periods:
            return gradient
        columns, place = [], 0
        for i in range(self.system.nx):
            if i in self.system.periods:
                turns = np.float32(TURN / self.system.periods[i])
                angle, by_sine, by_cosine = turns * state[..., i], gradient[..., place], gradient[..., place + 1]
                columns.append(turns * (np.cos(angle) * by_sine - np.sin(angle) * by_cosine))
                place += 2
            else:
                columns.append(gradient[..., place])
                place += 1
        return np.stack(columns, axis=-1)


REPORT_EVERY = 10
"""Updates between two reports of progress."""

CHUNK = 256
"""Windows scored at once."""


def train(
    model: DifferentiableSimulation,
    windows: Sequence[TrainingWindows],
    plan: TrainingSchedule,
    *,
    trainings: ResumableTrainings,
    validate: Callable[[Array32], Array] | None = None,
) -> Array32:
    """Train ``model`` on one set of ``windows`` for each member and return its averaged parameters (M, P).

    ``validate`` gives the validation error (M,) of parameters; each member then keeps its best ones.
    ``trainings`` resumes a training that was interrupted and returns the result of one that had finished.
    """
    done = trainings.ended()
    if done is not None:
        trainings.report(plan.total)
        return done
    rng, layout, batches = trainings.rng, model.layout, Batches(windows, model.layout.n_lags)
    state = TrainingState.at(model.parameters)
    scale = model.standard.state_scale.astype(np.float32)
    noise = (plan.input_noise * model.standard.change).astype(np.float32)
    longest = min(one.horizon for one in windows)
    present = slice(layout.n_lags - layout.state_lags, layout.n_lags + 1)
    first = reported = trainings.resume(state)
    if first:
        trainings.report(first)
    for update in range(first, plan.total):
        horizon, size, rate = schedule(plan, update, longest)
        batch = batches.drawn(rng, size, horizon)
        batch = model.augmented(batch, rng)
        truth = batch[layout.n_lags + 1 :, ..., : layout.nx].copy()
        if plan.input_noise:
            measured = batch[present, ..., : layout.nx]
            measured += noise * rng.standard_normal(measured.shape, dtype=np.float32)
        off = (model.run(batch) - truth) / scale
        error = (off**2).mean(axis=(2, 3))
        off *= (2.0 / (off.shape[2] * off.shape[3]) * step_weights(error))[:, None, None, None] / scale
        state.descend(model.gradient(off) + 2.0 * plan.weight_decay * model.parameters, rate)
        state.average(min(plan.averaging, (update + 1) / (update + 10)))
        last = update + 1 == plan.total
        if validate is not None and (last or (update + 1) % plan.check_every == 0):
            state.keep(validate(state.mean))
        if last or update % REPORT_EVERY == 0:
            trainings.reached(update + 1, state)
            trainings.report(update + 1 - reported)
            reported = update + 1
    found = state.mean if validate is None else state.best
    trainings.end(found)
    return found


def validation_errors(model: DifferentiableSimulation, parameters: Array32, held: Sequence[TrainingWindows]) -> Array:
    """Return the simulation error (M,) of each member over its own windows: RMSE / scale, averaged over all.

    Infinite if a simulation is not finite. A member with fewer windows repeats some, which do not count.
    """
    trained, layout, batches = model.parameters, model.layout, Batches(held, model.layout.n_lags)
    scale = model.standard.state_scale
    model.flag = model.recorded
    model.parameters = parameters
    most, longest = max(len(windows) for windows in held), max(windows.horizon for windows in held)
    square: list[Array] = [np.zeros((windows.horizon, layout.nx)) for windows in held]
    for begin in range(0, most, CHUNK):
        rows = np.arange(begin, min(begin + CHUNK, most))
        batch = batches.of([rows % len(windows) for windows in held], longest)
        with np.errstate(all="ignore"):
            off = ((model.run(batch) - batch[layout.n_lags + 1 :, ..., : layout.nx]) / scale) ** 2
        for member, windows in enumerate(held):
            square[member] += off[: windows.horizon, member, : max(0, len(windows) - begin)].sum(axis=1)
    model.parameters = trained
    errors = [float(np.sqrt(sums / len(windows)).mean()) for sums, windows in zip(square, held, strict=True)]
    return np.where(np.isfinite(errors), errors, np.inf)
