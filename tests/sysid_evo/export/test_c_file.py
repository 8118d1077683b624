"""Controllers as C files, compiled by the system's compiler."""

from __future__ import annotations

import ctypes
import subprocess
from typing import Any

import numpy as np
import pytest

from sysid_evo.errors import InvalidArgument
from sysid_evo.export import c_text, law_of
from sysid_evo.testing.examples import continuous_car
from tests.fixtures.exports import SPECS, champion_of, decided, stepped, wandering, write
from tests.system.rig.build import WARNINGS, compiler


@pytest.fixture(scope="module")
def cc():
    try:
        return compiler()
    except InvalidArgument as error:
        pytest.skip(f"the C file is not compiled: {error}")


def compiled(cc, law, real, folder):
    """Return the step of ``law`` in C; a warning is an error."""
    source, library = write(c_text(law, real), folder / "law.c"), folder / "law.so"
    subprocess.run([cc, *WARNINGS, "-Werror", "-O2", "-shared", "-fPIC", source, "-lm", "-o", library], check=True)
    number: Any = ctypes.c_double if real == "double" else ctypes.c_float
    functions = ctypes.CDLL(str(library))
    memory = ctypes.create_string_buffer(4096)
    control = (number * law.system.nu)()
    getattr(functions, f"{law.name}_reset")(memory)
    step = getattr(functions, f"{law.name}_step")

    def decide(row):
        step(memory, (number * len(row))(*row), control)
        return np.array(control)

    return decide


@pytest.mark.parametrize("spec", SPECS)
def test_the_c_file_gives_the_commands_of_the_product_over_ten_thousand_samples(spec, cc, tmp_path):
    champion, seen = champion_of(spec), wandering(10_000)
    step = compiled(cc, law_of(champion), "double", tmp_path)
    np.testing.assert_array_equal(stepped(step, seen), decided(champion, seen))


@pytest.mark.parametrize("spec", SPECS)
def test_in_single_precision_the_outputs_are_the_same_but_for_rounding(spec, cc, tmp_path):
    champion, seen = champion_of(spec, continuous_car()), wandering(500)
    step = compiled(cc, law_of(champion), "float", tmp_path)
    np.testing.assert_allclose(stepped(step, seen), decided(champion, seen), atol=2e-3)


@pytest.mark.parametrize("real", ["double", "float"])
def test_the_file_checks_itself(real, cc, tmp_path):
    law = law_of(champion_of("recurrent"))
    text = c_text(law, real, "law.c")
    assert f"cc -std=c99 -DTEST_{law.name.upper()} law.c -lm -o check && ./check" in text
    for source, code in ((text, 0), (text.replace("? ", "? -", 1), 1)):
        file = write(source, tmp_path / "law.c")
        command = [cc, "-std=c99", f"-DTEST_{law.name.upper()}", file, "-lm", "-o", tmp_path / "check"]
        subprocess.run(command, check=True)
        assert subprocess.run([tmp_path / "check"], capture_output=True, check=False).returncode == code


def test_the_c_file_allocates_nothing():
    for spec in SPECS:
        text = c_text(law_of(champion_of(spec)))
        assert "alloc" not in text.replace("no allocation", "")
        assert text.count("#include") == 3  # math.h, stddef.h, and stdio.h of its test
