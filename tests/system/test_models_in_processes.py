"""Work in processes of its own: a fit or an evolution that is killed loses nothing, a stored model loads little."""

import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sysid_evo.artefacts import CheckpointFile, read_checkpoint
from sysid_evo.models import save_model
from sysid_evo.models.base import make_model
from tests.fixtures.checkpoints import Stop, StopAfter
from tests.fixtures.evolutions import SETTINGS, assert_same, evolved

ROOT = Path(__file__).parents[2]
FIT = """
import sys
import numpy as np
from sysid_evo.models.base import make_model
from sysid_evo.testing import example_dataset
from tests.fixtures.checkpoints import AlwaysDue

model = make_model("neural_ode", hidden=[6], one_step_updates=30, updates=100000, horizon=5)
model.checkpoint = AlwaysDue(sys.argv[1])
told = lambda done, total, note="": print(done, flush=True)
model.fit(example_dataset(), rng=np.random.default_rng(1), progress=told)
"""


EVOLUTION = """
import sys
from dataclasses import replace
from tests.fixtures.checkpoints import AlwaysDue
from tests.fixtures.evolutions import SETTINGS, evolved

told = lambda done, total, note="": print(done, flush=True)
evolved(replace(SETTINGS, generations=60), AlwaysDue(sys.argv[1]), threads=int(sys.argv[2]), progress=told)
"""


def killed(program, path, *arguments, after):
    """Run a program that prints each step it has done, kill it ``after`` that one, return the second and the last."""
    command = [sys.executable, "-c", program, str(path), *arguments]
    process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True)
    told = [int(process.stdout.readline()) for _ in range(2)]
    for line in process.stdout:
        told.append(int(line))
        if told[-1] >= after:
            break
    process.send_signal(signal.SIGKILL)
    process.communicate()
    assert process.returncode == -signal.SIGKILL
    return told[1], told[-1]


def stopped(path, car_data):
    """Go on from the checkpoint at ``path``, if there is one, to update 161; return what is stored then."""
    model = make_model("neural_ode", hidden=[6], one_step_updates=30, updates=100000, horizon=5)
    model.checkpoint = CheckpointFile(path)
    with pytest.raises(Stop):
        model.fit(car_data, rng=np.random.default_rng(1), progress=StopAfter(161))
    return read_checkpoint(path)[1]


def test_a_fit_killed_at_random_moments_loses_nothing_that_was_saved(tmp_path, car_data):
    path, reached = tmp_path / "c", 0
    for updates in (60, 120):
        first, last = killed(FIT, path, after=updates)
        assert first >= reached
        reached = last
    assert int(read_checkpoint(path)[1]["updates"]) >= reached
    one, other = stopped(path, car_data), stopped(tmp_path / "straight", car_data)
    assert one.keys() == other.keys()
    for name, value in one.items():
        np.testing.assert_array_equal(value, other[name])


def test_an_evolution_killed_at_random_moments_goes_on_to_the_same_champion(tmp_path):
    """Every generation is saved, so that kills fall into saving, too."""
    path, reached = tmp_path / "c", 0
    for threads, after in (("1", 10), ("2", 90)):
        first, last = killed(EVOLUTION, path, threads, after=after)
        assert first >= reached
        reached = last
    settings, watched = replace(SETTINGS, generations=60), StopAfter(0)
    assert_same(evolved(settings, CheckpointFile(path), threads=2, progress=watched), evolved(settings))
    assert reached <= watched.told[0] < 120


def test_stored_networks_step_without_what_takes_long_to_load(fitted, car_data, tmp_path):
    """Neither the ensemble of the zoo nor the default module of `torch_ode` needs what it was trained with."""
    pytest.importorskip("torchdiffeq")
    torch_ode = make_model("torch_ode", hidden=[6], updates=2, horizon=3).fit(car_data, rng=0)
    for model in (fitted["mlp_ensemble"], torch_ode):
        save_model(model, tmp_path / type(model).__name__)
    script = (
        "import sys, numpy as np\n"
        "from sysid_evo.models import load_model\n"
        "for path in sys.argv[1:]:\n"
        "    model = load_model(path)\n"
        "    model.step(np.zeros((1, model.n_carry)), np.zeros((1, 2)))\n"
        "assert not {'scipy', 'sklearn', 'pandas', 'numba', 'torch'} & set(sys.modules)\n"
    )
    paths = [str(file.with_suffix("")) for file in tmp_path.glob("*.json")]
    assert len(paths) == 2
    done = subprocess.run([sys.executable, "-c", script, *paths], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
