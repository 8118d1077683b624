"""Conversion of fitted models to systems of python-control."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from sysid_evo.carry import CarryLayout
from sysid_evo.errors import MissingExtra
from sysid_evo.models.dynamics import Dynamics

if TYPE_CHECKING:
    import control


def to_control(model: Dynamics, *, name: str | None = None) -> control.NonlinearIOSystem:
    """Return ``model`` as a discrete `control.NonlinearIOSystem` at its ``dt``.

    Its inputs are the controls, its outputs the states of the system, by name; its state is the
    carry: the states, then all other memory of the model (``yaw_rate[-1]`` is that of the sample before).
    There is no noise and no clipping. Raises `MissingExtra` if python-control is not installed,
    `IncompatibleSystem` with `System.advance`.
    """
    try:
        import control
    except ModuleNotFoundError as error:
        raise MissingExtra("to_control needs python-control: pip install 'sysid-evo[control]'") from error

    system = model.system
    system.check_causal("to_control")
    layout = CarryLayout(system.nx, system.nu, *getattr(model, "lags", (0, 0)))
    names = layout.input_names(system.state_names, system.control_names)[: layout.size]

    def update(_: float, x: np.ndarray, u: np.ndarray, _params: Mapping[str, Any]) -> np.ndarray:
        return model.step(np.atleast_2d(x).astype(float), np.atleast_2d(u).astype(float))[0]

    def output(_: float, x: np.ndarray, _u: np.ndarray, _params: Mapping[str, Any]) -> np.ndarray:
        return np.asarray(x)[: system.nx]

    return control.NonlinearIOSystem(
        update,
        output,
        inputs=list(system.control_names),
        outputs=list(system.state_names),
        states=[*names, *(f"carry[{i}]" for i in range(layout.size, model.n_carry))],
        dt=system.dt,
        name=name or type(model).__name__,
    )
