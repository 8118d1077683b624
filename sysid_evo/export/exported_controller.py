"""Content of an exported file: the program from observations to legal controls, names, units, and test vectors."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal, TypeAlias

import numpy as np

from sysid_evo.controllers.controller import Controller, View, make_controller
from sysid_evo.controllers.program import (
    OBSERVATION,
    Expression,
    Joined,
    Program,
    Statement,
    Variable,
    apply,
    choose,
    limited,
    number,
    take,
)
from sysid_evo.controllers.program import observation as variable
from sysid_evo.errors import InvalidArgument
from sysid_evo.evolution.champion import Champion
from sysid_evo.system import Channel, System, level_boundaries
from sysid_evo.tasks.raw import RawInterface
from sysid_evo.tasks.task import Task, TaskState, make_task
from sysid_evo.types import Array

Real: TypeAlias = Literal["float", "double"]

VECTORS = 20
"""Number of samples in the test vectors of a file."""
ATTEMPTS = 50


@dataclass(frozen=True)
class ExportedController:
    """An evolved controller with all data of an exported file.

    ``formulas`` explain observations whose names do not. ``program`` computes the ``controls`` (variables, one for each
    control of ``system``) from the observations. ``test_observations`` (T, n) and ``test_controls`` (T, nu) are the
    test vectors: one run from the initial memory. With ``raw``, observations and controls are the raw ones of an
    environment.
    """

    champion: Champion
    system: System
    observations: tuple[Channel, ...]
    formulas: Mapping[str, str]
    program: Program
    controls: tuple[Variable, ...]
    test_observations: Array
    test_controls: Array
    called: str = ""
    raw: RawInterface | None = None

    @property
    def name(self) -> str:
        """The name ``called``, by default the champion's name, as an identifier."""
        name = _identifier(self.called or self.champion.name).strip("_").lower()
        return name if name[:1].isalpha() else f"controller_{name}".rstrip("_")

    @property
    def origin(self) -> tuple[str, ...]:
        """Controller, task and models of its evolution, in a few lines."""
        champion = self.champion
        against = ", ".join(champion.against) or "nothing"
        lines = (
            f"controller {champion.name!r}: {champion.controller.text}",
            f"task {champion.task.shown}, evolved against {against} ({champion.aggregate})",
            f"Call it every {self.system.dt:g} s.",
            *(() if self.raw is None else ("Raw observation of the environment in, its raw action out.",)),
        )
        return tuple(_harmless(line) for line in lines)

    def rows(self, channels: tuple[Channel, ...]) -> list[str]:
        """Return a line for each channel: index, name, and formula, or unit and legal values."""
        width = max((len(channel.name) for channel in channels), default=0)
        texts = [self.formulas.get(channel.name) or _legal(channel) for channel in channels]
        return [
            _harmless(f"{i}  {channel.name:<{width}}  {text}".rstrip())
            for i, (channel, text) in enumerate(zip(channels, texts, strict=True))
        ]


def exported_controller(champion: Champion) -> ExportedController:
    """Return the exported form of ``champion``. Raises `InvalidArgument` if it cannot be exported."""
    if champion.system is None:
        raise InvalidArgument(f"export: {champion.name!r} is a human driver; only controllers can be exported")
    system = champion.system
    task = make_task(champion.task).bind(system)
    controller = make_controller(champion.controller).bind_to(task)
    program = controller.program(champion.parameters)
    if program is None:
        raise InvalidArgument(
            f"export: a controller {champion.controller.name!r} cannot be exported: {controller.not_exportable}. "
            "Controllers that can: recurrent, feed_forward, constant, linear, lqr, pid, policy, pursuit"
        )
    raw, observations, formulas = task.raw(), task.observations, task.formulas()
    if raw is not None:
        program = _of_raw(program, raw)
        observations, formulas = raw.observations, {}
        shown = [
            channel
            if numbers is None
            else Channel(channel.name, levels=tuple(map(float, numbers)), neutral=float(numbers[0]))
            for channel, numbers in zip(system.controls, raw.levels, strict=True)
        ]
        system = replace(system, controls=tuple(shown))
    actuated = _actuations(program, system)
    whole = replace(program, statements=(*program.statements, *actuated))
    controls = tuple(statement.value for statement in actuated)
    test_observations = _observations(whole, controls, observations)
    if raw is None:
        test_controls = expected_controls(controller, champion, task, test_observations)
    else:
        expected = expected_controls(controller, champion, task, raw.observed(test_observations))
        test_controls = raw.actions(expected, task.system.controls)
    return ExportedController(
        champion, system, observations, formulas, whole, controls, test_observations, test_controls, raw=raw
    )


def _of_raw(program: Program, raw: RawInterface) -> Program:
    """Return ``program`` with statements before it that compute its observation from the raw one."""
    given = variable(len(raw.observations))
    parts = []
    for value in raw.values:
        own = [take(f"RAW_OBSERVATION_{place}", given, place) for place in value.places]
        if not own:
            parts.append(number(1.0))
        elif len(own) == 2:
            parts.append(own[0] / apply("sqrt", own[0] * own[0] + own[1] * own[1]))
        elif value.angle:
            parts.append(apply("sin", own[0] if value.angle == "sine" else own[0] + 0.5 * math.pi))
        else:
            parts.append((own[0] - value.centre) / value.scale)
    seen = Statement("seen_of_task", Joined(len(parts), tuple(parts)), "observations of the task")
    statements = tuple(replace(one, expression=_replaced(one.expression, seen.value)) for one in program.statements)
    return replace(program, statements=(seen, *statements))


def _replaced(expression: Expression, seen: Variable) -> Expression:
    """Return ``expression`` with ``seen`` in place of the input of the program."""
    if isinstance(expression, Variable):
        return seen if expression.name == OBSERVATION and not expression.remembered else expression
    changed: dict[str, Any] = {
        name: _replaced(part, seen) for name, part in vars(expression).items() if isinstance(part, Expression)
    }
    if isinstance(expression, Joined):
        changed["parts"] = tuple(_replaced(part, seen) for part in expression.parts)
    return replace(expression, **changed) if changed else expression


def expected_controls(controller: Controller, champion: Champion, task: Task, test_observations: Array) -> Array:
    """Return the controls (T, nu) of a bound controller for a sequence of observations (T, n)."""
    memory, controls = np.zeros((1, 1, controller.n_memory)), []
    empty = TaskState(np.empty((0, 0)), np.empty((0, 0)), np.empty(0, dtype=bool))
    for row in test_observations:
        view = View(row[None, None], np.zeros((1, 1, task.system.nx)), empty)
        raw, memory = controller.act(champion.parameters[None], memory, view)
        controls.append(task.system.actuate(raw[0, 0]))
    return np.array(controls)


def _actuations(program: Program, system: System) -> list[Statement]:
    """Return a statement for each control that computes `System.actuate`."""
    system.actuate(np.zeros(system.nu))  # raises for a control that has neither limits nor levels
    made = []
    for i, channel in enumerate(system.controls):
        raw = take(f"RAW_{i}", program.result, i)
        control: Expression
        if channel.levels is None:
            half = (channel.high - channel.low) / 2.0
            control = (limited(raw) + 1.0) * half + channel.low
        else:
            control = number(channel.levels[0])
            for boundary, level in zip(level_boundaries(len(channel.levels)), channel.levels[1:], strict=True):
                control = choose(raw, ">=" if boundary < 0.0 else ">", boundary, level, control)
        made.append(Statement(f"control_{_identifier(channel.name)}", control, _harmless(_legal(channel))))
    return made


def _observations(program: Program, controls: tuple[Variable, ...], channels: tuple[Channel, ...]) -> Array:
    """Return observations (T, n) for which single and double precision give the same controls."""
    for seed in range(ATTEMPTS):
        rng = np.random.default_rng(seed)
        columns = [
            np.full(VECTORS, channel.neutral)
            if channel.name == "bias"
            else rng.uniform(channel.low, channel.high, VECTORS)
            if channel.bounded
            else channel.neutral + rng.standard_normal(VECTORS)
            for channel in channels
        ]
        test_observations = np.round(np.stack(columns, axis=1), 3)
        exact, single = (_run(program, controls, test_observations.astype(real)) for real in (np.float64, np.float32))
        if np.allclose(exact, single, rtol=1e-4, atol=1e-4):
            break
    return test_observations


def _run(program: Program, controls: tuple[Variable, ...], test_observations: Array) -> Array:
    only = [Program(program.statements, control, program.remembered) for control in controls]
    memory, test_controls = program.begin(), []
    for row in test_observations:
        results = [one.run(row, memory) for one in only]
        test_controls.append([float(value[0]) for value, _ in results])
        memory = results[0][1]
    return np.array(test_controls)


def _harmless(line: str) -> str:
    """Return ``line`` without characters that would end a comment or a string in one of the languages."""
    line = "".join(character if character.isprintable() else " " for character in line)
    return line.replace("\\", "/").replace('"', "'").replace("*/", "* /").replace("/*", "/ *")


def _identifier(name: str) -> str:
    return re.sub(r"\W+", "_", name, flags=re.ASCII)


def _legal(channel: Channel) -> str:
    parts = [channel.unit or "-"]
    if channel.levels is not None:
        parts.append("one of " + ", ".join(f"{level:g}" for level in channel.levels))
    elif channel.bounded:
        parts.append(f"{channel.low:g} to {channel.high:g}")
    elif channel.name == "bias":
        parts.append(f"always {channel.neutral:g}")
    return ", ".join(parts)
