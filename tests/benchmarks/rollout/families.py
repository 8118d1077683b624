"""The models that are timed: small, quickly fitted, with a NumPy step written for speed and a kernel.

Hidden layers are random and only the last layer is fitted, by least squares: that takes milliseconds
and drives like a trained network. Two families are those of the model zoo.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hardware.robot import Robot
from model_zoo.command_cells import CommandCells
from model_zoo.nearest_neighbour import NearestNeighbour
from model_zoo.parametrised import Parametrised
from sysid_evo.arrays import Array
from sysid_evo.data import Dataset
from sysid_evo.dynamics import Dynamics, training_envelope
from sysid_evo.engine.compiled.kernel import DynamicsKernel
from sysid_evo.engine.kernels import (
    command_network_predictor,
    network_predictor,
    polynomial_predictor,
    runge_kutta_predictor,
    separate_networks_predictor,
    stepping_kernel,
)
from sysid_evo.registry import make_robot

HIDDEN = 10


@dataclass(frozen=True)
class Case:
    """A model under the name of its row."""

    name: str
    dynamics: Dynamics


class Fitted(Dynamics):
    """A model of the state alone, clipped to twice the range of its data."""

    def __init__(self, dataset: Dataset) -> None:
        self.system = dataset.system
        self.n_carry = self.system.nx
        self.limits = training_envelope(np.concatenate([episode.states for episode in dataset.episodes]), 2.0)
        data = dataset.transitions()
        self.fit(data.carry, data.control, data.after)

    @property
    def envelope(self) -> Array:
        return self.limits

    def start(self, states: Array, controls: Array, draws: Array | None = None) -> Array:
        return states[:, -1].copy()

    def fit(self, state: Array, control: Array, after: Array) -> None:
        """Learn from transitions (N, nx), (N, nu), (N, nx)."""
        raise NotImplementedError


class SeparateNetworks(Fitted):
    """One network of ten hidden units for each acceleration: three 5-10-1 networks."""

    def fit(self, state: Array, control: Array, after: Array) -> None:
        inputs, nx = np.concatenate([state, control], axis=1), state.shape[1]
        self.first, self.first_bias = random_layer(inputs, nx * HIDDEN)
        units = np.tanh(inputs @ self.first + self.first_bias)
        self.second, self.second_bias = np.zeros((nx * HIDDEN, nx)), np.zeros(nx)
        target = self.system.acceleration(state, after)
        for k in range(nx):
            own = slice(k * HIDDEN, (k + 1) * HIDDEN)
            self.second[own, k], self.second_bias[k] = last_layer(units[:, own], target[:, k])

    def step(self, carry: Array, control: Array, noise: Array | None = None) -> Array:
        units = np.tanh(np.concatenate([carry, control], axis=1) @ self.first + self.first_bias)
        return self.system.integrate(carry, units @ self.second + self.second_bias)

    def kernel(self) -> DynamicsKernel:
        networks = []
        for k in range(self.system.nx):
            own = slice(k * HIDDEN, (k + 1) * HIDDEN)
            hidden = (self.first[:, own], self.first_bias[own])
            networks.append([hidden, (self.second[own, k : k + 1], self.second_bias[k : k + 1])])
        predictor = separate_networks_predictor(networks, self.system.nx, self.system.nu)
        return stepping_kernel(predictor, self.system, output="acceleration")


class CommandNetworks(Fitted):
    """One network of ten hidden units for each command and next state: 27 networks 3-10-1."""

    def fit(self, state: Array, control: Array, after: Array) -> None:
        self.cells = CommandCells.of(self.system, 3)
        cell, nx = self.cells.index(control), state.shape[1]
        count = self.cells.count
        self.first, self.first_bias = np.zeros((count, nx, nx * HIDDEN)), np.zeros((count, nx * HIDDEN))
        self.second, self.second_bias = np.zeros((count, nx * HIDDEN, nx)), np.zeros((count, nx))
        for number in range(count):
            rows = np.flatnonzero(cell == number)
            self.first[number], self.first_bias[number] = random_layer(state, nx * HIDDEN, seed=number)
            units = np.tanh(state[rows] @ self.first[number] + self.first_bias[number])
            for k in range(nx):
                own = slice(k * HIDDEN, (k + 1) * HIDDEN)
                self.second[number, own, k], self.second_bias[number, k] = last_layer(units[:, own], after[rows, k])

    def step(self, carry: Array, control: Array, noise: Array | None = None) -> Array:
        cell = self.cells.index(control)
        order = np.argsort(cell, kind="stable")
        edges = np.searchsorted(cell[order], np.arange(self.cells.count + 1))
        after, sorted_carry = np.empty_like(carry), carry[order]
        for number, (begin, end) in enumerate(itertools.pairwise(edges)):
            if begin < end:
                units = np.tanh(sorted_carry[begin:end] @ self.first[number] + self.first_bias[number])
                after[order[begin:end]] = units @ self.second[number] + self.second_bias[number]
        return after

    def kernel(self) -> DynamicsKernel:
        count, nx = self.cells.count, self.system.nx
        blocks = self.second.reshape(count, nx, HIDDEN, nx)
        predictor = command_network_predictor(
            self.first.reshape(count, nx, nx, HIDDEN).transpose(0, 2, 1, 3),
            self.first_bias.reshape(count, nx, HIDDEN),
            np.stack([blocks[:, k, :, k] for k in range(nx)], axis=1),
            self.second_bias,
            np.arange(count),
            self.cells.midpoints,
            self.cells.exact,
            nx,
        )
        return stepping_kernel(predictor, self.system, output="next_state")


class Derivative(Fitted):
    """A model of dx/dt, integrated by the classical Runge-Kutta method under a held control."""

    substeps = 1

    def derivative(self, state: Array, control: Array) -> Array:
        """Return dx/dt (B, nx)."""
        raise NotImplementedError

    def step(self, carry: Array, control: Array, noise: Array | None = None) -> Array:
        h = self.system.dt / self.substeps
        for _ in range(self.substeps):
            k1 = self.derivative(carry, control)
            k2 = self.derivative(carry + 0.5 * h * k1, control)
            k3 = self.derivative(carry + 0.5 * h * k2, control)
            k4 = self.derivative(carry + h * k3, control)
            carry = carry + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        return carry


class CubicPolynomial(Derivative):
    """The 56 monomials of five variables up to degree three; a third of the coefficients is not zero."""

    def fit(self, state: Array, control: Array, after: Array) -> None:
        n = state.shape[1] + control.shape[1]
        pairs = [(i, j) for i in range(n) for j in range(i, n)]
        self.pair = np.array(pairs).T
        triples = [(p, k) for p, (_, j) in enumerate(pairs) for k in range(j, n)]
        self.triple = np.array(triples).T
        ones = np.eye(n, dtype=np.int64)
        squares = ones[self.pair[0]] + ones[self.pair[1]]
        self.powers = np.concatenate(
            [np.zeros((1, n), int), ones, squares, squares[self.triple[0]] + ones[self.triple[1]]]
        )
        terms, target = self.monomials(state, control).T, (after - state) / self.system.dt
        scale = terms.std(axis=0) + (np.arange(len(self.powers)) == 0)
        self.coefficients = np.zeros((len(self.powers), state.shape[1]))
        for k in range(state.shape[1]):
            kept = np.arange(len(self.powers))
            while True:  # sequential least squares: drop the weakest tenth, fit again
                found = np.linalg.lstsq(terms[:, kept], target[:, k], rcond=None)[0]
                if len(kept) <= len(self.powers) // 3:
                    break
                size = max(len(self.powers) // 3, int(0.9 * len(kept)))
                kept = np.sort(kept[np.argsort(-np.abs(found * scale[kept]))[:size]])
            self.coefficients[kept, k] = found

    def monomials(self, state: Array, control: Array) -> Array:
        """Return all monomials (terms, B), each an earlier one times a variable."""
        z = np.concatenate([state.T, control.T])
        squares = z[self.pair[0]] * z[self.pair[1]]
        return np.concatenate([np.ones((1, len(state))), z, squares, squares[self.triple[0]] * z[self.triple[1]]])

    def derivative(self, state: Array, control: Array) -> Array:
        return (self.coefficients.T @ self.monomials(state, control)).T

    def kernel(self) -> DynamicsKernel:
        derivative = polynomial_predictor(self.powers, self.coefficients, self.system.nx, self.system.nu)
        return stepping_kernel(runge_kutta_predictor(derivative, self.system), self.system, output="next_state")


class NeuralODE(Derivative):
    """dx/dt by a network 5-32-32-3, in two substeps."""

    substeps = 2
    width = 32

    def fit(self, state: Array, control: Array, after: Array) -> None:
        inputs = np.concatenate([state, control], axis=1)
        self.layers: list[tuple[Array, Array]] = []
        for seed in range(2):
            self.layers.append(random_layer(inputs, self.width, seed=seed))
            inputs = np.tanh(inputs @ self.layers[-1][0] + self.layers[-1][1])
        self.layers.append(last_layer(inputs, (after - state) / self.system.dt))

    def derivative(self, state: Array, control: Array) -> Array:
        units = np.concatenate([state, control], axis=1)
        for weights, bias in self.layers[:-1]:
            units = np.tanh(units @ weights + bias)
        return units @ self.layers[-1][0] + self.layers[-1][1]

    def kernel(self) -> DynamicsKernel:
        derivative = network_predictor([self.layers], self.system.nx, self.system.nu)
        around = runge_kutta_predictor(derivative, self.system, substeps=self.substeps)
        return stepping_kernel(around, self.system, output="next_state")


def random_layer(inputs: Array, width: int, *, seed: int = 0) -> tuple[Array, Array]:
    """Return weights (n_in, width) and bias (width,) that bring ``inputs`` (N, n_in) to deviation 0.7."""
    rng = np.random.default_rng(seed)
    scale = np.maximum(inputs.std(axis=0), 1e-6)
    weights = rng.standard_normal((inputs.shape[1], width)) * 0.7 / np.sqrt(inputs.shape[1]) / scale[:, None]
    return weights, 0.3 * rng.standard_normal(width) - inputs.mean(axis=0) @ weights


def last_layer(units: Array, target: Array) -> tuple[Array, Array]:
    """Return weights (width, ...) and bias (...) of the ridge regression of ``target`` (N, ...) on ``units``."""
    columns = np.concatenate([units, np.ones((len(units), 1))], axis=1)
    ridge = 1e-6 * len(units) * np.eye(columns.shape[1])
    found = np.linalg.solve(columns.T @ columns + ridge, columns.T @ target)
    return found[:-1], found[-1]


def cases(dataset: Dataset, *, generations: int) -> list[Case]:
    """Return all models fitted to ``dataset``; the emulated car only once it has a kernel."""
    rng = np.random.default_rng(0)
    makers: dict[str, Callable[[], Dynamics]] = {
        "parametrised": lambda: Parametrised(generations=generations).fit(dataset, rng=rng),
        "three networks": lambda: SeparateNetworks(dataset),
        "27 networks": lambda: CommandNetworks(dataset),
        "cubic, RK4": lambda: CubicPolynomial(dataset),
        "nearest neighbour": lambda: NearestNeighbour().fit(dataset, rng=rng),
        "neural ODE": lambda: NeuralODE(dataset),
    }
    found = [Case(name, make()) for name, make in makers.items()]
    robot: Robot = make_robot("emulated_car")
    car = getattr(robot, "dynamics", None)
    if isinstance(car, Dynamics) and car.kernel() is not None:
        found.append(Case("emulated car", car))
    return found
