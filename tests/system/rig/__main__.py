"""The emulated car on a pseudo-terminal: ``python -m tests.system.rig``.

Prints one JSON line (port, tracker, pid) when it is ready, takes further faults as JSON lines on
its input, and ends when its input closes.
"""

from __future__ import annotations

import argparse
import contextlib
import gc
import json
import os
import signal
import sys
import tempfile
import time
from pathlib import Path

from hardware.emulation.cars import emulated_car
from tests.system.rig.board import Board
from tests.system.rig.faults import KINDS, Fault, FaultSchedule
from tests.system.rig.journal import RigLogWriter
from tests.system.rig.moving_car import MovingCar
from tests.system.rig.pose_stream import PoseStream
from tests.system.rig.pseudo_port import PseudoPort
from tests.system.rig.terminal import Terminal

PRIORITY = -10  # board and tracker stand for machines of their own, which the host's load does not slow


def main() -> None:
    """Run the car until the host ends."""
    options = _parser().parse_args()
    for ending in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(ending, lambda number, _: sys.exit(128 + number))
    with contextlib.suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, 0, PRIORITY)
    with tempfile.TemporaryDirectory(prefix="terminal-car-") as folder, contextlib.ExitStack() as open_things:
        port = PseudoPort(Path(folder) / "port")
        journal = RigLogWriter(options.journal)
        open_things.callback(journal.close)
        start = time.monotonic()
        faults = FaultSchedule([Fault(**json.loads(entry)) for entry in options.fault], start)
        poses = PoseStream(options.tracker, "car", faults)
        open_things.callback(poses.close)
        board = Board(port, faults, journal)
        car = MovingCar(emulated_car(seed=options.car), seed=options.seed, start=start)
        port.plug()
        open_things.callback(port.unplug)
        host, number = options.tracker or ("", 0)
        ready = {"port": str(port.link), "tracker": f"{host}:{number}" if host else None, "pid": os.getpid()}
        sys.stdout.write(json.dumps(ready) + "\n")
        sys.stdout.flush()
        gc.freeze()  # a collection that looks at all that was imported would hold up the car
        Terminal(port, board, car, poses, faults, journal).run(sys.stdin.fileno())


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m tests.system.rig", description=__doc__)
    parser.add_argument("--seed", type=int, default=None, help="of all noise; drawn without it")
    parser.add_argument("--car", type=int, default=None, help="seed of another car of the kind")
    parser.add_argument("--tracker", type=_address, default=None, metavar="HOST:PORT", help="where frames are sent")
    parser.add_argument("--journal", type=Path, default=None, help="file for what the buttons and the wire did")
    parser.add_argument(
        "--fault",
        action="append",
        default=[],
        metavar="JSON",
        help='such as {"kind": "unplug", "at": 3, "duration": 1}; kinds: ' + ", ".join(KINDS),
    )
    return parser


def _address(text: str) -> tuple[str, int]:
    host, _, port = text.rpartition(":")
    return host, int(port)


if __name__ == "__main__":
    main()
