"""Mistakes of users, each of which is told before any work: what is typed, and what is said."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sysid_evo.data import Dataset
from sysid_evo.testing import example_dataset
from sysid_evo.testing.examples import pendulum


@dataclass(frozen=True)
class Mistake:
    """``what`` is wrong in the command ``arguments``; ``said`` stands in the error."""

    what: str
    arguments: tuple[str, ...]
    said: str


CAR = ("--data", "car", "--models", "linear", "--generations", "1")
TWO = ("--data", "car", "--models", "linear,nearest_neighbour", "--generations", "1")

MISTAKES = (
    Mistake("unknown model", ("compare", "--models", "linaer"), "no model is called 'linaer'. Did you mean 'linear'?"),
    Mistake(
        "unknown parameter of a model",
        ("compare", "--models", "linear(rigde=0.1)"),
        "model 'linear' has no parameter 'rigde'. Did you mean 'ridge'? It takes",
    ),
    Mistake(
        "wrong value for a model",
        ("compare", "--models", "nearest_neighbour(state_lags=-1)"),
        "state_lags: expected a whole number >= 0, got -1",
    ),
    Mistake("wrong type for a model", ("compare", "--models", "linear(ridge=none)"), "ridge: expected a number >= 0"),
    Mistake("unknown task", ("compare", "--task", "juggling"), "no task is called 'juggling'"),
    Mistake(
        "unknown parameter of the task",
        ("compare", "--task", "point_to_point(horizn=9)"),
        "task 'point_to_point' has no parameter 'horizn'. Did you mean 'horizon'?",
    ),
    Mistake("wrong value for the task", ("compare", "--task", "point_to_point(horizon=0)"), "horizon"),
    Mistake(
        "unknown parameter of the controller",
        ("compare", "--controller", "recurrent(hiden=8)"),
        "controller 'recurrent' has no parameter 'hiden'. Did you mean 'hidden'?",
    ),
    Mistake(
        "unknown parameter of the strategy",
        ("compare", "--strategy", "mu_plus_lambda(sigmas=1)"),
        "strategy 'mu_plus_lambda' has no parameter 'sigmas'. Did you mean 'sigma'?",
    ),
    Mistake("unknown aggregate", ("compare", "--aggregate", "maximum"), "no aggregate is called 'maximum'"),
    Mistake(
        "unknown parameter of the aggregate",
        ("compare", "--aggregate", "min(share=0.2)"),
        "aggregate 'min' has no parameter 'share'",
    ),
    Mistake("unknown robot", ("compare", "--robot", "emulated_cat"), "Did you mean 'emulated_car'?"),
    Mistake(
        "unknown parameter of the robot",
        ("compare", "--robot", "emulated_car(sead=3)"),
        "robot 'emulated_car' has no parameter 'sead'. Did you mean 'seed'?",
    ),
    Mistake("a bracket that is not closed", ("compare", "--models", "linear(ridge=0.1"), "--models: expected"),
    Mistake("no model at all", ("compare", "--models", ""), "--models: expected NAME"),
    Mistake("a name twice", ("compare", "--models", "linear,linear"), "'linear' is given 2 times"),
    Mistake(
        "an ensemble with a stranger",
        ("compare", *TWO, "--ensembles", "linear+parametrised"),
        "names parametrised, but the models are linear, nearest_neighbour",
    ),
    Mistake(
        "an ensemble of one", ("compare", *TWO, "--ensembles", "linear"), "expected two or more models joined by +"
    ),
    Mistake("unknown preset", ("compare", "--preset", "slow"), "preset: expected 'quick', 'standard' or 'paper'"),
    Mistake("unknown --only", ("compare", "--only", "predictions"), "only: expected 'fit' or 'prediction'"),
    Mistake("no such file", ("compare", "--data", "nowhere"), "nowhere"),
    Mistake("a log that cannot be read", ("compare", "--data", "broken.csv"), "broken.csv"),
    Mistake(
        "a log of ten rows",
        ("compare", "--data", "short"),
        "the training data: expected an episode",
    ),
    Mistake("no such plugin", ("compare", "--plugin", "missing.py"), "missing.py: expected a Python file, found none"),
    Mistake("--out is a file", ("compare", "--out", "file"), "--out: expected a folder, but file is a file"),
    Mistake("--out holds other files", ("compare", "--out", "full"), "full holds 'something' and is no run"),
    Mistake("--out cannot be written", ("compare", "--out", "/proc/run"), "--out: expected a folder that can be"),
    Mistake("unknown test episode", ("compare", *CAR, "--test", "episode-9"), "episode-9"),
    Mistake("a test episode without data", ("compare", "--test", "episode-2"), "give --data for that"),
    Mistake(
        "a robot that is not the data's",
        ("compare", "--data", "pendulum", "--robot", "emulated_car"),
        "robot 'emulated_car' is not the one in the recordings",
    ),
    Mistake(
        "a task that the system cannot do",
        ("compare", "--data", "pendulum", "--models", "linear"),
        "or compare --only prediction",
    ),
    Mistake(
        "a family that cannot describe the system",
        ("compare", "--data", "pendulum", "--models", "parametrised"),
        "describes a planar body, but the system has no motion",
    ),
    Mistake("a yardstick without a robot", ("compare", *CAR, "--yardstick"), "name the emulated robot"),
    Mistake(
        "a yardstick without controllers",
        ("compare", "--only", "prediction", "--yardstick"),
        "--yardstick has no effect with --only prediction: no controller is evolved or run",
    ),
    Mistake("no such experiment", ("compare", "--config", "none.toml"), "none.toml: expected an experiment, found no"),
    Mistake("an experiment with a wrong key", ("compare", "--config", "wrong.toml"), "did you mean generations?"),
    Mistake("no run to evolve in", ("evolve", "--against", "linear"), "no run folder given"),
    Mistake("a member twice", ("evolve", "--against", "emulated_car,emulated_car"), "emulated_car is named twice"),
    Mistake(
        "unknown parameter in evolve",
        ("evolve", "--against", "emulated_car", "--controller", "recurrent(hiden=8)"),
        "Did you mean 'hidden'?",
    ),
    Mistake("unknown model in fit", ("fit", "car", "--models", "linaer"), "Did you mean 'linear'?"),
    Mistake("unknown test episode in fit", ("fit", "car", "--models", "linear", "--test", "e"), "episode-2"),
    Mistake("a report of nothing", ("report", "full"), "experiment.toml: expected an experiment, found no such file"),
    Mistake(
        "a file name for an episode",
        ("compare", *CAR, "--test", "episode-2.csv"),
        "test: no episode is called 'episode-2.csv'. Did you mean 'episode-2'?",
    ),
    Mistake(
        "models with a space between",
        ("compare", "--models", "linear", "narx"),
        "--models takes one value, not 'narx' too; did you mean values with commas, without spaces?",
    ),
    Mistake(
        "models with a space between, in fit",
        ("fit", "car", "--models", "linear", "narx"),
        "narx is a model and no recording; did you mean --models linear,narx?",
    ),
    Mistake(
        "several values of one option", ("compare", *CAR, "--test", "a", "b"), "--test must be repeated before each"
    ),
    Mistake("a run for recordings", ("compare", "--data", "run"), "run: expected recordings, but this is a run folder"),
    Mistake("a log that is called otherwise", ("fit", "brokn.csv"), "Did you mean 'broken.csv'?"),
    Mistake(
        "minutes of given recordings",
        ("compare", *CAR, "--minutes", "3"),
        "--minutes has no effect with --data: no robot is recorded; leave one of them out",
    ),
    Mistake(
        "a precision for Python",
        ("export", "controller", "--to", "python", "--real", "float"),
        "--real has no effect with --to python",
    ),
    Mistake("watching by hand", ("drive", "--watch"), "--watch has no effect without --controller"),
    Mistake("jobs of a cluster", ("fit", "car", "--jobs", "2", "--scheduler", "s.json"), "--jobs has no effect"),
    Mistake(
        "an import over a data set",
        ("import", "broken.csv", "--out", "car"),
        "--out: expected a new or an empty folder, but car holds a data set; --overwrite replaces it",
    ),
    Mistake("an import into a run", ("import", "broken.csv", "--out", "run", "--overwrite"), "but run holds 'cells'"),
    Mistake("a recording over a data set", ("record", "--out", "car"), "but car holds"),
    Mistake("an adapted model over another", ("adapt", "m", "--data", "car", "--out", "model"), "model.json exists"),
    Mistake("unknown kind of names", ("names", "contrlers"), "Did you mean 'controllers'?"),
    Mistake("the speed of a family", ("models", "show", "linear", "--speed"), "expected the file of a fitted model"),
    Mistake("a run that is none", ("runs", "show", "full"), "expected a run folder, found none at full"),
)


def prepare(folder: Path) -> None:
    """Write the files that the mistakes name."""
    example_dataset().save(folder / "car")
    rng = np.random.default_rng(0)
    swinging = Dataset.from_arrays(pendulum(), [rng.standard_normal((200, 2))], [rng.uniform(-1.0, 1.0, (199, 1))])
    swinging.save(folder / "pendulum")
    example_dataset(episodes=1, steps=10).save(folder / "short")
    (folder / "broken.csv").write_text("time,x\n0,1\nnonsense\n")
    (folder / "file").write_text("")
    (folder / "full").mkdir()
    (folder / "full" / "something").write_text("")
    (folder / "run" / "cells").mkdir(parents=True)
    (folder / "model.json").write_text("{}")
    (folder / "wrong.toml").write_text("genrations = 3\n")
