"""The closed loop in plain JAX: `jit(vmap(scan))` over rollouts in float32, and a generation of evosax."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

import numpy as np

from model_zoo.parametrised import Parametrised
from sysid_evo.arrays import Array, Seeds
from sysid_evo.dynamics import Dynamics
from sysid_evo.motion import PlanarBody
from sysid_evo.tasks import PointToPoint
from tests.benchmarks.rollout.families import NeuralODE, SeparateNetworks

os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1")
import jax
import jax.numpy as jnp

HIDDEN = 6
SWITCH = 0.3


def scores(dynamics: Dynamics, task: PointToPoint) -> Callable[[Any, Any], Any] | None:
    """Return a function of parameters (P, 78) and waypoints (E, n, 2): fitness (P, E); None without a form."""
    step = _step(dynamics)
    if step is None:
        return None
    envelope = dynamics.envelope
    assert envelope is not None
    low, high = jnp.asarray(envelope, jnp.float32)
    motion, names, dt = dynamics.system.motion, dynamics.system.state_names, dynamics.system.dt
    assert isinstance(motion, PlanarBody)
    forward, lateral, yaw_rate = motion.indices(names)
    assert lateral is not None

    def rollout(parameters: Any, waypoints: Any) -> Any:
        inward, recurrent, outward = jnp.split(parameters, [5 * HIDDEN, (5 + HIDDEN) * HIDDEN])
        inward, recurrent = inward.reshape(5, HIDDEN), recurrent.reshape(HIDDEN, HIDDEN)
        outward = outward.reshape(HIDDEN, 2)

        def advance(carry: Any, _: None) -> Any:
            state, memory, pose, passed = carry
            to = waypoints[passed] - pose[:2]
            angle = jnp.arctan2(to[1], to[0]) - pose[2]
            angle = jnp.pi - jnp.mod(jnp.pi - angle, 2.0 * jnp.pi)
            seen = jnp.array([1.0, state[forward], state[yaw_rate], angle, jnp.hypot(to[0], to[1])])
            memory = jnp.tanh(seen @ inward + memory @ recurrent)
            raw = jnp.tanh(memory @ outward)
            control = (raw > SWITCH).astype(jnp.float32) - (raw < -SWITCH)
            after = jnp.clip(step(state, control), low, high)
            mean = 0.5 * (state + after)
            middle = pose[2] + 0.5 * dt * mean[yaw_rate]
            c, s = jnp.cos(middle), jnp.sin(middle)
            along, across = dt * mean[forward], dt * mean[lateral]
            turned = jnp.stack([c * along - s * across, s * along + c * across, dt * mean[yaw_rate]])
            pose = pose + turned
            to = waypoints[passed] - pose[:2]
            passed = passed + (to @ to <= task.waypoint_radius**2)
            return (after, memory, pose, passed), None

        begin = (jnp.zeros(3), jnp.zeros(HIDDEN), jnp.zeros(3), jnp.int32(0))
        return jax.lax.scan(advance, begin, None, length=task.horizon)[0][3]

    return jax.jit(jax.vmap(jax.vmap(rollout, (None, 0)), (0, None)))


def _step(dynamics: Dynamics) -> Callable[[Any, Any], Any] | None:
    """Return the step of one rollout, x (3,) and u (2,)."""
    dt = dynamics.system.dt
    if isinstance(dynamics, Parametrised):
        forward, _, yaw_rate, drive, steer = dynamics.roles
        u_f, u_b, r_l, r_r, d_ul, d_uv, d_rl, d_rv, u_min, r_min, u_max, r_max = map(float, dynamics.parameters_)

        def equation_one(x: Any, control: Any) -> Any:
            u, r, u1, u2 = x[forward], x[yaw_rate], control[drive], control[steer]
            thrust = u_f * jnp.maximum(u1, 0.0) - u_b * jnp.maximum(-u1, 0.0)
            turning = u * (r_l * jnp.maximum(u2, 0.0) - r_r * jnp.maximum(-u2, 0.0))
            u = u + dt * (thrust - u * d_ul - u * jnp.abs(u) * d_uv)
            r = r + dt * (turning - r * d_rl - r * jnp.abs(r) * d_rv)
            u = jnp.where((jnp.abs(u) < u_min) & (u1 == 0), 0.0, jnp.clip(u, -u_max, u_max))
            r = jnp.where((jnp.abs(r) < r_min) & (u2 == 0), 0.0, jnp.clip(r, -r_max, r_max))
            return jnp.zeros(3).at[forward].set(u).at[yaw_rate].set(r)

        return equation_one
    if isinstance(dynamics, SeparateNetworks):
        first, bias, second, second_bias = (
            jnp.asarray(a, jnp.float32)
            for a in (dynamics.first, dynamics.first_bias, dynamics.second, dynamics.second_bias)
        )

        def networks(x: Any, control: Any) -> Any:
            after = x + dt * (jnp.tanh(jnp.concatenate([x, control]) @ first + bias) @ second + second_bias)
            c, s = jnp.cos(x[2] * dt), jnp.sin(x[2] * dt)
            return jnp.stack([c * after[0] + s * after[1], c * after[1] - s * after[0], after[2]])

        return networks
    if isinstance(dynamics, NeuralODE):
        layers = [(jnp.asarray(w, jnp.float32), jnp.asarray(b, jnp.float32)) for w, b in dynamics.layers]
        h = dt / dynamics.substeps

        def derivative(x: Any, control: Any) -> Any:
            units = jnp.concatenate([x, control])
            for weights, bias in layers[:-1]:
                units = jnp.tanh(units @ weights + bias)
            return units @ layers[-1][0] + layers[-1][1]

        def runge_kutta(x: Any, control: Any) -> Any:
            for _ in range(dynamics.substeps):
                k1 = derivative(x, control)
                k2 = derivative(x + 0.5 * h * k1, control)
                k3 = derivative(x + 0.5 * h * k2, control)
                k4 = derivative(x + h * k3, control)
                x = x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
            return x

        return runge_kutta
    return None


def rollouts(dynamics: Dynamics, task: PointToPoint, population: Array, seeds: Seeds) -> Callable[[], Array] | None:
    """Return a program that rolls out ``population`` (P, 78) and gives the fitness (P, E)."""
    score = scores(dynamics, task)
    if score is None:
        return None
    waypoints = jnp.asarray(task.bind(dynamics.system).begin(seeds).waypoints, jnp.float32)
    parameters = jnp.asarray(population, jnp.float32)
    return lambda: np.asarray(score(parameters, waypoints))


def generation(dynamics: Dynamics, task: PointToPoint, population: Array, seeds: Seeds) -> Callable[[], object] | None:
    """Return a program that runs a generation of evosax's `SimpleGA`: ask, roll out, tell."""
    from evosax.algorithms import SimpleGA

    score = scores(dynamics, task)
    if score is None:
        return None
    parameters = jnp.asarray(population, jnp.float32)
    waypoints = jnp.asarray(task.bind(dynamics.system).begin(seeds).waypoints, jnp.float32)
    strategy = SimpleGA(population_size=len(population), solution=parameters[0])
    settings, key = strategy.default_params, jax.random.key(0)
    first = strategy.init(key, parameters, jnp.zeros(len(population)), settings)

    @jax.jit
    def run(key: Any, state: Any) -> Any:
        asked, told = jax.random.split(key)
        candidates, state = strategy.ask(asked, state, settings)
        fitness = score(candidates, waypoints).mean(axis=1)
        return strategy.tell(told, candidates, -fitness, state, settings)

    return lambda: jax.block_until_ready(run(key, first))
