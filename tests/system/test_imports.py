"""What a package loads, and what making a robot opens, in a process of its own."""

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


SILENT = """
import sys

import gymnasium

gymnasium.make("Pendulum-v1")  # the spaces of an environment are known once it is made; its code is read here
from sysid_evo.registry import robots, trackers

tracker = {"driver": "udp", "body": "car", "port": 5005}
made = {
    "awkward_car": {"seed": 3, "stuck": 0.5},
    "emulated_car": {"seed": 3}, "cart_pole": {"seed": 3}, "pendulum": {"seed": 3}, "thermal": {"seed": 3},
    "gymnasium": {"id": "Pendulum-v1"},
    "serial": {"port": "/dev/nowhere", "tracker": tracker, "gate": {"speed": 8.0}},
    "natnet": {"body": "car"}, "replay": {"body": "car", "path": "no such log"}, "udp": {"body": "car", "port": 5005},
    "vicon": {"body": "car"}, "vrpn": {"body": "car"},
}
factories = {name: registry.get(name) for registry in (robots, trackers) for name in registry.names()}
assert made.keys() == factories.keys(), factories
touched = []
watched = ("open", "os.listdir", "os.scandir", "socket.", "subprocess.", "os.fork", "os.posix_spawn", "pty.")
sys.addaudithook(lambda event, values: event.startswith(watched) and touched.append((event, *map(str, values))))
for name, factory in factories.items():
    factory(**made[name])
    assert not touched, (name, touched)
sys.modules.update(dict.fromkeys(("serial", "cobs")))
robot = robots.make("serial", port="/dev/null")
for attempt in (robot.check, robot.connect):
    try:
        attempt()
    except ImportError as error:
        print(error)
"""


def test_making_a_robot_or_tracker_opens_nothing_and_without_its_packages_it_says_what_to_install(tmp_path):
    done = subprocess.run([sys.executable, "-c", SILENT], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    advice = 'which is not installed. Install it with: pip install "sysid-evo[hardware]"'
    assert done.stdout.splitlines() == 2 * [f"robot 'serial' needs the package 'cobs', {advice}"]
