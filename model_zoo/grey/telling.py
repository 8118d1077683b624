"""What a grey box says in names: where its channels stand, tables of its parameters and of what differs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from model_zoo.grey.parameter import Parameter
from sysid_evo.arrays import Array
from sysid_evo.dynamics import DynamicsModel
from sysid_evo.errors import IncompatibleSystem, InvalidArgument
from sysid_evo.system import System


def parameter_rows(
    parameters: Sequence[Parameter], values: Array, errors: Array, determined: Sequence[bool]
) -> list[dict[str, Any]]:
    """Return a row for every parameter: value and standard error (n,), unit, bounds, whether the data determine it."""
    return [
        {
            "parameter": parameter.name,
            "value": float(value),
            "standard error": float(error),
            "unit": parameter.unit,
            "low": parameter.low,
            "high": parameter.high,
            "determined": known,
        }
        for parameter, value, error, known in zip(parameters, values, errors, determined, strict=True)
    ]


def offset_rows(
    parameters: Sequence[Parameter], recordings: Iterable[str], names: Sequence[str], offsets: Iterable[Array]
) -> list[dict[str, Any]]:
    """Return a row for every recording and every one of ``names``, with how much more or less it is there."""
    units = {parameter.name: parameter.unit for parameter in parameters}
    return [
        {"recording": recording, "parameter": name, "offset": float(offset), "unit": units[name]}
        for recording, row in zip(recordings, offsets, strict=True)
        for name, offset in zip(names, row, strict=True)
    ]


def offset_note(parameters: Sequence[Parameter], names: Sequence[str], spreads: Iterable[float]) -> str:
    """Return by how much the parameters ``names`` differ from recording to recording, in a sentence."""
    units = {parameter.name: parameter.unit for parameter in parameters}
    pairs = zip(names, spreads, strict=True)
    each = ", ".join(f"{name} by {spread:.2g} {units[name]}".rstrip() for name, spread in pairs)
    return f"from recording to recording there differ {each} (standard deviation)"


def residual_note(share: float, kept: float, without: float) -> str:
    """Return how much of a residual is kept, and what free runs in held-out blocks say of it, in a sentence."""
    return (
        f"{100 * share:.0f} % of the residual is kept: N over a second in held-out blocks is "
        f"{kept:.3f}, {without:.3f} without it"
    )


def named_places(model: DynamicsModel, what: str, wanted: Sequence[str], there: Sequence[str]) -> tuple[int, ...]:
    """Return where the ``wanted`` channels stand among those that are ``there``; all of them if none are named."""
    for name in wanted:
        if name not in there:
            raise IncompatibleSystem(
                f"{type(model).__name__} needs the {what} {name!r}: the system has {', '.join(there) or 'none'}"
            )
    return tuple(there.index(name) for name in wanted) if wanted else tuple(range(len(there)))


def known_rates(
    model: DynamicsModel, speeds: Mapping[str, str], system: System, accelerates: bool
) -> tuple[tuple[int, int], ...]:
    """Return where each position of ``speeds`` and its rate stand in ``system``.

    Raises `InvalidArgument` for speeds of a family that does not write accelerations.
    """
    if not speeds:
        return ()
    if not accelerates:
        raise InvalidArgument(
            f"{type(model).__name__}: speeds says which rates are known, but rate gives those of all states: write "
            "acceleration(state, control, p) in its place"
        )
    positions, rates = (
        named_places(model, "state", tuple(names), system.state_names) for names in (speeds, speeds.values())
    )
    return tuple(zip(positions, rates, strict=True))
