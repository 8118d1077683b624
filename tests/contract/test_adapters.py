"""Objects of other packages as models: the models that adapters make, the texts of objects, refusals."""

import pickle
import re
import subprocess
import sys

import numpy as np
import pytest

import sysid_evo.registry.objects as table
from evaluation import compare
from evaluation.chosen_models import with_preset
from model_zoo.auto.candidates import candidates_named
from model_zoo.average import Average
from model_zoo.linear import Linear
from model_zoo.polynomial.narx import Narx
from sysid_evo import Adapter, ControllerEvolution, as_model, evolve_controller
from sysid_evo.errors import InvalidArgument
from sysid_evo.models import load_model, save_model
from sysid_evo.models.adapters import as_spec, model_texts
from sysid_evo.registry import models
from sysid_evo.registry.objects import keep_object, kept_object, objects_named, receive_objects
from sysid_evo.registry.registry import adapters

pytestmark = pytest.mark.usefixtures("blank_figures")


class Gain:
    """An object of a package that knows nothing of this project."""

    def __init__(self, strength):
        self.strength = strength


class Gained(Linear):
    """A family with an object as a hyper-parameter."""

    thing: object = None

    def fit(self, dataset, *, rng, progress=None):
        self.strength_ = kept_object(self.thing).strength
        return super().fit(dataset, rng=rng)


class Gains(Adapter):
    """Gains are linear models."""

    example = "Gain(0.1)"

    def recognises(self, thing):
        return isinstance(thing, Gain)

    def model(self, thing, *, fitted=False):
        return Gained(thing=thing)


@pytest.fixture(autouse=True)
def _registered(register):
    register(models, "gained", Gained)
    register(adapters, "gains", Gains)


def test_an_object_is_compared_and_its_run_names_it_as_an_object_from_python(throttle_car_data, tmp_path):
    found = compare(throttle_car_data, models=["linear", Gain(0.1)], stop_after="prediction", out=tmp_path)
    assert [model.name for model in found.models] == ["linear", "Gain"]
    named = re.compile(r"Gain=gained\(thing='<Python object Gain [0-9a-f]{16}>'\)")
    assert named.search((tmp_path / "experiment.toml").read_text())
    assert named.search((tmp_path / "report.json").read_text())


def test_the_same_content_is_computed_once_and_other_content_again(throttle_car_data, tmp_path):
    for strength in (0.1, 0.1, 0.2):
        compare(throttle_car_data, models={"mine": Gain(strength)}, stop_after="fit", out=tmp_path)
    assert len(list((tmp_path / "models").glob("mine-*.json"))) == 2


def test_an_object_is_kept_as_it_was_when_it_was_given():
    thing = Gain(0.5)
    text = keep_object(thing)
    thing.strength = 7.0
    assert kept_object(text).strength == 0.5
    assert keep_object(thing) != text
    assert kept_object("Ridge") == "Ridge", "other texts stand for themselves"


def test_a_worker_gets_the_objects_that_a_cell_names(monkeypatch):
    sent = pickle.dumps(str(as_spec(Gain(0.3))))
    objects = objects_named(sent)
    monkeypatch.setattr(table, "_objects", {})
    (text,) = objects
    with pytest.raises(InvalidArgument, match=re.escape(f"{text} was given in Python, and only its results")):
        kept_object(text)
    receive_objects(objects)
    assert kept_object(text).strength == 0.3


def test_functions_of_a_notebook_have_a_text_too():
    texts = {keep_object(one) for one in (lambda x: x, lambda x: x + 1)}
    assert len(texts) == 2
    assert all(kept_object(text)(1) in (1, 2) for text in texts)


def test_names_come_from_the_class_or_from_a_dict():
    assert model_texts(["narx", Linear(ridge=0.5)]) == ("narx", "linear(ridge=0.5)")
    (text,) = model_texts({"mine": Gain(0.1)})
    assert text.startswith("mine=gained(thing=")
    with pytest.raises(InvalidArgument, match="such as my_model, got 'my model'"):
        model_texts({"my model": "narx"})
    with pytest.raises(InvalidArgument, match=r"2 objects are called Gain: name them by a dict, models=\{'a': Gain"):
        model_texts([Gain(0.1), Gain(0.2)])


def test_a_function_of_a_script_from_standard_input_has_a_text():
    script = "from sysid_evo import as_model\ndef mine(x, u):\n    return -x\nprint(as_model(mine))"
    done = subprocess.run([sys.executable, "-"], input=script, capture_output=True, text=True, check=False)
    assert "<Python object mine " in done.stdout, done.stderr


def test_a_refused_object_is_named_with_a_line_that_works():
    with pytest.raises(InvalidArgument, match=r"data: expected a Dataset or paths of recordings, got Gain: Dataset\("):
        compare([Gain(0.1)])
    with pytest.raises(InvalidArgument, match="expected a list or a dict, got an object of the class Gain"):
        model_texts(Gain(0.1))
    with pytest.raises(InvalidArgument, match=r"got an object of the class array.*models=\['narx', .*Gain\(0.1\)"):
        as_model(__import__("array").array("d"))
    with pytest.raises(InvalidArgument, match=r"got the class Gain: an object is Gain\(\)"):
        as_model(Gain)


def test_a_preset_changes_no_parameter_of_a_model_that_is_given():
    spec = with_preset(as_spec(Narx(degree=1)), "quick")
    assert spec.parameters == {"degree": 1, "terms": None, "lag_search": "all"}


def test_a_fitted_model_is_not_fitted_again_in_silence(throttle_car_data):
    with pytest.raises(InvalidArgument, match=r"unfitted linear, got a fitted one.*clone_unfitted"):
        as_spec(Linear().fit(throttle_car_data))


def test_average_and_auto_take_objects(throttle_car_data, tmp_path):
    mean = Average(families=["linear", Gain(0.1), Linear(ridge=1.0)]).fit(
        throttle_car_data, rng=np.random.default_rng(0)
    )
    start = throttle_car_data.episodes[0].states[:1]
    controls = throttle_car_data.episodes[0].controls[:5]
    restored = load_model(save_model(mean, tmp_path / "mean"))
    assert np.array_equal(restored.simulate(start, controls), mean.simulate(start, controls))
    assert restored.families[0] == "linear"
    assert restored.families[1].startswith("gained(thing=")
    assert restored.families[2] == "linear(ridge=1.0)"
    assert candidates_named([Gain(0.1), "narx"])[0].spec.name == "gained"


def test_evolution_takes_the_fitted_model_of_an_object(throttle_car_data):
    with pytest.raises(InvalidArgument, match=r"as 'a', got Gain; fit it first: as_model\(Gain\(\.\.\.\)\)\.fit"):
        evolve_controller("a", {"a": Gain(0.1)}, throttle_car_data.system, ControllerEvolution(), seed=0)
