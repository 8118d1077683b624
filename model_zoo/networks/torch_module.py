"""Family torch_module: a module of PyTorch, of states and controls in their units."""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self

import numpy as np

from model_zoo.networks.training import TrainingSchedule
from model_zoo.scaling import ChannelScaling
from sysid_evo import Dataset, DynamicsModel, register_model
from sysid_evo.carry import CarryLayout
from sysid_evo.errors import IncompatibleSystem, InvalidArgument, ShapeError
from sysid_evo.models.kernels import Predictor, network_predictor, on_top, runge_kutta_predictor
from sysid_evo.models.learned import Declared, Numbers
from sysid_evo.models.parameters import Limit, above, at_least
from sysid_evo.processors import one_thread
from sysid_evo.progress import Counter, Progress
from sysid_evo.registry.objects import is_object_text, kept_object
from sysid_evo.registry.plugins import named_in_plugin
from sysid_evo.system import System
from sysid_evo.types import Array

if TYPE_CHECKING:
    import torch

    from model_zoo.networks.torch_training import ModuleEquation


@register_model("torch_module")
class TorchModule(DynamicsModel):
    """A PyTorch module of your own, ``forward(x, u)`` with states (B, nx) and controls (B, nu) in their units.

    ``module`` is the module, or the name of a class or function in a plugin file that makes one without arguments; None
    is one linear layer. A module with one input, such as ``Sequential``, gets states and controls side by side.
    ``returns`` is what it gives: the ``rate`` of the states, which is integrated by the Runge-Kutta method with
    controls held, their ``change`` in one sample, or the ``next_state``. The rotation of a body frame is not added.

    Training starts from the weights that the module has, as in `torch_ode`: two thirds of the ``updates`` (Adam,
    ``learning_rate``) on single steps, then on simulations of ``horizon`` steps; inputs are not scaled. With ``fitted``
    the module is used as it is. It runs in float64; linear layers with tanh between them have a compiled form.
    """

    knowledge = "black"
    typical_fit_seconds = 40.0
    requires = ("torch", "torchdiffeq")
    plugin_parameters = ("module",)
    limits: ClassVar[dict[str, Limit]] = {
        **{name: at_least(1) for name in ("updates", "horizon")},
        "learning_rate": above(0),
    }
    presets: ClassVar[dict[str, dict[str, Any]]] = {"quick": {"updates": 400, "horizon": 10}}
    timing_parameters: ClassVar[dict[str, Any]] = {"updates": 1, "horizon": 1}

    module: Any = None
    returns: Literal["rate", "change", "next_state"] = "rate"
    fitted: bool = False
    updates: int = 1500
    horizon: int = 20
    learning_rate: float = 6e-3
    max_steps: int | None = 100_000

    def fit(self, dataset: Dataset, *, rng: np.random.Generator, progress: Progress | None = None) -> Self:
        counter = Counter(progress, self.updates)
        with one_thread(int(rng.integers(2**63))):
            equation = self._equation(dataset.system)
            self.trained_ = not self.fitted and any(one.requires_grad for one in equation.module.parameters())
            if self.trained_:
                plan = TrainingSchedule.of_torch(self.updates, self.horizon, self.learning_rate)
                equation.train(dataset, ChannelScaling.of(dataset), plan, rng=rng, report=counter.advance)
        weights = equation.module.state_dict()
        self.weight_names_ = list(weights)
        self.weights_ = [np.atleast_1d(weight.numpy()).copy() for weight in weights.values()]
        return self

    def check_system(self, system: System) -> None:
        self._equation(system)

    def learned_arrays(self) -> Mapping[str, Declared]:
        known = self._equation(self.system).module.state_dict()
        if getattr(self, "weight_names_", None) != list(known):
            raise ShapeError(f"weight_names_: expected {', '.join(known)}, as in the module")
        return {
            "weights_": [
                Numbers(*weight.shape or (1,), whole=not weight.is_floating_point()) for weight in known.values()
            ]
        }

    @property
    def fit_note(self) -> str:
        as_it_is = "" if getattr(self, "trained_", not self.fitted) else "used as it is"
        return "; ".join(filter(None, (super().fit_note, as_it_is)))

    def next_state(self, carry: Array, control: Array) -> Array:
        return self.equation.next_states(carry, control)

    @cached_property
    def equation(self) -> ModuleEquation:
        """The learned equation in torch."""
        with one_thread(0):
            found = self._equation(self.system)
            shapes = [weight.shape for weight in found.module.state_dict().values()]
            weights = [weight.reshape(shape) for weight, shape in zip(self.weights_, shapes, strict=True)]
            return found.with_weights(dict(zip(self.weight_names_, weights, strict=True)))

    def predictor(self) -> Predictor | None:
        layers, nx = self._layers(), self.system.nx
        if not layers:
            return None
        found = network_predictor([layers], nx, self.system.nu)
        if self.returns == "rate":
            return runge_kutta_predictor(found, self.system)
        return on_top(found, np.ones(nx, dtype=bool)) if self.returns == "change" else found

    def _layers(self) -> list[tuple[Array, Array]]:
        """Return weights and biases of linear layers with tanh between them; empty for other modules."""
        from torch import nn

        module = self.equation.module
        parts = list(module) if isinstance(module, nn.Sequential) else [module]
        kinds = [nn.Linear if i % 2 == 0 else nn.Tanh for i in range(len(parts))]
        if len(parts) % 2 == 0 or any(type(part) is not kind for part, kind in zip(parts, kinds, strict=True)):
            return []
        linear = [part for part in parts if isinstance(part, nn.Linear)]
        return [
            (
                part.weight.detach().numpy().T,
                np.zeros(part.out_features) if part.bias is None else part.bias.detach().numpy(),
            )
            for part in linear
        ]

    def _equation(self, system: System) -> ModuleEquation:
        """Return the equation of a new copy of the module. Raises `IncompatibleSystem` if it has other outputs."""
        from model_zoo.networks.torch_training import ModuleEquation  # loads torch

        try:
            return ModuleEquation.of_states(
                self._new_module(system), system, CarryLayout(system.nx, system.nu, 0, 0), self.returns
            )
        except (RuntimeError, TypeError, ShapeError) as error:
            raise IncompatibleSystem(
                f"torch_module: expected forward(x, u) that turns (B, {system.nx}) and (B, {system.nu}) into "
                f"(B, {system.nx}), in float64, got {error}"
            ) from error

    def _new_module(self, system: System) -> torch.nn.Module:
        """Return a copy of the module with the weights before training."""
        import torch
        from torch import nn

        found = self.module
        if found is None:
            found = nn.Linear(system.nx + system.nu, system.nx)
            nn.init.zeros_(found.weight)
            nn.init.zeros_(found.bias)
        elif isinstance(found, str) and not is_object_text(found):
            found = named_in_plugin(found, object)()
        else:
            found = deepcopy(kept_object(found))
            found = getattr(found, "_orig_mod", found)  # what torch.compile was given
        if isinstance(found, torch.jit.ScriptModule):
            for weight in found.parameters():
                if not weight.is_leaf:  # in a copy of such a module
                    weight.detach_().requires_grad_()
        if not isinstance(found, nn.Module):
            raise InvalidArgument(f"torch_module: expected a torch.nn.Module, got a {type(found).__name__}")
        return found
