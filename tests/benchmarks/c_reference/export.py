"""What the C forms step with: flat float32 parameters, and the sizes that are compiled in.

It reads how the engine packs the fitted numbers, so that both step with the same ones.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np

from hardware.emulation.car_physics import BODY
from model_zoo.control_grid import ControlGrid
from sysid_evo.models.kernels import networks
from sysid_evo.models.kernels.neighbours import BUCKET, packed, split
from sysid_evo.models.kernels.stepping import STEP
from sysid_evo.randomness import draw_for_trials
from sysid_evo.types import Array, Seeds

Exported: TypeAlias = tuple[list[Any], dict[str, int]]
LANES = 16  # in a vector of the C forms
COMMANDS = [(drive, steer) for drive in (-1.0, 0.0, 1.0) for steer in (-1.0, 0.0, 1.0)]
CUBIC = (
    (0, 0, 0), (0, 1, 0), (0, 0, 1), (0, 0, 2), (0, 2, 0), (0, 1, 1), (0, 3, 0), (0, 2, 1), (0, 1, 2), (0, 0, 3),
    (1, 0, 0), (1, 1, 0), (1, 0, 1), (1, 0, 2), (1, 2, 0), (1, 1, 1), (2, 0, 0), (3, 0, 0), (2, 1, 0), (2, 0, 1),
)  # fmt: skip
"""Exponents of the three states in the order of `cubic` in sindy.c."""


def export(name: str, model: Any, seeds: Seeds) -> tuple[Array, dict[str, int]]:
    """Return flat parameters and {macro: size}."""
    parts, sizes = FORMS[name](model, seeds)
    return np.concatenate([np.ravel(part) for part in parts]).astype(np.float32), sizes


def parametrised(model: Any, seeds: Seeds) -> Exported:
    return [model.parameters_], {}


def evolved3(model: Any, seeds: Seeds) -> Exported:
    kernel = model.kernel().parameters
    layers = kernel[int(kernel[STEP.own]) :]  # behind the header of the shell: that of the networks, three sizes
    hidden, n = model.hidden, 5
    first = layers[4 + 3 :]
    bias, weights = first[: 3 * hidden], first[3 * hidden : 3 * hidden * (1 + n)].reshape(n, 3 * hidden)
    last = first[3 * hidden * (1 + n) :]
    last_bias, last = last[:3], last[3 : 3 + 9 * hidden].reshape(3 * hidden, 3)
    own = [np.append(last[i * hidden : (i + 1) * hidden, i], last_bias[i]) for i in range(3)]
    return [weights, bias, *own], {"H": hidden}


def backprop27(model: Any, seeds: Seeds) -> Exported:
    head = networks.COMMANDS
    kernel = model.kernel().parameters
    own = kernel[int(kernel[STEP.own]) :]
    size = 3 * (5 * model.hidden + 1) * LANES
    return [own[int(own[head.weights]) :][:size]], {"H": model.hidden}


def nearest_neighbour(model: Any, seeds: Seeds) -> Exported:
    cells = ControlGrid.of(model.system, model.levels)
    filled = np.unique(model.cell_)
    counts, blocks = np.zeros(LANES), []
    for command, cell in enumerate(cells.fallback(filled)):
        rows = np.flatnonzero(model.cell_ == cell)
        points, values = model.points_[rows], model.accelerations_[rows]
        boxes, near, value = packed(points, values, split(points, np.arange(len(points))))
        by_group = boxes.reshape(len(boxes), 2, -1, BUCKET).transpose(2, 0, 1, 3)
        counts[command] = len(by_group)
        blocks += [by_group, near, value]
    return [counts, *blocks], {}


def neural_ode(model: Any, seeds: Seeds) -> Exported:
    layers = [part for pair in zip(model.weights_, model.biases_, strict=True) for part in (pair[0][0], pair[1][0])]
    return layers, {"H": layers[0].shape[1]}


def sindy(model: Any, seeds: Seeds) -> Exported:
    table = np.zeros((3, len(CUBIC), LANES))
    for command, control in enumerate(COMMANDS):
        held = np.clip(control, model.low_[3:], model.high_[3:])
        for powers, row in zip(model.exponents_, model.coefficients_, strict=True):
            table[:, CUBIC.index(tuple(powers[:3])), command] += row * np.prod(held ** powers[3:])
    return [model.low_[:3], model.high_[:3], np.zeros(10), table], {}


def mlp_ensemble(model: Any, seeds: Seeds) -> Exported:
    members, (state_lags, control_lags) = model.network.members(), model.lags
    sizes = {"M": len(members), "H": members[0][0][1].size, "SL": state_lags, "CL": control_lags}
    return [part for layers in members for layer in layers for part in layer], sizes


def emulated_car(car: Any, seeds: Seeds) -> Exported:
    physics, trials = car.fine, len(seeds)
    carry = car.start(
        np.zeros((trials, car.n_lags + 1, 3)), np.zeros((trials, car.n_lags, 2)), draw_for_trials(seeds, 3)
    )
    body = np.zeros((7, LANES))
    body[:, :trials] = carry[:, BODY:].T
    return [physics.coefficients, np.zeros(32 - len(physics.coefficients)), body], {}


FORMS: dict[str, Callable[[Any, Seeds], Exported]] = {
    form.__name__: form
    for form in (
        parametrised, evolved3, backprop27, nearest_neighbour, neural_ode, sindy, mlp_ensemble, emulated_car,
    )
}  # fmt: skip
