"""A neural ordinary differential equation whose states are not measured: the mean of several, trained on free runs."""

from __future__ import annotations

from typing import Any, ClassVar

from model_zoo.hidden.ensemble import NetworkSpaces
from sysid_evo import register_model


@register_model("latent_ode")
class LatentOde(NetworkSpaces):
    """dx/dt = A x + B u + c + W units(V (x, u, 1)), y = C x + d, the control held over a sample; + K (y - C x - d).

    A neural ODE (Chen et al. 2018) of which outputs alone are measured: of the states x the first are the outputs
    without noise, the others are latent. One step of the classical Runge-Kutta method takes them from sample to sample.
    It begins at linear differential equations of ascending orders, whose step is that of linear state spaces found by a
    subspace method, and is trained, chosen and averaged as `NonlinearStateSpace` is: Levenberg-Marquardt on free runs
    of 100 and at last of ``horizon`` steps through the derivatives of the Runge-Kutta steps, the initial state of each
    run free (multiple shooting), a normal prior on W and V. An observer with the gain K of a Kalman predictor corrects
    the states after each step where outputs are measured, and finds the first from the last samples.
    """

    presets: ClassVar[dict[str, dict[str, Any]]] = {
        "quick": {"members": 2, "mixtures": 3, "trial": 5, "iterations": 10, "horizon": 200, "most_steps": 3000}
    }
    continuous: ClassVar[bool] = True
