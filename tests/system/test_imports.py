"""What a package loads, in a process of its own."""

import json
import subprocess
import sys

CORE = ("models", "tasks", "controllers", "engine", "evolution", "testing")
PROGRAM = """
import importlib, json, sys
found = {}
for package in sys.argv[1:]:
    importlib.import_module(package)
    found[package] = sorted({"numba", "llvmlite", "torch"} & set(sys.modules))
print(json.dumps(found))
"""


def test_what_can_be_compiled_loads_neither_the_compiler_nor_torch():
    packages = [*(f"sysid_evo.{name}" for name in CORE), "model_zoo"]
    loaded = json.loads(subprocess.check_output([sys.executable, "-c", PROGRAM, *packages]))
    assert loaded == {package: [] for package in packages}
