"""Export of a controller as an ONNX model, with the library ``onnx``."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

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
    Take,
    Unary,
    Variable,
)
from sysid_evo.export.exported_controller import ExportedController, Real
from sysid_evo.extras import missing_extra
from sysid_evo.types import Array

if TYPE_CHECKING:
    import onnx


OPSET, IR_VERSION = 17, 8
"""Versions that runtimes have supported since 2022."""
OPERATORS = {
    "+": "Add", "-": "Sub", "*": "Mul", "/": "Div", "min": "Min", "max": "Max", ">": "Greater",
    ">=": "GreaterOrEqual", "tanh": "Tanh", "abs": "Abs", "round": "Round", "sqrt": "Sqrt", "sin": "Sin",
}  # fmt: skip


def onnx_bytes(controller: ExportedController, real: Real = "double") -> bytes:
    """Return the content of the file. Raises `MissingExtra` without the library onnx.

    The inputs are ``observation`` (n,) and ``memory_NAME`` for each memory vector, zeros at first. The outputs are
    ``control`` (nu,) and ``next_NAME``, the memory for the next sample.
    """
    try:
        import onnx  # noqa: F401  # raises here, with a clear error
    except ModuleNotFoundError as error:
        raise missing_extra("export --to onnx", error.name) from error
    return _Graph(real).model(controller).SerializeToString()


class _Graph:
    """Nodes and tables of one controller."""

    def __init__(self, real: Real) -> None:
        from onnx import TensorProto

        self.numbers = np.dtype(np.float32 if real == "float" else np.float64)
        self.kind = TensorProto.FLOAT if real == "float" else TensorProto.DOUBLE
        self.nodes: list[onnx.NodeProto] = []
        self.tables: dict[str, onnx.TensorProto] = {}

    def model(self, controller: ExportedController) -> onnx.ModelProto:
        from onnx import checker, helper

        program = controller.program
        for statement in program.statements:
            whole = np.zeros(statement.expression.size)
            self.node("Add", self.result(statement.expression), self.table("", whole), name=statement.name)
        self.node("Concat", *(control.name for control in controller.controls), name="control", axis=0)
        inputs, outputs = [(OBSERVATION, len(controller.observations))], [("control", controller.system.nu)]
        for name, value in program.remembered.items():
            self.node("Identity", value.name, name=f"next_{name}")
            inputs.append((f"memory_{name}", value.size))
            outputs.append((f"next_{name}", value.size))
        graph = helper.make_graph(
            self.nodes,
            controller.name,
            [helper.make_tensor_value_info(name, self.kind, [n]) for name, n in inputs],
            [helper.make_tensor_value_info(name, self.kind, [n]) for name, n in outputs],
            list(self.tables.values()),
            doc_string="\n".join(controller.origin),
        )
        opset = [helper.make_opsetid("", OPSET)]
        model = helper.make_model(graph, opset_imports=opset, producer_name="sysid-evo")
        model.ir_version = IR_VERSION
        described = {
            "dt": repr(controller.system.dt),
            "observations": json.dumps(controller.rows(controller.observations)),
            "controls": json.dumps(controller.rows(controller.system.controls)),
        }
        helper.set_model_props(model, described)
        checker.check_model(model, full_check=True)
        return model

    def node(self, kind: str, *inputs: str, name: str = "", **attributes: Any) -> str:
        from onnx import helper

        output = name or f"value_{len(self.nodes)}"
        self.nodes.append(helper.make_node(kind, list(inputs), [output], **attributes))
        return output

    def table(self, name: str, values: Array) -> str:
        from onnx import numpy_helper

        whole = values.dtype.kind == "i"
        key = name or f"table_{len(self.tables)}"
        self.tables[key] = numpy_helper.from_array(values.astype(np.int64 if whole else self.numbers), key)
        return key

    def result(self, e: Expression) -> str:
        """Return the name of the value of an expression."""
        match e:
            case Number():
                return self.table("", np.array([e.value]))
            case Variable():
                return f"memory_{e.name}" if e.remembered else e.name
            case ConstantVector():
                return self.table(e.name, e.values)
            case Dot():
                return self.node("MatMul", self.table(e.name, e.matrix), self.result(e.of))
            case Take():
                return self.node("Gather", self.result(e.of), self.table(e.name, np.array(e.places)))
            case Unary():
                return self.node(OPERATORS[e.function], self.result(e.of))
            case Binary():
                return self.node(OPERATORS[e.operator], self.result(e.left), self.result(e.right))
            case Joined():
                return self.node("Concat", *(self.result(part) for part in e.parts), axis=0)
            case Choice():
                chosen = self.node(OPERATORS[e.operator], self.result(e.left), self.result(e.right))
                return self.node("Where", chosen, self.result(e.yes), self.result(e.no))
            case _:
                raise TypeError(f"export: expected an expression, got {type(e).__name__}")
