"""Family torch_ode: a PyTorch module as right-hand side; the base class for modules of your own."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self

import numpy as np

from model_zoo.features import Features
from model_zoo.networks.network import Network
from model_zoo.networks.neural_ode import HIDDEN, flow_predictor, flow_step
from model_zoo.networks.training import TrainingSchedule
from model_zoo.scaling import ChannelScaling
from sysid_evo import Dataset, DynamicsModel, register_model
from sysid_evo.carry import CarryLayout
from sysid_evo.errors import InvalidArgument
from sysid_evo.models.kernels import Predictor
from sysid_evo.models.learned import Declared
from sysid_evo.models.parameters import Limit, above, at_least
from sysid_evo.processors import one_thread
from sysid_evo.progress import Counter, Progress
from sysid_evo.types import Array

if TYPE_CHECKING:
    import torch

    from model_zoo.networks.torch_training import Equation

ACTIVATIONS = {"tanh": "Tanh", "silu": "SiLU", "gelu": "GELU", "elu": "ELU", "softplus": "Softplus", "relu": "ReLU"}
TRAINED, STEPPED = 1e-5, 1e-12
"""Tolerances of adaptive solvers; that of steps is small enough to make every row independent of its batch."""


@register_model("torch_ode")
class TorchOde(DynamicsModel):
    """Neural ODE in PyTorch with a choice of network and solver; the base class for modules of your own.

    dx/dt = module(x, u, earlier samples) + w(x), with w the rotation of the frame, solved by torchdiffeq. `module` is a
    multilayer perceptron with the widths ``hidden`` and the ``activation``; a derived family returns another. Inputs
    are standardised (periodic states as sine and cosine), outputs are rates in units of each state's typical one-step
    change, per second, in float64. Controls and earlier samples are held over a step.

    Two thirds of the ``updates`` (Adam, ``learning_rate``) are on single steps, the others on simulations of
    ``horizon`` steps from measured states (multiple shooting). The weights that simulate held-out blocks of time best
    over one second are kept (early stopping). Gradients go through the steps of the ``solver``, or with ``adjoint``
    through its adjoint equation, which needs less memory (only without ``state_lags``).

    With tanh and ``rk4`` the model runs in NumPy and has a compiled form, by the classical method (torchdiffeq uses the
    3/8 rule of the same order). Otherwise it runs in torch. An interrupted fit restarts from the beginning.
    """

    knowledge = "dark grey"
    model_class = "network"
    typical_fit_seconds = 40.0
    periodic = True
    requires = ("torch", "torchdiffeq")
    limits: ClassVar[dict[str, Limit]] = {
        **{name: at_least(1) for name in ("hidden", "updates", "horizon")},
        "learning_rate": above(0),
    }
    presets: ClassVar[dict[str, dict[str, Any]]] = {
        "quick": {"hidden": [24], "updates": 700, "horizon": 10},
        "paper": {"updates": 4500},
    }

    hidden: list[int] | None = None
    activation: Literal["tanh", "silu", "gelu", "elu", "softplus", "relu"] = "tanh"
    solver: Literal["rk4", "euler", "midpoint", "heun3", "explicit_adams", "implicit_adams", "dopri5", "dopri8"] = "rk4"
    adjoint: bool = False
    state_lags: int = 0
    control_lags: int = 0
    updates: int = 1500
    horizon: int = 20
    learning_rate: float = 6e-3
    max_steps: int | None = 100_000

    def check_parameters(self) -> None:
        super().check_parameters()
        if self.adjoint and self.state_lags:
            raise InvalidArgument(
                f"{type(self).__name__}: adjoint: expected state_lags=0, got {self.state_lags}: the adjoint equation "
                "has only the present state"
            )

    def module(self, n_inputs: int, n_outputs: int) -> torch.nn.Module:
        """Return a new module that turns inputs (B, ``n_inputs``) into outputs (B, ``n_outputs``), untrained."""
        from torch import nn

        layers: list[nn.Module] = []
        for size in self.hidden or HIDDEN:
            layers += [nn.Linear(n_inputs, size), getattr(nn, ACTIVATIONS[self.activation])()]
            n_inputs = size
        return nn.Sequential(*layers, nn.Linear(n_inputs, n_outputs))

    def fit(self, dataset: Dataset, *, rng: np.random.Generator, progress: Progress | None = None) -> Self:
        standard, counter = ChannelScaling.of(dataset), Counter(progress, self.updates)
        self.centre_, self.scale_ = standard.of_inputs(CarryLayout(self.system.nx, self.system.nu, *self.lags))
        self.rates_ = standard.change / self.system.dt
        with one_thread(int(rng.integers(2**63))):
            equation = self._equation(TRAINED)
            plan = TrainingSchedule.of_torch(self.updates, self.horizon, self.learning_rate)
            equation.train(dataset, standard, plan, rng=rng, report=counter.advance)
        weights = equation.module.state_dict()
        self.weight_names_ = list(weights)
        self.weights_ = [weight.numpy().copy() for weight in weights.values()]
        return self

    def learned_arrays(self) -> Mapping[str, Declared]:
        seen, nx = Features(self.system, self.lags).n_carry + self.system.nu, self.system.nx
        found: dict[str, Declared] = {"centre_": (seen,), "scale_": (seen,), "rates_": (nx,)}
        if type(self).module is TorchOde.module:  # torch checks the weights of another module
            sizes = [seen, *(self.hidden or HIDDEN), nx]
            found["weights_"] = [one for before, after in pairwise(sizes) for one in ((after, before), (after,))]
        return found

    @property
    def plain(self) -> bool:
        """Whether activation and solver are those that NumPy and the compiled form support."""
        own = type(self).module is not TorchOde.module
        return not own and self.activation == "tanh" and self.solver == "rk4"

    @cached_property
    def network(self) -> Network:
        """The layers of a `plain` model, from standardised features of (carry, control) to rates."""
        weights = [weight.T[None] for weight in self.weights_[::2]]
        biases = [bias[None] for bias in self.weights_[1::2]]
        return Network(weights, biases).folded(self.centre_, self.scale_, self.rates_)

    @cached_property
    def equation(self) -> Equation:
        """The learned equation in torch."""
        with one_thread(0):
            return self._equation(STEPPED).with_weights(dict(zip(self.weight_names_, self.weights_, strict=True)))

    def predictor(self) -> Predictor | None:
        return flow_predictor(self.network, self.system, self.lags) if self.plain else None

    def next_state(self, carry: Array, control: Array) -> Array:
        if self.plain:
            return flow_step(self.network, self.system, self.lags, carry, control)
        return self.equation.next_states(carry, control)

    def _equation(self, tolerance: float) -> Equation:
        """Return the equation with a new module. Raises `ShapeError` if its outputs have another shape."""
        import torch

        from model_zoo.networks.torch_training import Equation

        n_inputs, nx = Features(self.system, self.lags).n_carry + self.system.nu, self.system.nx
        centre, scale, rates = (torch.tensor(part) for part in (self.centre_, self.scale_, self.rates_))
        module = self.module(n_inputs, nx).double()
        found = Equation(module, self.system, self.layout, centre, scale, rates, self.solver, self.adjoint, tolerance)
        return found.checked(type(self).__name__)
