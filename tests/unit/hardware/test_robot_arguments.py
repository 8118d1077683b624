"""What a robot or a tracker is made with: named keywords, each checked, and nothing is opened."""

import inspect

import pytest

from hardware.robot import Robot
from hardware.trackers.tracker import Tracker
from sysid_evo.errors import InvalidArgument, LinkLost, MissingExtra
from sysid_evo.registry import robots, trackers

KINDS = [(robots, name) for name in robots.names()] + [(trackers, name) for name in trackers.names()]


@pytest.mark.parametrize("registry, name", KINDS)
def test_every_argument_of_a_robot_or_tracker_is_named_typed_and_documented(registry, name):
    factory = registry.get(name)
    made = factory if inspect.isclass(factory) else type(factory())
    assert issubclass(made, Robot if registry is robots else Tracker)
    bases = inspect.getmro(factory) if inspect.isclass(factory) else (factory,)
    text = "".join(inspect.getdoc(base) or "" for base in bases)
    for parameter in inspect.signature(factory).parameters.values():
        assert parameter.kind not in (parameter.VAR_KEYWORD, parameter.VAR_POSITIONAL), parameter
        assert parameter.annotation is not parameter.empty, parameter
        assert f"``{parameter.name}``" in text, f"{name}: the docstring does not tell what {parameter.name} is"


UDP = {"driver": "udp", "body": "car"}


@pytest.mark.parametrize(
    "name, arguments, sentence",
    [
        ("emulated_car", {"seed": -1}, "robot emulated_car: seed: expected a whole number from 0"),
        ("emulated_car", {"seed": "7"}, "robot emulated_car: seed: expected a whole number from 0"),
        ("emulated_car", {"seed": 1.5}, "robot emulated_car: seed: expected a whole number from 0"),
        ("serial", {"gate": {"sped": 1}}, "gate: no key is called 'sped'. Did you mean 'speed'?"),
        ("serial", {"port": 5005}, "serial robot: port: expected a text in quotes, got 5005"),
        ("serial", {"port": ""}, "serial robot: port: expected a text in quotes, got ''"),
        ("serial", {"name": None}, "serial robot: name: expected a text in quotes, got None"),
        ("serial", {"patience": 0}, "serial robot: patience: expected a number above 0, got 0"),
        ("serial", {"patience": "long"}, "serial robot: patience: expected a number above 0, got 'long'"),
        ("serial", {"tracker": "udp"}, "serial robot: expected tracker = {driver"),
        ("serial", {"seed": 3}, "robot 'serial' has no parameter 'seed'. It takes port"),
        ("serial", {"prot": "/dev/rcb"}, "robot 'serial' has no parameter 'prot'. Did you mean 'port'?"),
        ("serial", {"tracker": {**UDP, "prot": 5005}}, "tracker 'udp' has no parameter 'prot'. Did you mean 'port'?"),
        ("serial", {"tracker": UDP}, "tracker 'udp' needs port"),
        ("serial", {"tracker": {"body": "car"}}, "serial robot: expected tracker = {driver"),
        ("udp", {"body": 5, "port": 1}, "tracker udp: body: expected a text in quotes, got 5"),
        ("udp", {"port": "5005"}, "tracker udp: port: expected a whole number from 0 to 65535"),
        ("udp", {"port": 70_000}, "tracker udp: port: expected a whole number from 0 to 65535"),
        ("udp", {"port": 1, "clock": "hots"}, "tracker udp: clock: expected one of 'source'"),
        ("udp", {"port": 1, "sender": 5}, "tracker udp: sender: expected a text in quotes"),
        ("natnet", {"data_port": 0}, "tracker natnet: data_port: expected a whole number"),
        ("natnet", {"multicast": "no"}, "tracker natnet: multicast: expected true or false"),
        ("natnet", {"latency": -1}, "tracker natnet: latency: expected a number of 0 or more"),
        ("natnet", {"scale": 0.0}, "tracker: scale: expected a number above 0, got 0.0"),
        ("vicon", {"scale": "mm"}, "tracker: scale: expected a number above 0, got 'mm'"),
        ("vrpn", {"up": "x"}, "tracker: up: expected one of 'y', 'z', got 'x'"),
    ],
)
def test_a_value_that_cannot_be_is_refused_in_a_sentence_when_the_robot_is_made(name, arguments, sentence):
    registry, given = (robots, {}) if name in robots.names() else (trackers, {"body": "car"})
    with pytest.raises(InvalidArgument) as raised:
        registry.make(name, **(given | arguments))
    assert str(raised.value).startswith(sentence)


def test_a_port_that_is_not_there_is_found_without_opening_anything():
    with pytest.raises(LinkLost, match="port /dev/nowhere: no such device"):
        robots.make("serial", port="/dev/nowhere").check()
    robots.make("serial", port="/dev/null").check()


def test_a_robot_asks_its_tracker_what_is_missing(monkeypatch):
    robot = robots.make("serial", port="/dev/null", tracker={"driver": "natnet", "body": "car"})
    monkeypatch.setattr(trackers.get("natnet"), "requires", ("no_such_package",))
    with pytest.raises(MissingExtra, match="tracker 'natnet' needs the package 'no_such_package'"):
        robot.check()
