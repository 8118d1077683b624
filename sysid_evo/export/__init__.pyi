from .c_file import c_text
from .exported_controller import Law, Real, law_of
from .onnx_file import onnx_bytes
from .python_file import python_text

__all__ = [
    "Law",
    "Real",
    "c_text",
    "law_of",
    "onnx_bytes",
    "python_text",
]
