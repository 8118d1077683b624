"""Export of a controller as a Python file that needs NumPy only."""

from __future__ import annotations

from sysid_evo.controllers.program import (
    Binary,
    Choice,
    ConstantVector,
    Dot,
    Expression,
    Joined,
    Number,
    Take,
    Unary,
    Variable,
    parts_of,
)
from sysid_evo.export.exported_controller import ExportedController
from sysid_evo.types import Array

SUM, PRODUCT, ATOM = 1, 2, 3
"""Precedence of expressions."""

TEMPLATE = '''\
"""{origin}

{seen}, in this order:
{observations}

{given}, in this order:
{controls}

{usage}

Run this file to check it against the original controller.
"""

import numpy as np

DT = {dt!r}  # s
OBSERVATIONS = {observation_names}
CONTROLS = {control_names}

{tables}


class Controller:
    """The controller; it needs NumPy only."""

    def __init__(self):
        self.reset()

    def reset(self):
        """Reset the memory before a run."""
{reset}

    def step(self, observation):
        """Return the controls ({nu},) for one observation ({n},)."""
        observation = np.asarray(observation, dtype=float)
        if observation.shape != ({n},):
            raise ValueError(f"observation: expected shape ({n},), got {{observation.shape}}")
{statements}
{after}        return np.concatenate([{results}])
{call}

{vectors}


if __name__ == "__main__":
    controller = Controller()
    for observation, expected in zip(TEST_OBSERVATIONS, TEST_CONTROLS):
        np.testing.assert_allclose(controller.step(observation), expected, atol=1e-9)
    print(f"ok: {{len(TEST_OBSERVATIONS)}} samples")
'''


USAGE = """\
    controller = Controller()
    control = controller.step(observation)  # every {dt:g} s
    controller.reset()                      # before another run"""
RAW_USAGE = """\
    controller = Controller()
    observation, _ = env.reset()
    observation, reward, terminated, truncated, _ = env.step(controller(observation))
    controller.reset()  # before another episode"""
CALL = '''
    def __call__(self, observation):
        """Return the raw action of the environment for its raw observation ({n},)."""
        return {action}
'''
ACTIONS = {
    "integer": "int(self.step(observation)[0])",
    "integers": "self.step(observation).astype(int)",
    "array": "self.step(observation).reshape({shape})",
}


def python_text(controller: ExportedController) -> str:
    """Return the text of the Python file."""
    program, raw, n = controller.program, controller.raw, len(controller.observations)
    action = "" if raw is None else ACTIONS[raw.kind].format(shape=raw.shape)
    tables = "\n".join(f"{name} = {_table(values)}" for name, values in program.constants().items())
    reset = [f"self.{name} = np.zeros({value.size})" for name, value in program.remembered.items()]
    statements = []
    for statement in program.statements:
        remark = f"  # {statement.remark}" if statement.remark else ""
        text = _text(statement.expression)[0]
        vectors = (Variable, ConstantVector, Dot, Take, Joined)
        if not any(isinstance(part, vectors) for part in parts_of(statement.expression)):
            text = f"np.array([{text}])"
        statements.append(f"{statement.name} = {text}{remark}")
    after = [f"self.{name} = {value.name}" for name, value in program.remembered.items()]
    return TEMPLATE.format(
        origin="\n".join(controller.origin),
        observations=_indented(controller.rows(controller.observations), 4),
        controls=_indented(controller.rows(controller.system.controls), 4),
        dt=controller.system.dt,
        seen="Observations" if raw is None else "Raw observation of the environment",
        given="Controls" if raw is None else "Raw action of the environment",
        usage=(USAGE if raw is None else RAW_USAGE).format(dt=controller.system.dt),
        call="" if raw is None else CALL.format(n=n, action=action),
        observation_names=tuple(channel.name for channel in controller.observations),
        control_names=controller.system.control_names,
        tables=tables,
        reset=_indented(reset or ["pass"], 8),
        n=len(controller.observations),
        nu=controller.system.nu,
        statements=_indented(statements, 8),
        after=_indented(after, 8) + "\n" if after else "",
        results=", ".join(control.name for control in controller.controls),
        vectors=(
            f"TEST_OBSERVATIONS = {_table(controller.test_observations)}\n"
            f"TEST_CONTROLS = {_table(controller.test_controls)}"
        ),
    )


def _indented(lines: list[str], spaces: int) -> str:
    return "\n".join(" " * spaces + line for line in lines)


def _table(values: Array) -> str:
    if values.ndim == 1:
        return f"np.array([{', '.join(repr(value) for value in values.tolist())}])"
    rows = "".join(f"    [{', '.join(repr(value) for value in row)}],\n" for row in values.tolist())
    return f"np.array([\n{rows}])"


def _text(e: Expression) -> tuple[str, int]:
    """Return an expression in Python, and its precedence."""
    match e:
        case Number():
            return (repr(e.value), ATOM) if e.value >= 0.0 else (f"({e.value!r})", ATOM)
        case Variable():
            return (f"self.{e.name}" if e.remembered else e.name), ATOM
        case ConstantVector():
            return e.name, ATOM
        case Dot():
            return f"{e.name} @ {_text(e.of)[0]}", PRODUCT
        case Take():
            inside = f"{e.places[0]}:{e.places[0] + 1}" if e.size == 1 else e.name
            return f"{_text(e.of)[0]}[{inside}]", ATOM
        case Unary():
            name = {"round": "rint"}.get(e.function, e.function)
            return f"np.{name}({_text(e.of)[0]})", ATOM
        case Joined():
            return f"np.hstack([{', '.join(_text(part)[0] for part in e.parts)}])", ATOM
        case Choice():
            parts = (_text(part)[0] for part in (e.left, e.right, e.yes, e.no))
            return "np.where({} {operator} {}, {}, {})".format(*parts, operator=e.operator), ATOM
        case Binary() if e.operator in ("min", "max"):
            return f"np.{e.operator}imum({_text(e.left)[0]}, {_text(e.right)[0]})", ATOM
        case Binary():
            own = SUM if e.operator in "+-" else PRODUCT
            (left, left_precedence), (right, right_precedence) = _text(e.left), _text(e.right)
            left = f"({left})" if left_precedence < own else left
            equal = right_precedence == own and (e.operator in "-/" or isinstance(e.right, Dot))
            return f"{left} {e.operator} {f'({right})' if right_precedence < own or equal else right}", own
        case _:
            raise TypeError(f"export: expected an expression, got {type(e).__name__}")
