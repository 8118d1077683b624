"""The models that are timed: small, quickly fitted, with a NumPy step written for speed and a kernel.

Two families are those of the model zoo.
"""

from __future__ import annotations

import itertools
import math
import warnings
from dataclasses import dataclass

import numpy as np
from sklearn.exceptions import ConvergenceWarning
from sklearn.neural_network import MLPRegressor

from hardware.robot import Robot
from model_zoo.car.parametrised import Parametrised
from model_zoo.control_grid import ControlGrid
from model_zoo.neighbours import NearestNeighbour
from sysid_evo.data import Dataset, Trajectory
from sysid_evo.kernels import DynamicsKernel
from sysid_evo.models import Dynamics, training_bounds
from sysid_evo.models.kernels import (
    command_network_predictor,
    network_predictor,
    polynomial_predictor,
    runge_kutta_predictor,
    separate_networks_predictor,
    stepping_kernel,
)
from sysid_evo.registry import make_robot
from sysid_evo.testing import example_dataset
from sysid_evo.types import Array

HIDDEN = 10
ITERATIONS = 150
"""Of training: enough to drive on."""


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
        self.limits = training_bounds(np.concatenate([episode.states for episode in dataset.episodes]), 2.0)
        data = dataset.transitions()
        self.fit(data.carry, data.control, data.after)

    @property
    def state_bounds(self) -> Array:
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
        self.first, self.first_bias = np.zeros((inputs.shape[1], nx * HIDDEN)), np.zeros(nx * HIDDEN)
        self.second, self.second_bias = np.zeros((nx * HIDDEN, nx)), np.zeros(nx)
        target = self.system.acceleration(state, after)
        for k in range(nx):
            own = slice(k * HIDDEN, (k + 1) * HIDDEN)
            inner, outer = trained_network(inputs, target[:, k : k + 1], (HIDDEN,), seed=k)
            self.first[:, own], self.first_bias[own] = inner
            self.second[own, k : k + 1], self.second_bias[k : k + 1] = outer

        self.hidden = with_bias(self.first, self.first_bias)
        self.outward = with_bias(self.second, self.second_bias)

    def step(self, carry: Array, control: Array, noise: Array | None = None) -> Array:
        units = hidden_units(self.hidden, columns(carry, control))
        return self.system.integrate(carry, (self.outward @ units).T)

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
        self.cells = ControlGrid.of(self.system, 3)
        cell, nx = self.cells.index(control), state.shape[1]
        count = self.cells.count
        self.first, self.first_bias = np.zeros((count, nx, nx * HIDDEN)), np.zeros((count, nx * HIDDEN))
        self.second, self.second_bias = np.zeros((count, nx * HIDDEN, nx)), np.zeros((count, nx))
        for number in range(count):
            rows = np.flatnonzero(cell == number)
            for k in range(nx):
                own = slice(k * HIDDEN, (k + 1) * HIDDEN)
                inner, outer = trained_network(state[rows], after[rows, k : k + 1], (HIDDEN,), seed=number)
                self.first[number][:, own], self.first_bias[number, own] = inner
                self.second[number, own, k : k + 1], self.second_bias[number, k : k + 1] = outer

        self.hidden = [with_bias(self.first[c], self.first_bias[c]) for c in range(count)]
        self.outward = [with_bias(self.second[c], self.second_bias[c]) for c in range(count)]

    def step(self, carry: Array, control: Array, noise: Array | None = None) -> Array:
        cell = self.cells.index(control)
        order = np.argsort(cell.astype(np.int16), kind="stable")
        edges = [0, *np.cumsum(np.bincount(cell, minlength=self.cells.count)).tolist()]
        groups = [(c, slice(*edge)) for c, edge in enumerate(itertools.pairwise(edges)) if edge[0] < edge[1]]
        inputs = columns(carry.take(order, axis=0))
        units = np.empty((len(self.hidden[0]) + 1, len(carry)))
        for number, group in groups:
            np.matmul(self.hidden[number], inputs[:, group], out=units[:-1, group])
        np.tanh(units[:-1], out=units[:-1])
        units[-1] = 1.0
        after = np.empty((carry.shape[1], len(carry)))
        for number, group in groups:
            np.matmul(self.outward[number], units[:, group], out=after[:, group])
        unsorted = np.empty_like(carry)
        unsorted[order] = after.T
        return unsorted

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

    def derivative(self, z: Array) -> Array:
        """Return dx/dt (nx, B) for state, control and 1, (nx + nu + 1, B)."""
        raise NotImplementedError

    def step(self, carry: Array, control: Array, noise: Array | None = None) -> Array:
        h = self.system.dt / self.substeps
        z = columns(carry, control)
        x = z[: carry.shape[1]]
        for _ in range(self.substeps):
            start = x.copy()
            k1 = self.derivative(z)
            np.add(start, 0.5 * h * k1, out=x)
            k2 = self.derivative(z)
            np.add(start, 0.5 * h * k2, out=x)
            k3 = self.derivative(z)
            np.add(start, h * k3, out=x)
            k4 = self.derivative(z)
            np.add(start, h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4), out=x)
        return np.ascontiguousarray(x.T)


class CubicPolynomial(Derivative):
    """The 56 monomials of five variables up to degree three; a third of the coefficients is not zero."""

    def fit(self, state: Array, control: Array, after: Array) -> None:
        n = state.shape[1] + control.shape[1]
        chosen = [c for degree in (0, 1, 2, 3) for c in itertools.combinations_with_replacement(range(n), degree)]
        self.powers = np.array([np.bincount(c, minlength=n) for c in chosen])
        terms, target = self.monomials(columns(state, control)).T, (after - state) / self.system.dt
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

    def monomials(self, z: Array) -> Array:
        """Return all monomials (terms, B): those of a degree are a variable times some last ones of the degree below.

        In lexicographic order, what variable i multiplies are the monomials of variables i and later.
        """
        n, terms = len(z) - 1, np.empty((len(self.powers), z.shape[1]))
        terms[0], terms[1 : n + 1] = 1.0, z[:n]
        place = n + 1
        for degree in (2, 3):
            below = place
            for i in range(n):
                count = math.comb(n - i + degree - 2, degree - 1)
                np.multiply(z[i], terms[below - count : below], out=terms[place : place + count])
                place += count
        return terms

    def derivative(self, z: Array) -> Array:
        return self.coefficients.T @ self.monomials(z)

    def kernel(self) -> DynamicsKernel:
        derivative = polynomial_predictor(self.powers, self.coefficients, self.system.nx, self.system.nu)
        return stepping_kernel(runge_kutta_predictor(derivative, self.system), self.system, output="next_state")


class NeuralODE(Derivative):
    """dx/dt by a network 5-32-32-3, in two substeps."""

    substeps = 2
    width = 32

    def fit(self, state: Array, control: Array, after: Array) -> None:
        inputs = np.concatenate([state, control], axis=1)
        self.layers = trained_network(inputs, (after - state) / self.system.dt, (self.width, self.width))
        self.affine = [with_bias(weights, bias) for weights, bias in self.layers]

    def derivative(self, z: Array) -> Array:
        for weights in self.affine[:-1]:
            z = hidden_units(weights, z)
        return self.affine[-1] @ z

    def kernel(self) -> DynamicsKernel:
        derivative = network_predictor([self.layers], self.system.nx, self.system.nu)
        around = runge_kutta_predictor(derivative, self.system, substeps=self.substeps)
        return stepping_kernel(around, self.system, output="next_state")


def trained_network(
    inputs: Array, target: Array, hidden: tuple[int, ...], *, seed: int = 0
) -> list[tuple[Array, Array]]:
    """Return weights (n_in, n_out) and bias (n_out,) of each layer of a tanh network from ``inputs`` to ``target``."""
    network = MLPRegressor(
        hidden_layer_sizes=hidden, activation="tanh", solver="lbfgs", alpha=1e-3, max_iter=ITERATIONS, random_state=seed
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        network.fit(inputs, target if target.shape[1] > 1 else target[:, 0])
    return [
        (np.asarray(weights, dtype=np.float64), np.asarray(bias, dtype=np.float64))
        for weights, bias in zip(network.coefs_, network.intercepts_, strict=True)
    ]


def columns(*rows: Array) -> Array:
    """Return arrays (B, n) on top of each other, and a last row of ones, (sum of n + 1, B).

    Long rows suit NumPy better than many short ones, and the ones save adding biases.
    """
    z = np.empty((sum(array.shape[1] for array in rows) + 1, len(rows[0])))
    np.concatenate([array.T for array in rows], out=z[:-1])
    z[-1] = 1.0
    return z


def with_bias(weights: Array, bias: Array) -> Array:
    """Return weights (n_in, n_out) and bias (n_out,) as one matrix (n_out, n_in + 1)."""
    return np.column_stack([weights.T, bias])


def hidden_units(weights: Array, z: Array) -> Array:
    """Return tanh(weights @ z) and a last row of ones, (n_out + 1, B)."""
    units = np.empty((len(weights) + 1, z.shape[1]))
    np.matmul(weights, z, out=units[:-1])
    np.tanh(units[:-1], out=units[:-1])
    units[-1] = 1.0
    return units


def recording(episodes: int, steps: int) -> Dataset:
    """Return episodes of the made-up car without their first second.

    All of them begin at exactly zero; a nearest neighbour may choose any of such equal points.
    """
    dataset = example_dataset(episodes=episodes, steps=steps)
    return dataset.with_episodes(
        [Trajectory(e.states[20:], e.controls[20:], e.dt, name=e.name) for e in dataset.episodes]
    )


def cases(dataset: Dataset, *, generations: int) -> list[Case]:
    """Return all models fitted to ``dataset``, and the emulated car."""
    rng = np.random.default_rng(0)
    robot: Robot = make_robot("emulated_car")
    assert robot.dynamics is not None
    return [
        Case("parametrised", Parametrised(generations=generations).fit(dataset, rng=rng)),
        Case("three networks", SeparateNetworks(dataset)),
        Case("27 networks", CommandNetworks(dataset)),
        Case("cubic, RK4", CubicPolynomial(dataset)),
        Case("nearest neighbour", NearestNeighbour().fit(dataset, rng=rng)),
        Case("neural ODE", NeuralODE(dataset)),
        Case("emulated car", robot.dynamics),
    ]
