"""A champion as what is written into a file: its program down to legal controls, test vectors, what numbers mean."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np

from sysid_evo.controllers.controller import Controller, View, make_controller
from sysid_evo.controllers.program import Expression, Program, Statement, Variable, choose, limited, number, take
from sysid_evo.errors import InvalidArgument
from sysid_evo.evolution.champion import Champion
from sysid_evo.system import Channel, System, level_boundaries
from sysid_evo.tasks.task import Task, TaskState, make_task
from sysid_evo.types import Array

Real: TypeAlias = Literal["float", "double"]

VECTORS = 20
"""Samples in the test vectors of a file."""
ATTEMPTS = 50


@dataclass(frozen=True)
class ExportedController:
    """A controller that was evolved, ready to be written.

    ``formulas`` say how observations are computed, where their names do not. ``program`` goes from the observations
    to the ``controls`` (names of its statements, one for each control of ``system``). ``seen`` (T, n) and ``decided``
    (T, nu) are its test vectors: one run from the memory's start.
    """

    champion: Champion
    system: System
    observations: tuple[Channel, ...]
    formulas: Mapping[str, str]
    program: Program
    controls: tuple[Variable, ...]
    seen: Array
    decided: Array
    called: str = ""

    @property
    def name(self) -> str:
        """What it is ``called``, by default the champion's name, as an identifier."""
        name = _identifier(self.called or self.champion.name).strip("_").lower()
        return name if name[:1].isalpha() else f"controller_{name}".rstrip("_")

    @property
    def origin(self) -> tuple[str, ...]:
        """Where it comes from, in a few lines."""
        champion = self.champion
        against = ", ".join(champion.against) or "nothing"
        lines = (
            f"controller {champion.name!r}: {champion.controller.text}",
            f"task {champion.task.text}, evolved against {against} ({champion.aggregate})",
            f"Call it once every {self.system.dt:g} s.",
        )
        return tuple(_harmless(line) for line in lines)

    def rows(self, channels: tuple[Channel, ...]) -> list[str]:
        """Return a line for each channel: its place, name, and its formula, or unit and legal values."""
        width = max((len(channel.name) for channel in channels), default=0)
        texts = [self.formulas.get(channel.name) or _legal(channel) for channel in channels]
        return [
            _harmless(f"{i}  {channel.name:<{width}}  {text}".rstrip())
            for i, (channel, text) in enumerate(zip(channels, texts, strict=True))
        ]


def exported_controller(champion: Champion) -> ExportedController:
    """Return ``champion`` ready to be written. Raises `InvalidArgument` for one that cannot be."""
    if champion.system is None:
        raise InvalidArgument(f"export: {champion.name!r} is somebody who drives by hand, not a controller")
    system = champion.system
    task = make_task(champion.task).bind(system)
    controller = make_controller(champion.controller).bind_to(task)
    program = controller.program(champion.parameters)
    if program is None:
        raise InvalidArgument(
            f"export: a controller {champion.controller.name!r} cannot be written as a file of its own: "
            f"{controller.not_exportable}. The controllers recurrent, feed_forward, constant, linear, lqr, pid, policy "
            "and pursuit can"
        )
    actuated = _actuations(program, system)
    whole = replace(program, statements=(*program.statements, *actuated))
    controls = tuple(statement.value for statement in actuated)
    seen = _observations(whole, controls, task.observations)
    decided = decided_by(controller, champion, task, seen)
    return ExportedController(champion, system, task.observations, task.formulas(), whole, controls, seen, decided)


def decided_by(controller: Controller, champion: Champion, task: Task, seen: Array) -> Array:
    """Return the controls (T, nu) of a bound controller on observations (T, n), one after the other."""
    memory, controls = np.zeros((1, 1, controller.n_memory)), []
    nobody = TaskState(np.empty((0, 0)), np.empty((0, 0)), np.empty(0, dtype=bool))
    for row in seen:
        view = View(row[None, None], np.zeros((1, 1, task.system.nx)), nobody)
        raw, memory = controller.act(champion.parameters[None], memory, view)
        controls.append(task.system.actuate(raw[0, 0]))
    return np.array(controls)


def _actuations(program: Program, system: System) -> list[Statement]:
    """Return a statement for each control that does what `System.actuate` does."""
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
    """Return observations (T, n) on which single and double precision decide alike."""
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
        seen = np.round(np.stack(columns, axis=1), 3)
        exact, single = (_run(program, controls, seen.astype(real)) for real in (np.float64, np.float32))
        if np.allclose(exact, single, rtol=1e-4, atol=1e-4):
            break
    return seen


def _run(program: Program, controls: tuple[Variable, ...], seen: Array) -> Array:
    only = [Program(program.statements, control, program.remembered) for control in controls]
    memory, decided = program.begin(), []
    for row in seen:
        results = [one.run(row, memory) for one in only]
        decided.append([float(value[0]) for value, _ in results])
        memory = results[0][1]
    return np.array(decided)


def _harmless(line: str) -> str:
    """Return ``line`` so that it ends no comment and no text in any of the languages."""
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
