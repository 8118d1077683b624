"""Noise that a controller must not rely on the absence of: Jakobi's radical envelope (paper, section 2.1)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from sysid_evo.arrays import Array
from sysid_evo.dynamics import Dynamics
from sysid_evo.errors import InvalidArgument
from sysid_evo.registry import Registry
from sysid_evo.system import System
from sysid_evo.wrappers.delayed_estimate import DelayedEstimate
from sysid_evo.wrappers.noisy_sensors import NoisySensors
from sysid_evo.wrappers.perturbed import Perturbed
from sysid_evo.wrappers.spread import state_spread

noises: Registry[RadicalEnvelope] = Registry("noise", "sysid_evo.noises")
"""What ``--noise`` may name."""


@noises.register("envelope")
@dataclass(frozen=True)
class RadicalEnvelope:
    """How far a robot may differ from its model; 0 means that it does not.

    The *base set* is what is reliable: channels named in ``base`` (states and controls) meet no noise. All
    others do, and how much is drawn anew for every trial, from none to all of what stands here. Most trials
    therefore meet some noise and some hardly any, so that a controller can rely neither on its absence
    nor on its presence.

    | parameter | what | unit |
    |---|---|---|
    | ``sensor`` | white noise on what is observed of a state, at most | standard deviations of the training states |
    | ``bias`` | constant error of what is observed, its standard deviation over trials | the same |
    | ``latency`` | a command acts so many samples late, drawn from 0 to this | samples of dt |
    | ``dropout`` | probability that a command is lost and the last one held, at most | share of samples |
    | ``gain`` | a state changes faster or slower: its change in a step times exp(gain z) | 0.1: about 10 % |
    | ``scale`` | a state answers more or less, end values too: measured from neutral, times exp(scale z) | 0.1: 10 % |
    | ``effect`` | what a control adds to neutral, times exp(effect z) | 0.1: about 10 % |
    | ``process`` | white noise on a state in every step, at most | standard deviations of the training states |

    z is standard normal, one for each channel and trial. ``gain`` and ``scale`` spare periodic states.
    A family with one network or table for each command does not notice ``effect``.
    """

    sensor: float = 0.0
    bias: float = 0.0
    latency: int = 0
    dropout: float = 0.0
    gain: float = 0.0
    scale: float = 0.0
    effect: float = 0.0
    process: float = 0.0
    base: Sequence[str] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "base", tuple(self.base) if isinstance(self.base, (list, tuple)) else (self.base,))
        for item in fields(self):
            value = getattr(self, item.name)
            if item.name == "base":
                continue
            whole = item.name == "latency"
            number = isinstance(value, int if whole else (int, float)) and not isinstance(value, bool)
            if not number or not 0 <= value < np.inf:
                raise InvalidArgument(
                    f"noise: expected {item.name} to be {'a whole number' if whole else 'a number'} >= 0, got {value!r}"
                )
        if self.dropout > 1.0:
            raise InvalidArgument(f"noise: dropout is a probability, at most 1, got {self.dropout}")

    def check_system(self, system: System) -> None:
        """Raise `InvalidArgument` if the base set names a channel that ``system`` does not have."""
        known = [channel.name for channel in (*system.states, *system.controls)]
        unknown = [name for name in self.base if name not in known]
        if unknown:
            raise InvalidArgument(
                f"noise: the base set names {', '.join(map(repr, unknown))}; the channels are {', '.join(known)}"
            )

    def free(self, system: System) -> tuple[Array, Array]:
        """Return 1.0 for each state (nx,) and each control (nu,) that meets noise, 0.0 for those of the base set."""
        states, controls = (
            np.array([0.0 if channel.name in self.base else 1.0 for channel in channels])
            for channels in (system.states, system.controls)
        )
        return states, controls

    @property
    def perturbs(self) -> bool:
        """Whether the dynamics itself, or what it is commanded, differs from the model."""
        return any((self.latency, self.dropout, self.gain, self.scale, self.effect, self.process))


def disturbed(dynamics: Dynamics, noise: RadicalEnvelope, delay: float = 0.0) -> Dynamics:
    """Return ``dynamics`` as a controller meets it: with ``noise``, and observed ``delay`` s late."""
    noise.check_system(dynamics.system)
    spread = state_spread(dynamics)
    if noise.perturbs:
        dynamics = Perturbed(dynamics, noise, spread)
    if delay:
        dynamics = DelayedEstimate(dynamics, delay)
    return NoisySensors(dynamics, noise, spread) if noise.sensor or noise.bias else dynamics
