"""A reward of one's own as a task: one function of states and controls by their names, and one line."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Self, TypeVar

import numpy as np

from sysid_evo.arrays import Array, BoolArray
from sysid_evo.errors import IncompatibleTask, InvalidArgument
from sysid_evo.registry import register_task
from sysid_evo.system import System
from sysid_evo.tasks.reward import Reward

if TYPE_CHECKING:
    from sysid_evo.kernels import Picked, TaskKernel

F = TypeVar("F", bound=Callable[..., Any])
RESERVED = "horizon"


class NamedReward(Reward):
    """The mean over the horizon of a ``function`` of states and controls, whose arguments are called as these are.

    Arguments that ``constants`` names get those numbers. ``ended`` is a function of the same kind of the state that is
    reached, and of the control that led there. ``start`` holds, by the names of states, between which two values a
    trial begins; other states begin at rest. With ``compiled`` both functions are compiled: they must be written in
    plain numbers and `math`, as kernels are. See `Reward` for ``lowest``. `bind` raises `IncompatibleTask` for
    an argument that is no state, control or constant.
    """

    def __init__(
        self,
        name: str,
        function: Callable[..., Any],
        *,
        lowest: float,
        constants: Mapping[str, float],
        ended: Callable[..., Any] | None = None,
        start: Mapping[str, tuple[float, float]] | None = None,
        horizon: int = 300,
        compiled: bool = True,
        unit: str = "reward a step",
    ) -> None:
        super().__init__(self._worth, lowest=lowest, horizon=horizon, unit=unit)
        self.name, self.function, self.over, self.compiled = name, function, ended, compiled
        self.constants, self.begins = dict(constants), dict(start or {})
        for constant, value in self.constants.items():
            if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
                raise InvalidArgument(f"{name}: {constant}: expected a finite number, got {value!r}")

    def check_system(self, system: System) -> None:
        known = (*system.state_names, *system.control_names, *self.constants)
        wanted = [name for function in (self.function, self.over) if function for name in arguments_of(function)]
        for name in (*wanted, *self.begins):
            if name not in known or (name in self.begins and name not in system.state_names):
                what = "a state" if name in self.begins else "a state, a control or an argument with a default"
                raise IncompatibleTask(
                    f"{self.name} needs {name!r} as {what}; states: {', '.join(system.state_names)}, controls: "
                    f"{', '.join(system.control_names) or 'none'}"
                )

    def bind(self, system: System) -> Self:
        bound = super().bind(system)
        bound.worth = bound._worth
        bound.ended = None
        bound.start = bound._drawn if self.begins else None
        return bound

    def over_after(self, control: Array, after: Array) -> BoolArray:
        if self.over is None:
            return np.zeros(len(after), dtype=bool)
        return np.array([bool(self._value(self.over, *row)) for row in zip(after, control, strict=True)])

    def kernel(self) -> TaskKernel[Any] | None:
        if not self.compiled:
            return None
        from sysid_evo.engine.kernels.reward import reward_kernel

        over = None if self.over is None else self._picked(self.over)
        return reward_kernel(self.system, self._picked(self.function), self.lowest, self.horizon, over)

    def _worth(self, states: Array, controls: Array) -> Array:
        return np.array([self._value(self.function, *row) for row in zip(states, controls, strict=True)])

    def _value(self, function: Callable[..., Any], state: Array, control: Array) -> float:
        """Return what ``function`` gives for one state and control; nan where it divides by 0 and the like."""
        known = dict(zip(self.system.state_names, state.tolist(), strict=True))
        known |= dict(zip(self.system.control_names, control.tolist(), strict=True)) | self.constants
        try:
            return float(function(*(known[name] for name in arguments_of(function))))
        except (ArithmeticError, ValueError):
            return math.nan

    def _picked(self, function: Callable[..., Any]) -> Picked:
        from sysid_evo.kernels import Picked

        places = {name: f"x[{i}]" for i, name in enumerate(self.system.state_names)}
        places |= {name: f"u[{i}]" for i, name in enumerate(self.system.control_names)}
        places |= {name: f"_real({float(value)!r})" for name, value in self.constants.items()}
        return Picked(function, tuple(places[name] for name in arguments_of(function)))

    def _drawn(self, rng: np.random.Generator) -> Array:
        state = self.system.neutral_state.copy()
        for name, (low, high) in self.begins.items():
            state[self.system.state_names.index(name)] = rng.uniform(low, high)
        return state


def arguments_of(function: Callable[..., Any]) -> tuple[str, ...]:
    """Return the names of the arguments of ``function``, in order."""
    return tuple(inspect.signature(function).parameters)


def register_reward(
    name: str,
    *,
    lowest: float,
    horizon: int = 300,
    ended: Callable[..., Any] | None = None,
    start: Mapping[str, tuple[float, float]] | None = None,
    compiled: bool = True,
    unit: str = "reward a step",
) -> Callable[[F], F]:
    """Return a decorator that registers a function as the task ``name``, see `NamedReward`.

    The function's arguments are states and controls by name; those with a default are parameters of the task, as
    ``horizon`` is: ``NAME(horizon=200, weight=0.5)``. Raises `InvalidArgument` for other kinds of arguments.
    """

    def decorate(function: F) -> F:
        found = inspect.signature(function).parameters
        odd = [p.name for p in found.values() if p.kind is not p.POSITIONAL_OR_KEYWORD or p.name == RESERVED]
        if odd:
            raise InvalidArgument(
                f"reward {name!r}: expected arguments called as states and controls are, each by its name, and none "
                f"called {RESERVED}; got {', '.join(odd)}"
            )
        defaults = {p.name: p.default for p in found.values() if p.default is not p.empty}

        def make(*, horizon: int = horizon, **constants: float) -> NamedReward:
            return NamedReward(
                name,
                function,
                lowest=lowest,
                constants={**defaults, **constants},
                ended=ended,
                start=start,
                horizon=horizon,
                compiled=compiled,
                unit=unit,
            )

        only = inspect.Parameter.KEYWORD_ONLY
        settable = {RESERVED: horizon, **defaults}
        signature = inspect.Signature([inspect.Parameter(key, only, default=value) for key, value in settable.items()])
        make.__dict__["__signature__"] = signature
        make.__module__, make.__qualname__, make.__doc__ = function.__module__, function.__qualname__, function.__doc__
        register_task(name)(make)
        return function

    return decorate
