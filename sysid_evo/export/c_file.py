"""Export of a controller as a C99 file without allocation, for a microcontroller."""

from __future__ import annotations

import numpy as np

from sysid_evo.controllers.program import (
    OBSERVATION,
    Binary,
    Choice,
    ConstantVector,
    Dot,
    Expression,
    Joined,
    Number,
    Statement,
    Take,
    Unary,
    Variable,
    parts_of,
)
from sysid_evo.export.exported_controller import ExportedController, Real
from sysid_evo.types import Array

FUNCTIONS = {"tanh": "tanh", "abs": "fabs", "round": "rint", "sqrt": "sqrt", "sin": "sin", "min": "fmin", "max": "fmax"}

TEMPLATE = """\
/* {origin}
 *
 * C99 in {real} precision; no allocation, no input or output, no library but <math.h>.
 *
 * Observations, in this order:
{observations}
 *
 * Controls, in this order:
{controls}
 *
 *     {name}_memory memory;
 *     {name}_reset(&memory);                      before every run
 *     {name}_step(&memory, observation, control); every {dt:g} s
 *
 * Declare these in your program (declarations below). To check this file against the original controller:
 *     cc -std=c99 -DTEST_{upper} {file} -lm -o check && ./check
 */

#include <math.h>
#include <stddef.h>

typedef {real} {name}_real;

enum {{ {upper}_OBSERVATIONS = {n}, {upper}_CONTROLS = {nu} }};
#define {upper}_DT {dt!r} /* s */

/* Memory of the controller from one sample to the next. */
typedef struct {name}_memory {{
{memory}
}} {name}_memory;

void {name}_reset({name}_memory *memory);
void {name}_step({name}_memory *memory, const {name}_real observation[{n}], {name}_real control[{nu}]);

{tables}
{dot}/* Reset the memory before a run. */
void {name}_reset({name}_memory *memory)
{{
{reset}
}}

/* Compute the controls of this sample. */
void {name}_step({name}_memory *memory, const {name}_real observation[{n}], {name}_real control[{nu}])
{{
{statements}
}}

#ifdef TEST_{upper}
#include <stdio.h>

{vectors}
int main(void)
{{
    {name}_memory memory;
    {name}_real control[{nu}];
    {name}_reset(&memory);
    for (size_t k = 0; k < {samples}; ++k) {{
        {name}_step(&memory, TEST_OBSERVATIONS[k], control);
        for (size_t i = 0; i < {nu}; ++i) {{
            if (!({fabs}(control[i] - TEST_CONTROLS[k][i]) <= {tolerance})) {{
                printf("sample %u, control %u: expected %g, got %g\\n", (unsigned)k, (unsigned)i,
                       (double)TEST_CONTROLS[k][i], (double)control[i]);
                return 1;
            }}
        }}
    }}
    printf("ok: {samples} samples\\n");
    return 0;
}}
#endif
"""
DOT = """\
/* Dot product of a row of weights and a vector. */
static {name}_real dot(const {name}_real *weights, const {name}_real *vector, size_t n)
{{
    {name}_real total = {zero};
    for (size_t i = 0; i < n; ++i)
        total += weights[i] * vector[i];
    return total;
}}

"""


def c_text(controller: ExportedController, real: Real = "double", file: str = "") -> str:
    """Return the text of the C file called ``file``."""
    return _CWriter(controller, real).text(file or f"{controller.name}.c")


class _CWriter:
    """Writer of one controller in one precision."""

    def __init__(self, controller: ExportedController, real: Real) -> None:
        self.controller, self.real = controller, real
        self.name, self.suffix = controller.name, "f" if real == "float" else ""

    def text(self, file: str) -> str:
        controller, name = self.controller, self.name
        program, constants = controller.program, controller.program.constants()
        sizes = {key: value.size for key, value in program.remembered.items()}
        statements = [line for statement in program.statements for line in self.statement(statement)]
        for key, value in program.remembered.items():
            statements += self.each(value.size, f"memory->{key}[{{i}}] = {self.element(value)};")
        if not sizes:
            statements.append("(void)memory;")
        if not any(OBSERVATION in line for line in statements):
            statements.append(f"(void){OBSERVATION};")
        statements += [f"control[{i}] = {control.name};" for i, control in enumerate(controller.controls)]
        reset = [line for key, n in sizes.items() for line in self.each(n, f"memory->{key}[{{i}}] = {self.number(0)};")]
        wants_dot = any(
            isinstance(part, Dot) and part.of.size > 1 for s in program.statements for part in parts_of(s.expression)
        )
        vectors = [
            self.table("TEST_OBSERVATIONS", controller.test_observations),
            self.table("TEST_CONTROLS", controller.test_controls),
        ]
        return TEMPLATE.format(
            origin="\n * ".join(controller.origin),
            real=self.real,
            observations="\n".join(f" *     {row}" for row in controller.rows(controller.observations)),
            controls="\n".join(f" *     {row}" for row in controller.rows(controller.system.controls)),
            name=name,
            upper=name.upper(),
            file=file,
            dt=controller.system.dt,
            n=len(controller.observations),
            nu=controller.system.nu,
            memory="\n".join(f"    {name}_real {key}[{n}];" for key, n in sizes.items()) or "    char nothing;",
            tables="\n".join(self.table(key, values) for key, values in constants.items()),
            dot=DOT.format(name=name, zero=self.number(0)) if wants_dot else "",
            reset=_indented(reset or ["memory->nothing = 0;"]),
            statements=_indented(statements),
            vectors="\n".join(vectors),
            samples=len(controller.test_observations),
            fabs=f"fabs{self.suffix}",
            tolerance=self.number(1e-9 if self.real == "double" else 1e-3),
        )

    def number(self, value: float) -> str:
        text = repr(float(np.float32(value)) if self.real == "float" else float(value))
        if self.real == "float":
            text = str(np.float32(value))
            text = text if any(mark in text for mark in ".en") else f"{text}.0"
        return f"{text}{self.suffix}"

    def table(self, key: str, values: Array) -> str:
        whole = values.dtype.kind == "i"
        kind = "size_t" if whole else f"{self.name}_real"

        def row(numbers: Array) -> str:
            return "{" + ", ".join(str(v) if whole else self.number(v) for v in numbers) + "}"

        if values.ndim == 1:
            return f"static const {kind} {key}[{len(values)}] = {row(values)};\n"
        rows = "".join(f"    {row(numbers)},\n" for numbers in values)
        return f"static const {kind} {key}[{len(values)}][{values.shape[1]}] = {{\n{rows}}};\n"

    def each(self, n: int, line: str) -> list[str]:
        """Return ``line`` for one element, or a loop over n elements."""
        if n == 1:
            return [line.replace("{i}", "0")]
        return [f"for (size_t i = 0; i < {n}; ++i)", f"    {line.replace('{i}', 'i')}"]

    def statement(self, statement: Statement) -> list[str]:
        n, remark = statement.expression.size, [f"/* {statement.remark} */"] if statement.remark else []
        if isinstance(statement.expression, Joined):
            parts = ", ".join(self.element(part) for part in statement.expression.parts)
            return [*remark, f"const {self.name}_real {statement.name}[{n}] = {{{parts}}};"]
        value = self.element(statement.expression)
        if n == 1:
            return [*remark, f"const {self.name}_real {statement.name} = {value};"]
        declared = f"{self.name}_real {statement.name}[{n}];"
        return [*remark, declared, *self.each(n, f"{statement.name}[{{i}}] = {value};")]

    def element(self, e: Expression) -> str:
        """Return element i of an expression, or its only element."""
        match e:
            case Number():
                return self.number(e.value) if e.value >= 0.0 else f"({self.number(e.value)})"
            case Variable():
                return self.at(e, "i")
            case ConstantVector():
                return f"{e.name}[{'i' if e.size > 1 else 0}]"
            case Dot():
                row = f"{e.name}[{'i' if e.size > 1 else 0}]"
                if e.of.size == 1:
                    return f"{row}[0] * {self.element(e.of)}"
                return f"dot({row}, {self.at(e.of, None)}, {e.of.size})"
            case Take():
                return self.at(e.of, str(e.places[0]) if e.size == 1 else f"{e.name}[i]")
            case Unary():
                return f"{FUNCTIONS[e.function]}{self.suffix}({self.element(e.of)})"
            case Choice():
                left, right, yes, no = (self.element(part) for part in (e.left, e.right, e.yes, e.no))
                return f"({left} {e.operator} {right} ? {yes} : {no})"
            case Binary() if e.operator in FUNCTIONS:
                return f"{FUNCTIONS[e.operator]}{self.suffix}({self.element(e.left)}, {self.element(e.right)})"
            case Binary():
                return f"{self.inside(e.left)} {e.operator} {self.inside(e.right)}"
            case _:
                raise TypeError(f"export: expected an expression, got {type(e).__name__}")

    def inside(self, e: Expression) -> str:
        """Return element i of an operand of a sum or product, with brackets if needed."""
        plain = isinstance(e, Binary) and e.operator not in FUNCTIONS
        return f"({self.element(e)})" if plain else self.element(e)

    def at(self, e: Variable, place: str | None) -> str:
        """Return one element of a variable, or the variable itself without a ``place``."""
        array = e.remembered or e.name == OBSERVATION
        name = f"memory->{e.name}" if e.remembered else e.name
        if place is None:
            return name
        if e.size == 1:
            return f"{name}[0]" if array else name
        return f"{name}[{place}]"


def _indented(lines: list[str]) -> str:
    return "\n".join(f"    {line}" for line in lines)
