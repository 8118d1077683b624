"""What the C forms step with: flat float32 parameters, and the sizes that are compiled in."""

from __future__ import annotations

import numpy as np
from hardware.emulation.car_physics import BODY
from model_zoo.channels.command_cells import CommandCells
from sysid_evo.engine.kernels.neighbours import packed, split
from sysid_evo.engine.kernels.stepping import HEAD
from sysid_evo.randomness import trial_draws

COMMANDS = [(drive, steer) for drive in (-1.0, 0.0, 1.0) for steer in (-1.0, 0.0, 1.0)]
CUBIC = (
    (0, 0, 0), (0, 1, 0), (0, 0, 1), (0, 0, 2), (0, 2, 0), (0, 1, 1), (0, 3, 0), (0, 2, 1), (0, 1, 2), (0, 0, 3),
    (1, 0, 0), (1, 1, 0), (1, 0, 1), (1, 0, 2), (1, 2, 0), (1, 1, 1), (2, 0, 0), (3, 0, 0), (2, 1, 0), (2, 0, 1),
)  # fmt: skip
"""Exponents of the three states in the order of `cubic` in sindy.c."""


def export(name, model, seeds):
    """Return flat parameters and {macro: size}."""
    parameters, sizes = globals()[name](model, seeds)
    return np.concatenate([np.ravel(part) for part in parameters]).astype(np.float32), sizes


def parametrised(model, seeds):
    return [model.parameters_], {}


def evolved3(model, seeds):
    parameters = model.kernel().parameters
    layers = parameters[int(parameters[HEAD.own]) :]  # behind the header of the shell
    hidden, n = model.hidden, 5
    first = layers[4 + 3 :]
    bias, weights = first[: 3 * hidden], first[3 * hidden : 3 * hidden * (1 + n)].reshape(n, 3 * hidden)
    last = first[3 * hidden * (1 + n) :]
    last_bias, last = last[:3], last[3 : 3 + 9 * hidden].reshape(3 * hidden, 3)
    own = [np.append(last[i * hidden : (i + 1) * hidden, i], last_bias[i]) for i in range(3)]
    return [weights, bias, *own], {"H": hidden}


def backprop27(model, seeds):
    _, serving = model._serving
    hidden, table = model.hidden, np.zeros((3, 5 * model.hidden + 1, 16))
    for command, number in enumerate(serving):
        for n in range(3):
            own = slice(n * hidden, (n + 1) * hidden)
            rows = [model.first_bias_[number, own], *model.first_[number][:, own], model.last_[number, n]]
            table[n, : 5 * hidden, command] = np.stack(rows, axis=1).ravel()
            table[n, 5 * hidden, command] = model.last_bias_[number, n]
    return [table], {"H": hidden}


def nearest_neighbour(model, seeds):
    cells = CommandCells.of(model.system, model.levels)
    filled = np.unique(model.cell_)
    counts, blocks = np.zeros(16), []
    for command, cell in enumerate(cells.fallback(filled)):
        rows = np.flatnonzero(model.cell_ == cell)
        points, values = model.points_[rows], model.accelerations_[rows]
        boxes, near, value = packed(points, values, split(points, np.arange(len(points))))
        by_group = boxes.reshape(len(boxes), 2, -1, 16).transpose(2, 0, 1, 3)
        blocks += [by_group.ravel(), near.ravel(), value.ravel()]
        counts[command] = len(by_group)
    return [counts, *blocks], {}


def neural_ode(model, seeds):
    layers = [part for pair in zip(model.weights_, model.biases_, strict=True) for part in (pair[0][0], pair[1][0])]
    return layers, {"H": layers[0].shape[1]}


def sindy(model, seeds):
    table = np.zeros((3, 20, 16))
    for command, control in enumerate(COMMANDS):
        held = np.clip(control, model.low_[3:], model.high_[3:])
        for powers, row in zip(model.exponents_, model.coefficients_, strict=True):
            table[:, CUBIC.index(tuple(powers[:3])), command] += row * np.prod(held ** powers[3:])
    return [model.low_[:3], model.high_[:3], np.zeros(10), table], {}


def mlp_ensemble(model, seeds):
    members, (state_lags, control_lags) = model.network.members(), model.lags
    sizes = {"M": len(members), "H": members[0][0][1].size, "SL": state_lags, "CL": control_lags}
    return [part for layers in members for layer in layers for part in layer], sizes


def emulated_car(car, seeds):
    physics, trials = car.fine, len(seeds)
    carry = car.start(np.zeros((trials, car.n_lags + 1, 3)), np.zeros((trials, car.n_lags, 2)), trial_draws(seeds, 3))
    body = np.zeros((7, 16))
    body[:, :trials] = carry[:, BODY:].T
    return [physics.coefficients, np.zeros(32 - len(physics.coefficients)), body], {}
