from .c_file import c_text
from .exported_controller import ExportedController, Real, exported_controller
from .python_file import python_text

__all__ = ["ExportedController", "Real", "c_text", "exported_controller", "python_text"]
