"""One step of a differential equation with a network in it, in NumPy and compiled: Runge-Kutta of order 4."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from model_zoo.channels.features import Features
from model_zoo.flows.runge_kutta import rk4
from model_zoo.networks.network import Network
from sysid_evo.arrays import Array
from sysid_evo.lags import CarryLayout
from sysid_evo.system import System

if TYPE_CHECKING:
    from sysid_evo.engine.kernels import Predictor


def flow_step(
    network: Network,
    system: System,
    lags: tuple[int, int],
    carry: Array,
    control: Array,
    known_rate: Callable[[Array, Array], Array | None] | None = None,
) -> Array:
    """Return the state (B, nx) after dt of dx/dt = network + ``known_rate`` + rotation of the frame.

    The network sees `Features` of (carry, control); earlier samples and controls are held.
    """
    features, held = Features(system, lags), carry[:, system.nx :]

    def rate(state: Array) -> Array:
        seen = features(np.concatenate([state, held], axis=1), control)
        learned = network(seen)[0] + system.turning(state)
        known = None if known_rate is None else known_rate(state, control)
        return learned if known is None else learned + known

    return rk4(rate, carry[:, : system.nx], system.dt)


def flow_predictor(
    network: Network, system: System, lags: tuple[int, int], known: Predictor | None = None
) -> Predictor | None:
    """Return the compiled form of `flow_step`, with a ``known`` rate if there is one; None if the motion has none."""
    from sysid_evo.engine.kernels import added, network_predictor, runge_kutta_predictor, turning_frame, with_angles

    seen = Features(system, lags).n_carry
    learned = with_angles(network_predictor(network.members()[:1], seen, system.nu), system, lags)
    rate = turning_frame(learned if known is None else added(learned, known, system.nx), system)
    n_carry = CarryLayout(system.nx, system.nu, *lags).size
    return None if rate is None else runge_kutta_predictor(rate, system, n_carry=n_carry)
