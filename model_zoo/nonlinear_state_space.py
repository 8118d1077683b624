"""A nonlinear state space whose states are not measured: the mean of several small networks trained on free runs."""

from __future__ import annotations

from typing import Any, ClassVar

from model_zoo.hidden.ensemble import NetworkSpaces
from sysid_evo import register_model


@register_model("nonlinear_state_space")
class NonlinearStateSpace(NetworkSpaces):
    """x' = A x + B u + c + W units(V (x, u, 1)) + K (y - C x - d), y = C x + d: free runs fitted by shooting.

    It begins at linear state spaces (subspace and output error) of ascending orders, from 2 or the number of outputs
    on to 6 at most, unless ``order`` is given. From each begin networks of ``hidden`` units, of each of so many
    ``mixtures`` of kinds: smooth (tanh), kinked, sharply kinked, cubic, products, and units that see the controls
    alone. They are trained by Levenberg-Marquardt with analytic gradients on free runs of 100 and at last of
    ``horizon`` steps, the initial state of each free, with a normal prior on W and V; residuals that are alike for long
    count less. After ``trial`` iterations they are judged by the Bayesian information criterion (Schwarz 1978) of long
    free runs that begin where an observer finds the state; no higher order is tried once two in a row are no better.
    The best networks of the best two orders go on, and the lower criterion decides. More networks of that order begin
    with the mixtures that did best, and after twice ``trial`` further iterations the best ``members`` of all go on for
    ``iterations``, and for as many on long runs. While wider ones that begin at them, of ``hidden`` more units, have
    a lower criterion, these join them. The output is the mean of the best, in which one counts less the higher its
    criterion is, and one that goes astray under the recorded controls in another order not at all; each has its own
    hidden states and its own gain K.

    Where the criterion of a linear space is lower than that of every network, that one is the model. Of a record
    of less than 600 samples, which may not tell so many weights, `linear_state_space` is the model unless networks are
    a tenth better in free runs on held-out blocks of time; ``gated=False`` leaves that out. ``fit_note`` says so.
    """

    presets: ClassVar[dict[str, dict[str, Any]]] = {
        "quick": {"members": 3, "mixtures": 4, "trial": 6, "iterations": 15, "horizon": 300, "most_steps": 3000}
    }
    continuous: ClassVar[bool] = False
