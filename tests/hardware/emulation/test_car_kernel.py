"""The compiled form of the emulated car against its NumPy step."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from hardware.emulation.car_physics import BODY, BUFFER, CarParameters
from hardware.emulation.cars import AWKWARD, ToyCarDynamics
from hardware.emulation.held_control import HeldControl
from sysid_evo.engine import DynamicsRunner, rollout
from sysid_evo.engine.compiled.compiler import compile_kernel
from sysid_evo.evolution import ControllerEvolution, evolve_controller
from sysid_evo.kernels import DYNAMICS, LANES, DynamicsKernel, Lifted, Precision
from sysid_evo.models import Dynamics
from sysid_evo.randomness import trial_seeds
from sysid_evo.types import Array
from tests.fixtures.by_hand import Delayed

Step = Callable[[Array, Array, Array], Array]


def compiled_step(dynamics: Dynamics, precision: Precision) -> Step:
    """Return the kernel as a function of 64 carries, controls and noises, like `Dynamics.step`."""
    kernel = dynamics.kernel()
    assert kernel is not None
    function = compile_kernel(kernel.source, DYNAMICS, precision, pointer=False)

    def lanes(array: Array) -> Array:
        return np.ascontiguousarray(array.T, dtype=precision).reshape(-1)

    def step(carry: Array, control: Array, noise: Array) -> Array:
        rows, scratch = lanes(carry), lanes(np.zeros((LANES, max(1, kernel.n_scratch))))
        function(rows, lanes(control), lanes(noise), lanes(kernel.parameters[None]), scratch)
        return rows.reshape(dynamics.n_carry, LANES).T.astype(np.float64)

    return step


def any_carry(rng: np.random.Generator) -> Array:
    """Return 64 carries (64, n_carry): any speed, commands under way, battery; some at rest or close to it."""
    carry = np.zeros((LANES, ToyCarDynamics.n_carry))
    carry[:, :3] = rng.uniform(-1.0, 1.0, (LANES, 3)) * [2.0, 0.7, 6.0] * rng.choice([1.0, 1e-2, 0.0], (LANES, 1))
    carry[:, BUFFER] = rng.integers(-1, 2, (LANES, BODY - 3))
    motor, slack = rng.uniform(-1.0, 1.0, LANES), rng.choice([-1.0, -0.4, 1.0], LANES)
    sag, battery = rng.uniform(0.0, 0.08, LANES), rng.uniform(0.9, 1.1, LANES)
    steering, noises = rng.uniform(-0.2, 0.2, LANES), rng.normal(0.0, [[0.25], [2.0]], (2, LANES))
    carry[:, BODY:] = np.stack([motor, sag, battery, slack, steering, *noises], axis=1)
    return carry


def any_control(rng: np.random.Generator) -> Array:
    return rng.integers(-1, 2, (LANES, 2)).astype(float)


@pytest.mark.parametrize(("precision", "tolerance"), [("float64", 1e-12), ("float32", 1e-5)])
def test_one_fine_step_is_that_of_numpy_from_any_carry(
    rng: np.random.Generator, precision: Precision, tolerance: float
) -> None:
    for car in (CarParameters(), CarParameters().perturbed(3), AWKWARD):
        physics = ToyCarDynamics(car)
        step = compiled_step(physics, precision)
        for _ in range(30):
            carry, control, noise = any_carry(rng), any_control(rng), rng.standard_normal((LANES, 2))
            assert np.abs(step(carry, control, noise) - physics.step(carry, control, noise)).max() < tolerance


@pytest.mark.parametrize("repeats", [3, 10, 13])
def test_commands_arrive_when_they_are_due_however_long_they_are_held(rng: np.random.Generator, repeats: int) -> None:
    held = HeldControl(ToyCarDynamics(), repeats)
    step = compiled_step(held, "float64")
    carry = other = any_carry(rng)
    for _ in range(12):
        control, noise = any_control(rng), rng.standard_normal((LANES, 2 * repeats))
        carry, other = step(carry, control, noise), held.step(other, control, noise)
        assert np.array_equal(carry[:, BUFFER], other[:, BUFFER])
        assert np.abs(carry - other).max() < 1e-11


def test_rounding_does_not_add_up_in_float32(rng: np.random.Generator) -> None:
    held = HeldControl(ToyCarDynamics(), 10)
    step = compiled_step(held, "float32")
    carry = other = held.start(np.zeros((LANES, 2, 3)), np.zeros((LANES, 1, 2)), rng.standard_normal((LANES, 3)))
    full_speed = np.tile([1.0, 0.0], (LANES, 1))
    for _ in range(100):
        noise = rng.standard_normal((LANES, 20))
        carry, other = step(carry, full_speed, noise), held.step(other, full_speed, noise)
    assert other[:, 0].min() > 1.5
    assert np.abs((carry - other)[:, 0]).max() < 2e-6
    assert abs((carry - other)[:, 0].mean()) < 1e-6


class Compiled(Delayed):
    """It, with a scalar step of its own."""

    def kernel(self) -> DynamicsKernel:
        return DynamicsKernel(Lifted(delayed, n_carry=4, nu=1, n_noise=1), np.array([0.9]))  # type: ignore[arg-type]


def delayed(x, u, w, p):  # type: ignore[no-untyped-def]
    return p[0] * x[0] + x[1] + w[0], x[2], x[3], u[0]


def test_any_fine_kernel_can_be_held(rng: np.random.Generator) -> None:
    held = HeldControl(Compiled(), 5)
    step = compiled_step(held, "float64")
    carry, control, noise = (rng.standard_normal((LANES, size)) for size in (4, 1, 5))
    assert np.abs(step(carry, control, noise) - held.step(carry, control, noise)).max() < 1e-12


def test_a_fine_dynamics_without_a_kernel_has_none_when_held() -> None:
    assert HeldControl(Delayed(), 5).kernel() is None


def test_scores_of_an_evolved_population_are_those_of_numpy() -> None:
    car = HeldControl(ToyCarDynamics(), 10)
    settings = ControllerEvolution(generations=40, trials=5)
    champion = evolve_controller("car", {"car": DynamicsRunner(car)}, car.system, settings, seed=3)
    rng = np.random.default_rng(0)
    size = len(champion.parameters)
    population = champion.parameters + 0.1 * np.abs(champion.parameters).mean() * rng.standard_normal((100, size))
    task = settings.make_task(car.system)
    controller, seeds = settings.make_controller(task), trial_seeds(5, 10)
    expected = rollout(car, controller, population, task, seeds, engine="reference")
    assert expected.fitness.mean() > 5.0
    for engine, share in (("float64", 0.995), ("float32", 0.99)):
        found = rollout(car, controller, population, task, seeds, engine=engine)  # type: ignore[arg-type]
        assert found.engine == f"compiled {engine}"
        assert (found.fitness == expected.fitness).mean() >= share
        assert abs(found.fitness.mean() - expected.fitness.mean()) < 0.1
