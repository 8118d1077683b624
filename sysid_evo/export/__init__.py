"""Controllers written out as files that need nothing of this package."""

from sysid_evo.export.c_file import c_text
from sysid_evo.export.exported_controller import Law, Real, law_of
from sysid_evo.export.onnx_file import onnx_bytes
from sysid_evo.export.python_file import python_text

__all__ = ["Law", "Real", "c_text", "law_of", "onnx_bytes", "python_text"]
