"""A torch module as right-hand side: learned, stored and stepped; and torch as the judge of gradients by hand."""

from itertools import pairwise
from typing import get_args, get_type_hints

import numpy as np
import pytest
from torch import nn  # after the skip
from torchdiffeq import odeint

from model_zoo.features import Features
from model_zoo.networks.network import Layers, random_network
from model_zoo.networks.neural_ode import OdeSimulation
from model_zoo.networks.torch_ode import TorchOde
from model_zoo.networks.torch_training import Adam, Equation, Turning, seen
from model_zoo.networks.training import MOMENTUM, SPREAD, Batches, TrainingWindows
from sysid_evo.data import Dataset
from sysid_evo.errors import InvalidArgument, ShapeError
from sysid_evo.models import load_model, save_model
from sysid_evo.models.base import make_model
from sysid_evo.registry import models
from sysid_evo.testing import check_model, example_dataset
from tests.fixtures.systems import DRIVEN, SWING

torch = pytest.importorskip("torch")
pytest.importorskip("torchdiffeq")


SMALL = {"hidden": [6], "updates": 12, "horizon": 3}


@pytest.fixture(scope="module")
def data():
    return example_dataset(episodes=2, steps=120)


class Gated(nn.Module):
    """Linear, plus what a gate lets through."""

    def __init__(self, n_inputs, n_outputs):
        super().__init__()
        self.linear = nn.Linear(n_inputs, n_outputs)
        self.further = nn.Sequential(nn.Linear(n_inputs, 2 * n_outputs), nn.GLU())

    def forward(self, inputs):
        return torch.add(self.linear(inputs), self.further(inputs))


class GatedOde(TorchOde):
    """A family that brings a module of its own."""

    def module(self, n_inputs, n_outputs):
        return Gated(n_inputs, n_outputs)


@pytest.fixture(scope="module")
def plugin():
    models.register("gated_ode")(GatedOde)
    return GatedOde


def fitted(dataset, **parameters):
    return TorchOde(**{**SMALL, **parameters}).fit(dataset, rng=0)


def carries(model, dataset):
    some = dataset.transitions(state_lags=model.lags[0], control_lags=model.lags[1])
    return some.carry[::9], some.control[::9]


def test_the_rates_of_a_linear_system_are_learned_to_eight_per_cent():
    """Of the usual rate, the root mean square over states that it did not learn from."""
    learned, fresh = DRIVEN.recording(seed=1, episodes=4), DRIVEN.recording(seed=2)
    model = fitted(learned, hidden=[16], updates=300, horizon=2, learning_rate=1e-2)
    data = fresh.transitions()
    change = data.after - data.state
    error = model.step(data.carry, data.control) - data.after
    inside = ((data.state > -1.0) & (data.state < 1.0)).all(axis=1)
    assert np.sqrt(np.mean(error[inside] ** 2)) < 0.08 * np.sqrt(np.mean(change[inside] ** 2))


@pytest.mark.parametrize(
    "options",
    [
        {"activation": "silu", "state_lags": 1, "control_lags": 2},
        pytest.param(
            {"solver": "dopri5", "adjoint": True, "updates": 2, "hidden": [4], "horizon": 2}, marks=pytest.mark.nightly
        ),
        {"solver": "implicit_adams", "updates": 2},
    ],
)
def test_every_kind_of_solver_keeps_the_contract(options, data):
    check_model("torch_ode", data[[0]], **{**SMALL, **options})


def test_a_module_of_ones_own_comes_as_a_plugin(plugin, data, tmp_path):
    """It keeps the contract; stored and loaded it steps as before; nothing but arrays is stored."""
    check_model("gated_ode", data, updates=12, horizon=3)
    model = plugin(updates=12, horizon=3).fit(data, rng=0)
    carry, control = carries(model, data)
    loaded = load_model(save_model(model, tmp_path / "model"))
    np.testing.assert_array_equal(loaded.step(carry, control), model.step(carry, control))
    assert all(isinstance(weight, np.ndarray) for weight in model.weights_)
    assert model.kernel() is None
    assert sorted(file.suffix for file in tmp_path.iterdir()) == [".json", ".safetensors"]


def test_numpy_torch_and_adaptive_steps_agree(data):
    """The same equation, to the order of the methods."""
    model = fitted(data, state_lags=1, control_lags=1)
    carry, control = carries(model, data)
    stepped = model.next_state(carry, control)
    adaptive = model.variant(solver="dopri5").next_state(carry, control)
    np.testing.assert_allclose(stepped, adaptive, atol=1e-5)
    np.testing.assert_allclose(model.equation.next_states(carry, control), adaptive, atol=1e-5)
    assert np.abs(stepped - carry[:, :3]).max() > 0.05


def test_the_adjoint_equation_gives_the_gradients_of_the_steps(data):
    model = fitted(data)
    windows = TrainingWindows.of(data, 4, 0)
    samples = np.moveaxis(Batches([windows], 0).of([np.arange(9)], 4)[:, 0], 0, 1).astype(np.float64)
    states, controls = torch.from_numpy(samples[..., :3]), torch.from_numpy(samples[..., 3:])
    found = []
    for adjoint in (False, True):
        equation = model.variant(adjoint=adjoint).equation
        (equation.run(states[:, :1], controls[:, :0], controls[:, :-1]) ** 2).sum().backward()
        found.append(torch.cat([one.grad.flatten() for one in equation.module.parameters()]))
    torch.testing.assert_close(found[0], found[1], rtol=1e-3, atol=1e-3 * float(found[0].abs().max()))
    assert not torch.equal(found[0], found[1])


def test_the_turning_frame_has_the_derivative_of_its_motion(data):
    state = torch.tensor([[1.0, 0.2, 3.0], [0.5, -0.3, -1.0]], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(lambda x: Turning.apply(x, data.system), (state,))


def test_what_cannot_be_done_is_refused_where_it_is_said(data):
    with pytest.raises(InvalidArgument, match="adjoint: expected state_lags=0, got 1"):
        make_model("torch_ode", adjoint=True, state_lags=1)
    with pytest.raises(InvalidArgument, match="solver: expected one of 'rk4'"):
        make_model("torch_ode", solver="leapfrog")

    class Narrow(TorchOde):
        def module(self, n_inputs, n_outputs):
            return nn.Linear(n_inputs, 1)

    with pytest.raises(ShapeError, match=r"expected a module that turns \(2, 5\) into \(2, 3\), got \(2, 1\)"):
        Narrow(**SMALL).fit(data)


def test_torch_is_left_as_it_was(data):
    """Its threads, and the random numbers of whoever uses it beside."""
    threads = torch.get_num_threads()
    torch.manual_seed(3)
    expected = torch.rand(2)
    torch.manual_seed(3)
    fitted(data, updates=2, activation="silu").next_state(np.zeros((1, 3)), np.zeros((1, 2)))
    assert torch.equal(torch.rand(2), expected)
    assert torch.get_num_threads() == threads


def test_a_row_that_a_solver_cannot_follow_is_alone_in_that(data):
    model = fitted(data, solver="dopri5", updates=1, horizon=1)
    carry, control = carries(model, data)
    expected = model.next_state(carry[:3], control[:3])
    broken = carry[:3].copy()
    broken[1, 0] = np.nan
    found = model.next_state(broken, control[:3])
    assert np.isnan(found[1]).all()
    np.testing.assert_allclose(found[[0, 2]], expected[[0, 2]])


def test_the_gradient_of_a_flow_by_hand_is_that_of_torch_through_torchdiffeq(data):
    """Through free runs of five steps. torchdiffeq's rk4 is the 3/8 rule, so dt is short."""
    system = data.system.with_dt(0.01)
    dataset = Dataset.from_arrays(system, [e.states for e in data], [e.controls for e in data])
    flow = OdeSimulation(dataset, (0, 1), hidden=[5, 4], rng=np.random.default_rng(0))
    windows = TrainingWindows.of(dataset, 5, 1)
    samples = Batches([windows], 1).of([np.arange(0, 70, 7)], 5)
    weights = np.random.default_rng(1).standard_normal((5, 1, 10, 3)).astype(np.float32)
    states = flow.run(samples)
    found = flow.gradient(weights)[0]

    module = sequential([7, 5, 4, 3], flow.parameters[0])
    equation = Equation(
        module,
        system,
        flow.layout,
        torch.from_numpy(flow.centre),
        torch.from_numpy(flow.scale),
        torch.from_numpy(flow.rates),
        solver="rk4",
        adjoint=False,
        tolerance=0.0,
    )
    batch = torch.from_numpy(np.moveaxis(samples[:, 0], 0, 1).astype(np.float64))
    expected = equation.run(batch[:, :2, :3], batch[:, :1, 3:], batch[:, 1:-1, 3:])
    np.testing.assert_allclose(np.moveaxis(states[:, 0], 0, 1), expected.detach().numpy(), atol=1e-5)
    (expected * torch.from_numpy(np.moveaxis(weights[:, 0], 0, 1))).sum().backward()
    by_torch = flat_gradient(module)
    np.testing.assert_allclose(found, by_torch, atol=1e-4 * np.abs(by_torch).max())


def test_the_gradient_of_layers_by_hand_is_that_of_torch():
    """Of two calls of two members, whose inputs and outputs are scaled."""
    rng = np.random.default_rng(0)
    sizes, centre, scale, output = [4, 7, 5, 2], rng.standard_normal(4), rng.uniform(1, 2, 4), np.array([2.0, 3.0])
    layers = Layers(sizes, 2, centre=centre, scale=scale, output_scale=output)
    parameters = layers.flat(random_network(sizes, 2, rng))
    layers.take(parameters)
    inputs, slopes = rng.standard_normal((2, 2, 6, 4)), rng.standard_normal((2, 2, 6, 2)).astype(np.float32)
    layers.reserve(2, 6)[...] = inputs
    for call in range(2):
        layers.forward(call)
        layers.backward(call, slopes[call], 4)
    found = layers.gradient()
    for member in range(2):
        module = sequential(sizes, parameters[member])
        seen_inputs = torch.from_numpy((inputs[:, member] - centre) / scale)
        (module(seen_inputs) * torch.from_numpy(output) * torch.from_numpy(slopes[:, member])).sum().backward()
        by_torch = flat_gradient(module)
        np.testing.assert_allclose(found[member], by_torch, atol=1e-5 * np.abs(by_torch).max())


def sequential(sizes, parameters):
    """Return the network in torch whose weights (n_in, n_out) and biases stand one after the other."""
    layers = []
    at = 0
    for n_in, n_out in pairwise(sizes):
        linear = nn.Linear(n_in, n_out).double()
        with torch.no_grad():
            weight = torch.tensor(parameters[at : at + n_in * n_out], dtype=torch.float64)
            linear.weight.copy_(weight.reshape(n_in, n_out).T)
            at += n_in * n_out
            linear.bias.copy_(torch.tensor(parameters[at : at + n_out], dtype=torch.float64))
            at += n_out
        layers += [linear, nn.Tanh()]
    return nn.Sequential(*layers[:-1])


def flat_gradient(module):
    """Return the gradient (P,) by the parameters in the order of `sequential`."""
    parts = []
    for layer in module:
        if isinstance(layer, nn.Linear):
            parts += [layer.weight.grad.T.flatten(), layer.bias.grad]
    return torch.cat(parts).numpy()


def test_torch_sees_what_numpy_sees_of_a_periodic_state():
    states = np.array([[0.3, 1.0], [7.0, -1.0]])
    expected = Features(SWING, (0, 0))(states, np.empty((2, 0)))
    np.testing.assert_allclose(seen(SWING, torch.from_numpy(states)).numpy(), expected)


def test_the_solvers_on_offer_are_those_of_torchdiffeq():
    for solver in get_args(get_type_hints(TorchOde.__init__)["solver"]):
        after = odeint(lambda _, x: -x, torch.ones(1, dtype=torch.float64), torch.tensor([0.0, 0.1]), method=solver)
        assert abs(float(after[-1]) - np.exp(-0.1)) < (6e-3 if solver == "euler" else 1e-3)


@pytest.mark.nightly  # the compiler of PyTorch is imported
def test_a_step_of_adam_is_that_of_pytorch_to_the_last_bit():
    ours, theirs = torch.nn.Linear(3, 2), torch.nn.Linear(3, 2)
    theirs.load_state_dict(ours.state_dict())
    known = torch.optim.Adam(theirs.parameters(), betas=(MOMENTUM, SPREAD), weight_decay=0.1)
    own = Adam(ours.parameters(), 0.1)
    for rate, x in zip(
        (0.1, 0.03, 0.01), torch.randn(3, 5, 3, generator=torch.Generator().manual_seed(0)), strict=True
    ):
        for module in (ours, theirs):
            module.zero_grad()
            module(x).square().sum().backward()
        known.param_groups[0]["lr"] = rate
        known.step()
        own.step(rate)
    for one, other in zip(ours.parameters(), theirs.parameters(), strict=True):
        assert torch.equal(one, other)
