"""Export of controllers as files that do not depend on this package."""

from sysid_evo.export.c_file import c_text
from sysid_evo.export.exported_controller import ExportedController, Real, exported_controller
from sysid_evo.export.onnx_file import onnx_bytes
from sysid_evo.export.python_file import python_text

__all__ = ["ExportedController", "Real", "c_text", "exported_controller", "onnx_bytes", "python_text"]
