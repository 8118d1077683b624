"""Raw observations and actions of a Gymnasium environment, as an exported controller takes and gives them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from hardware.simulators.gymnasium_spaces import make_environment, observation_map
from sysid_evo.system import Channel, System
from sysid_evo.tasks.raw import RawInterface, RawValue

if TYPE_CHECKING:
    import gymnasium


def raw_interface(
    name: str, settings: Mapping[str, Any], angle: str, system: System, scale: Sequence[float]
) -> RawInterface:
    """Return raw observations and actions of the environment ``name`` whose task is bound to ``system``."""
    env = make_environment(name, settings)
    try:
        observations, _ = observation_map(f"environment {name}", env.observation_space, angle)
        values = [RawValue()]
        for i, places in enumerate(observations.places):
            if i not in observations.wrapped:
                values.append(RawValue(places, float(system.neutral_state[i]), float(scale[i])))
            elif len(places) == 2:
                cosine, sine = places
                values += [RawValue((sine, cosine)), RawValue((cosine, sine))]
            else:
                values += [RawValue(places, angle="sine"), RawValue(places, angle="cosine")]
        size = env.observation_space.shape
        assert size is not None
        channels = tuple(_channel(env.observation_space, i) for i in range(size[0]))
        return RawInterface(channels, tuple(values), *_actions(env.action_space))
    finally:
        env.close()


def _channel(space: gymnasium.Space[Any], place: int) -> Channel:
    low, high = (float(getattr(space, side)[place]) for side in ("low", "high"))
    huge = 1e6
    return Channel(
        f"observation_{place}", low=low if low > -huge else -float("inf"), high=high if high < huge else float("inf")
    )


def _actions(space: gymnasium.Space[Any]) -> tuple[tuple[tuple[int, ...] | None, ...], str, tuple[int, ...]]:
    """Return raw actions of the levels of each control, and type and shape of an action."""
    from gymnasium import spaces

    if isinstance(space, spaces.Discrete):
        return (tuple(int(space.start) + i for i in range(int(space.n))),), "integer", ()
    if isinstance(space, spaces.MultiDiscrete):
        starts = [int(first) for first in getattr(space, "start", [0] * len(space.nvec))]
        found = tuple(tuple(a + i for i in range(int(n))) for a, n in zip(starts, space.nvec, strict=True))
        return found, "integers", (len(found),)
    if isinstance(space, spaces.MultiBinary):
        return ((0, 1),) * int(space.shape[0]), "integers", (int(space.shape[0]),)
    assert isinstance(space, spaces.Box)
    shape = tuple(int(n) for n in space.shape)
    count = 1
    for n in shape:
        count *= n
    return (None,) * count, "array", shape
