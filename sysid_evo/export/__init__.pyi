from .c_file import Real, c_text
from .law import Law, law_of
from .onnx_file import onnx_bytes
from .program import Program, Statement
from .python_file import python_text

__all__ = ["Law", "Program", "Real", "Statement", "c_text", "law_of", "onnx_bytes", "python_text"]
