"""What `auto` means, by `SYSID_EVO_ENGINE`: where two forms exist, in digests and checkpoints, in other processes."""

import hashlib
import importlib
import json

import numpy as np
import pytest

from evaluation.cells.data import HoldOut, RecordedData
from model_zoo.grey_box import estimation
from sysid_evo import predictive_control
from sysid_evo.artefacts import CheckpointFile
from sysid_evo.cli.console import code_of
from sysid_evo.controllers.linear import LinearFeedback
from sysid_evo.engine import DynamicsRunner, reference, rollout
from sysid_evo.errors import CheckpointWarning, InvalidArgument
from sysid_evo.evolution import ControllerEvolution, ModelEvolution, evolve_controller, model_evolution
from sysid_evo.models.base import make_model
from sysid_evo.plan import CELL_KINDS, CONTRACT, Plan
from sysid_evo.processors import resolve
from sysid_evo.randomness import trial_seeds
from sysid_evo.registry.grammar import Spec
from sysid_evo.tasks.point_to_point import PointToPoint
from sysid_evo.testing import example_dataset
from sysid_evo.testing.contract import NotApplicable, expect_kernel
from sysid_evo.testing.examples import ExampleDynamics, switched_car

ROLLOUT = importlib.import_module("sysid_evo.engine.rollout")  # the package has a function of this name
CAR = switched_car()
TASK = PointToPoint(horizon=5).bind(CAR)
SEEDS = trial_seeds(0, 1)


class Compiled(BaseException):
    """The compiled form was asked for; no fit takes it for a failure of its own."""


class InNumPy(BaseException):
    """The NumPy form was asked for."""


def recorded():
    return RecordedData(Spec("emulated_car"), 1, 0.5, HoldOut()).cell()


class Uncompiled(ExampleDynamics):
    """Takes the same steps under both engines."""

    def kernel(self):
        return None


def rolled_out(**engine):
    controller = LinearFeedback()
    parameters = np.zeros((1, controller.bind_to(TASK).n_parameters))
    rollout(ExampleDynamics(CAR), controller, parameters, TASK, SEEDS, **engine)


def imagined_trials(**engine):
    nothing = np.zeros((1, 0, CAR.nu))
    imagination = predictive_control.ImaginedTrials(ExampleDynamics(CAR), TASK, **engine)
    imagination.scores(np.zeros((1, 1, CAR.nx)), nothing, np.zeros((2, 1, 3, CAR.nu)), TASK.begin(SEEDS))


def parameters_evolved():
    make_model("parametrised", generations=1).fit(example_dataset(), rng=0)


def grey_box_fitted():
    make_model("single_track", starts=1).fit(example_dataset(), rng=0)


FORMS = {
    rolled_out: ((ROLLOUT, "LoopData"), (reference, "run")),
    imagined_trials: ((predictive_control, "CompiledImagined"), (predictive_control.ImaginedTrials, "_run")),
    parameters_evolved: ((model_evolution, "final_errors"), (model_evolution, "final_error")),
    grey_box_fitted: ((estimation, "free_runs"), (estimation.FitWindows, "_stepped")),
}


@pytest.fixture
def engine(monkeypatch):
    def chosen(name):
        monkeypatch.setenv("SYSID_EVO_ENGINE", name)

    return chosen


@pytest.fixture
def noticed(monkeypatch):
    def raising(signal):
        def raises(*_, **__):
            raise signal

        return raises

    for forms in FORMS.values():
        for (owner, name), signal in zip(forms, (Compiled, InNumPy), strict=True):
            monkeypatch.setattr(owner, name, raising(signal))


@pytest.mark.parametrize("name, form", [("", Compiled), ("auto", Compiled), ("reference", InNumPy)])
@pytest.mark.parametrize("work", FORMS)
@pytest.mark.usefixtures("noticed")
def test_auto_is_the_form_that_the_variable_names(engine, work, name, form):
    engine(name)
    with pytest.raises(form):
        work()


@pytest.mark.parametrize("named, asked, form", [("reference", "float64", Compiled), ("auto", "reference", InNumPy)])
@pytest.mark.parametrize("work", [rolled_out, imagined_trials])
@pytest.mark.usefixtures("noticed")
def test_an_engine_named_explicitly_runs_whatever_the_variable_names(engine, work, named, asked, form):
    engine(named)
    with pytest.raises(form):
        work(engine=asked)


def test_without_the_variable_auto_stays_auto(monkeypatch):
    monkeypatch.delenv("SYSID_EVO_ENGINE", raising=False)
    assert resolve() == resolve("auto") == "auto"


@pytest.mark.parametrize("value", ["numpy", "Reference", "float64"])
def test_another_value_is_refused_with_what_to_do(engine, value):
    engine(value)
    with pytest.raises(InvalidArgument, match=f"SYSID_EVO_ENGINE: expected auto or reference, got '{value}'. .*unset"):
        resolve()
    assert resolve("float32") == "float32"


def test_a_plan_refuses_another_value_before_it_computes_anything(engine):
    engine("numpy")
    with pytest.raises(InvalidArgument, match="SYSID_EVO_ENGINE") as refused:
        Plan.of([recorded()])
    assert code_of(refused.value) == 2


def test_a_digest_contains_the_engine_where_it_is_not_auto(engine):
    def digest(name):
        engine(name)
        return recorded().digest

    cell = recorded()
    version = CELL_KINDS[cell.kind].version
    content = {
        "kind": cell.kind,
        "version": version,
        "contract": CONTRACT,
        "inputs": cell.settings.inputs(),
        "needs": [],
    }
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    assert digest("") == digest("auto") == hashlib.sha256(text.encode()).hexdigest()
    assert digest("reference") != digest("auto")


def controller_evolved(checkpoint, progress):
    settings = ControllerEvolution(
        generations=3, trials=1, controller="linear", task="point_to_point(horizon=5)",
        strategy="mu_plus_lambda(parents=2, children=2)",
    )  # fmt: skip
    runners = {"car": DynamicsRunner(Uncompiled(CAR))}
    evolve_controller("c", runners, CAR, settings, seed=3, checkpoint=checkpoint, progress=progress)


def model_evolved(checkpoint, progress):
    ModelEvolution(generations=3, windows=5, horizon=2, parents=2, children=2).run(
        lambda p, x, u: x * p[:, :1, None], example_dataset(), initial=np.zeros(1), spread=0.1,
        rng=np.random.default_rng(1), checkpoint=checkpoint, progress=progress,
    )  # fmt: skip


@pytest.mark.parametrize("evolved", [controller_evolved, model_evolved])
def test_a_checkpoint_of_one_engine_is_refused_under_the_other(engine, evolved, tmp_path):
    """Both engines give the same steps here, so that only the name of the engine distinguishes their results."""

    class Stop(Exception):
        pass

    def stopping(done, total, note=""):
        raise Stop

    def resumed():
        done = []
        evolved(CheckpointFile(tmp_path / "c"), lambda step, *_: done.append(step))
        return done[0]

    engine("reference")
    with pytest.raises(Stop):
        evolved(CheckpointFile(tmp_path / "c"), stopping)
    kept = (tmp_path / "c").read_bytes()
    engine("auto")
    with pytest.warns(CheckpointWarning, match="of other work .*engine.* computed again"):
        resumed()
    (tmp_path / "c").write_bytes(kept)
    engine("reference")
    resumed()  # a warning would be an error


def test_the_kits_do_not_compile_where_the_reference_is_named(engine):
    kernel = ExampleDynamics(CAR).kernel()
    engine("reference")
    with pytest.raises(NotApplicable, match="SYSID_EVO_ENGINE is reference"):
        expect_kernel(kernel)
    engine("auto")
    assert expect_kernel(kernel) is kernel
    with pytest.raises(NotApplicable, match="it has no compiled form"):
        expect_kernel(None)
