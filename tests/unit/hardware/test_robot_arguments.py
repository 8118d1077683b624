"""What a robot or a tracker is made with: named keywords, each checked, and nothing is opened."""

import inspect
import subprocess
import sys

import pytest

from hardware.robot import Robot
from hardware.trackers.tracker import Tracker
from sysid_evo.errors import InvalidArgument, InvalidData, LinkLost, MissingExtra
from sysid_evo.registry import robots, trackers

KINDS = [(robots, name) for name in robots.names()] + [(trackers, name) for name in trackers.names()]

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
"""


@pytest.mark.parametrize("registry, name", KINDS)
def test_every_argument_of_a_robot_or_tracker_is_named_typed_and_told_of(registry, name):
    factory = registry.get(name)
    text = inspect.getdoc(factory) or ""
    for base in inspect.getmro(factory) if inspect.isclass(factory) else ():
        text += inspect.getdoc(base) or ""
    for parameter in inspect.signature(factory).parameters.values():
        assert parameter.kind not in (parameter.VAR_KEYWORD, parameter.VAR_POSITIONAL), parameter
        assert parameter.annotation is not parameter.empty, parameter
        assert f"``{parameter.name}``" in text, f"{name}: the docstring does not tell what {parameter.name} is"


def test_making_a_robot_or_tracker_opens_nothing_starts_nothing_and_reads_nothing(tmp_path):
    done = subprocess.run([sys.executable, "-c", SILENT], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    "registry, name, arguments, sentence",
    [
        (robots, "emulated_car", {"seed": -1}, "robot emulated_car: seed: expected a whole number from 0"),
        (robots, "emulated_car", {"seed": "7"}, "robot emulated_car: seed: expected a whole number from 0"),
        (robots, "emulated_car", {"seed": 1.5}, "robot emulated_car: seed: expected a whole number from 0"),
        (robots, "serial", {"gate": {"sped": 1}}, "gate: no key is called 'sped'. Did you mean 'speed'?"),
        (robots, "serial", {"port": 5005}, "serial robot: port: expected a text in quotes, got 5005"),
        (robots, "serial", {"port": ""}, "serial robot: port: expected a text in quotes, got ''"),
        (robots, "serial", {"name": None}, "serial robot: name: expected a text in quotes, got None"),
        (robots, "serial", {"patience": 0}, "serial robot: patience: expected a number above 0, got 0"),
        (robots, "serial", {"patience": "long"}, "serial robot: patience: expected a number above 0, got 'long'"),
        (robots, "serial", {"tracker": "udp"}, "serial robot: expected tracker = {driver"),
        (robots, "serial", {"seed": 3}, "robot 'serial' has no parameter 'seed'. It takes port"),
        (robots, "serial", {"prot": "/dev/rcb"}, "robot 'serial' has no parameter 'prot'. Did you mean 'port'?"),
        (
            robots,
            "serial",
            {"tracker": {"driver": "udp", "body": "car", "prot": 5005}},
            "tracker 'udp' has no parameter 'prot'. Did you mean 'port'?",
        ),
        (robots, "serial", {"tracker": {"driver": "udp", "body": "car"}}, "tracker 'udp' needs port"),
        (robots, "serial", {"tracker": {"body": "car"}}, "serial robot: expected tracker = {driver"),
        (trackers, "udp", {"body": 5, "port": 1}, "tracker udp: body: expected a text in quotes, got 5"),
        (
            trackers,
            "udp",
            {"body": "car", "port": "5005"},
            "tracker udp: port: expected a whole number from 0 to 65535",
        ),
        (trackers, "udp", {"body": "car", "port": 1, "clock": "hots"}, "tracker udp: clock: expected one of 'source'"),
        (trackers, "udp", {"body": "car", "port": 1, "sender": 5}, "tracker udp: sender: expected a text in quotes"),
        (trackers, "natnet", {"body": "car", "data_port": 0}, "tracker natnet: data_port: expected a whole number"),
        (trackers, "natnet", {"body": "car", "multicast": "no"}, "tracker natnet: multicast: expected true or false"),
        (trackers, "natnet", {"body": "car", "latency": -1}, "tracker natnet: latency: expected a number of 0 or more"),
        (trackers, "vicon", {"body": "car", "scale": "mm"}, "tracker: scale: expected a number above 0, got 'mm'"),
        (trackers, "vrpn", {"body": "car", "up": "x"}, "tracker: up: expected one of 'y', 'z', got 'x'"),
        (
            trackers,
            "replay",
            {"body": "car", "path": "x", "speed": -1},
            "tracker replay: speed: expected a number of 0",
        ),
    ],
)
def test_a_value_that_cannot_be_is_refused_in_a_sentence_when_the_robot_is_made(registry, name, arguments, sentence):
    with pytest.raises(InvalidArgument) as raised:
        registry.make(name, **arguments)
    assert str(raised.value).startswith(sentence)


def test_a_port_that_is_not_there_is_found_without_opening_anything():
    with pytest.raises(LinkLost, match="port /dev/nowhere: no such device"):
        robots.make("serial", port="/dev/nowhere").check()
    robots.make("serial", port="/dev/null").check()


def test_a_robot_asks_its_tracker_what_is_missing():
    robot = robots.make("serial", port="/dev/null", tracker={"driver": "replay", "body": "car", "path": "nowhere.rcj"})
    with pytest.raises(InvalidData, match=r"nowhere\.rcj: expected a log, found nothing there"):
        robot.check()


def test_without_its_packages_a_robot_can_be_made_and_says_what_to_install_when_it_is_checked():
    program = """
import sys
sys.modules.update(dict.fromkeys(("serial", "cobs")))
from sysid_evo.registry import robots
robot = robots.make("serial", port="/dev/null")
for attempt in (robot.check, robot.connect):
    try:
        attempt()
    except ImportError as error:
        print(error)
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    advice = 'which is not installed. Install it with: pip install "sysid-evo[hardware]"'
    assert done.stdout.splitlines() == 2 * [f"robot 'serial' needs the package 'cobs', {advice}"]


def test_a_tracker_whose_package_is_missing_says_how_to_install_it(monkeypatch):
    monkeypatch.setattr(trackers.get("natnet"), "requires", ("no_such_package",))
    with pytest.raises(MissingExtra, match="tracker 'natnet' needs the package 'no_such_package'"):
        trackers.make("natnet", body="car").check()


@pytest.mark.parametrize("registry, name", KINDS)
def test_what_is_registered_is_of_its_kind(registry, name):
    factory = registry.get(name)
    kind = Robot if registry is robots else Tracker
    made = factory if inspect.isclass(factory) else type(factory())
    assert issubclass(made, kind)
