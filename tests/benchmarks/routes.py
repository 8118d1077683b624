"""Number of modules of the four packages that three calls use, which a reader has to open to follow them.

``python -m tests.benchmarks.routes [--list]`` counts the modules with a called function (bodies of modules and classes
do not count) while a CSV file is read, one model is compared by prediction, and a rollout is compiled.
"""

from __future__ import annotations

import argparse
import inspect
import os
import sys
import tempfile
import threading
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("sysid_evo", "model_zoo", "evaluation", "hardware")


def entered(call: Callable[[], object]) -> list[str]:
    """Return the files of the four packages, relative to the project, whose functions ``call`` used."""
    files: set[str] = set()

    def note(frame: FrameType, event: str, _: Any) -> None:
        code = frame.f_code
        if event == "call" and code.co_flags & inspect.CO_OPTIMIZED:  # bodies of modules and classes are not
            files.add(code.co_filename)

    sys.setprofile(note)
    threading.setprofile(note)
    try:
        call()
    finally:
        sys.setprofile(None)
        threading.setprofile(None)
    inside = (Path(file) for file in files if file.startswith(str(ROOT)) and file.endswith(".py"))
    return sorted(str(file.relative_to(ROOT)) for file in inside if file.relative_to(ROOT).parts[0] in PACKAGES)


def read_csv(folder: Path) -> Callable[[], object]:
    """Return a call that reads twenty seconds of the emulated car as its recorder writes them, from one CSV file."""
    import numpy as np

    from sysid_evo import Dataset

    time = np.arange(4000) / 200.0
    drive, steer = np.sign(np.sin(0.7 * time)), np.sign(np.sin(1.3 * time))
    heading = 0.2 * np.sin(0.5 * time)
    columns = [time, drive, steer, np.sin(0.3 * time), np.cos(0.3 * time), heading]
    file = folder / "log.csv"
    np.savetxt(file, np.stack(columns, axis=-1), delimiter=",", header="t,drive,steer,x,y,heading", comments="")
    return lambda: Dataset.read(file, columns="emulated_car")


def compare_one(folder: Path) -> Callable[[], object]:
    """Return a call that compares one model by its prediction of the emulated car."""
    import evaluation

    return lambda: evaluation.compare(stop_after="prediction", models=["linear"], out=folder / "run", jobs=1)


def first_rollout(folder: Path) -> Callable[[], object]:
    """Return a call that compiles and runs sixty-four candidates on the emulated car."""
    import numpy as np

    from sysid_evo.controllers import RecurrentNetwork
    from sysid_evo.engine import rollout
    from sysid_evo.randomness import trial_seeds
    from sysid_evo.registry import make_robot
    from sysid_evo.tasks import PointToPoint

    robot: Any = make_robot("emulated_car")
    dynamics = robot.dynamics
    candidates = np.zeros((64, 78))
    return lambda: rollout(
        dynamics, RecurrentNetwork(), candidates, PointToPoint(), trial_seeds(0, 1), engine="float32"
    )


ROUTES: dict[str, Callable[[Path], Callable[[], object]]] = {
    "Dataset.read of one CSV": read_csv,
    'compare(stop_after="prediction", models=["linear"])': compare_one,
    "a first compiled rollout": first_rollout,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--list", action="store_true", help="also print the modules")
    listed = parser.parse_args().list
    for title, route in ROUTES.items():
        with tempfile.TemporaryDirectory() as folder:
            os.environ["SYSID_EVO_CACHE"] = f"{folder}/cache"
            modules = entered(route(Path(folder)))
        sys.stdout.write(f"{len(modules):4d}  {title}\n")
        if listed:
            sys.stdout.write("".join(f"        {module}\n" for module in modules))


if __name__ == "__main__":
    main()
