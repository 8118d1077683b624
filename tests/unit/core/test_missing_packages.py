"""What to install for a module that is missing."""

from importlib.metadata import distribution

import pytest

from sysid_evo.extras import extra_of, missing_extra


@pytest.mark.parametrize(
    ("module", "extra"),
    [
        ("serial", "hardware"),
        ("serial.tools.list_ports", "hardware"),
        ("cobs", "hardware"),
        ("natnet", "natnet"),
        ("vehiclemodels.init_mb", "drift-car"),
        ("rotorpy", "quadrotor"),
        ("motioncapture", "motioncapture"),
        ("starlette.applications", "drive"),
        ("uvicorn", "drive"),
        ("torch", "neural"),
        ("pysindy", "sindy"),
        ("numpy", None),
        ("sklearn", None),
        ("no_such_module", None),
        ("json", None),
    ],
)
def test_the_extra_of_a_module_is_found_also_where_the_package_has_another_name(module, extra):
    assert extra_of(module) == extra


def test_the_distribution_may_be_given_by_name_or_as_itself():
    assert extra_of("pysindy", "no-such-distribution") is None
    assert extra_of("serial", distribution("sysid-evo")) == "hardware"
    assert str(missing_extra("it", "serial", distribution("sysid-evo"))).endswith('pip install "sysid-evo[hardware]"')


def test_the_error_names_the_package_and_the_command_that_installs_it():
    assert str(missing_extra("robot 'serial'", "serial")) == (
        "robot 'serial' needs the package 'pyserial', which is not installed. "
        'Install it with: pip install "sysid-evo[hardware]"'
    )
    assert str(missing_extra("it", "cv2")).endswith('pip install "opencv-python"')


def test_a_distribution_of_a_package_that_reads_metadata_in_its_own_way_is_one_too():
    class Foreign:  # such as those of importlib_metadata, which takes the place of Python's own once it is imported
        name = "foreign"
        requires = ("pyserial; extra == 'link'",)

    assert extra_of("serial", Foreign()) == "link"
    assert "foreign[link]" in str(missing_extra("a robot", "serial", Foreign()))
