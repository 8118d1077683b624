"""Adapters of functions, and of objects of pysindy, python-control and PyTorch."""

from __future__ import annotations

import inspect
import re
from types import FunctionType, ModuleType
from typing import Any

import numpy as np

from sysid_evo import Adapter, DynamicsModel, make_model, register_adapter
from sysid_evo.errors import InvalidArgument
from sysid_evo.laws import keep_source
from sysid_evo.models import bases_of
from sysid_evo.registry.objects import class_name, keep_object
from sysid_evo.registry.plugins import PREFIX

DEFAULT_LABEL = re.compile(r"[uy]\[\d+\]")
"""Names that python-control gives to inputs and outputs without names."""


@register_adapter("function")
class FunctionAdapter(Adapter):
    """Functions f(x, u) or f(x, u, p) of NumPy, as the family `equations`."""

    example = "lambda x, u: -x"

    def recognises(self, thing: object) -> bool:
        return isinstance(thing, FunctionType)

    def model(self, thing: Any, *, fitted: bool = False) -> DynamicsModel:
        if fitted and len(inspect.signature(thing).parameters) > 2:
            raise InvalidArgument(
                f"{thing.__name__}: p has bounds but no values: write them into it, or let them be fitted"
            )
        keep_source(thing)  # that of a cell of a notebook, for processes that do not have it
        return make_model("equations", function=definition(thing) or keep_object(thing, self.content(thing)))

    def content(self, thing: Any) -> object:
        """Return the code and all values that the function sees, but not its name."""
        seen, code = inspect.getclosurevars(thing), thing.__code__
        values = {**seen.globals, **seen.nonlocals}
        named = {name: value for name, value in values.items() if not isinstance(value, (ModuleType, FunctionType))}
        return code.co_code, repr(code.co_consts), code.co_names, thing.__defaults__, named


@register_adapter("pysindy")
class PySindyAdapter(Adapter):
    """Objects of pysindy, ``SINDy`` and ``DiscreteSINDy``, as the family `pysindy`."""

    example = "pysindy.SINDy()"

    def recognises(self, thing: object) -> bool:
        return bool(bases_of(thing) & {"pysindy._BaseSINDy", "pysindy.BaseOptimizer"})

    def model(self, thing: Any, *, fitted: bool = False) -> DynamicsModel:
        if "pysindy.BaseOptimizer" in bases_of(thing):
            raise InvalidArgument(
                f"expected a SINDy, got its optimizer: models=[pysindy.SINDy(optimizer={class_name(thing)}(...))]"
            )
        return make_model("pysindy", model=keep_object(thing), fitted=fitted or hasattr(thing, "n_features_in_"))


@register_adapter("control")
class ControlAdapter(Adapter):
    """Systems of python-control, ``StateSpace`` and ``TransferFunction``, as the family `lti`."""

    example = "control.tf([1], [1, 1])"

    def recognises(self, thing: object) -> bool:
        return "control.InputOutputSystem" in bases_of(thing)

    def model(self, thing: Any, *, fitted: bool = False) -> DynamicsModel:
        import control

        if not bases_of(thing) & {"control.StateSpace", "control.TransferFunction"}:
            nonlinear = hasattr(thing, "dynamics")
            instead = "'linear_state_space', which is fitted to the recording"
            instead = "lambda x, u: system.dynamics(0, x, u)" if nonlinear else instead
            raise InvalidArgument(
                f"expected a state space or transfer function, got {class_name(thing)}: pass {instead}"
            )
        system = control.ss(thing)
        parts = [np.asarray(part, dtype=np.float64).tolist() for part in (system.A, system.B, system.C, system.D)]
        names = {"outputs": system.output_labels, "inputs": system.input_labels}
        given = {key: labels for key, labels in names.items() if not all(map(DEFAULT_LABEL.fullmatch, labels))}
        return make_model("lti", model=parts if system.dt is None else [*parts, system.dt], **given)


@register_adapter("torch")
class TorchAdapter(Adapter):
    """Modules of PyTorch, as the family `torch_module`."""

    example = "torch.nn.Linear(3, 2)"

    def recognises(self, thing: object) -> bool:
        return "torch.Module" in bases_of(thing)

    def model(self, thing: Any, *, fitted: bool = False) -> DynamicsModel:
        return make_model("torch_module", module=keep_object(thing, self.content(thing)), fitted=fitted)

    def content(self, thing: Any) -> object:
        """Return the printed module and its weights."""
        return repr(thing), {name: weight.cpu().double().numpy() for name, weight in thing.state_dict().items()}


def definition(thing: Any) -> str:
    """Return the name of a function or class of a plugin file, by which a spec finds it; empty for others."""
    module = thing.__module__
    named = module.startswith(PREFIX) and "." not in thing.__qualname__
    return f"{module.removeprefix(PREFIX)}.{thing.__name__}" if named else ""
