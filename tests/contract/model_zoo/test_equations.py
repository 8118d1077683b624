"""A function of the user is a family: its form and meaning are found out, it is compiled, stored and fitted."""

import linecache
import pickle
import re
import sys

import cloudpickle
import numpy as np
import pytest

from model_zoo import Parameter
from sysid_evo import as_model, load_model, load_plugin, make_model, save_model
from sysid_evo.errors import ArtefactError, IncompatibleSystem, InvalidArgument
from sysid_evo.models.adapters import as_spec
from sysid_evo.registry import models
from sysid_evo.registry.objects import keep_object
from sysid_evo.registry.plugins import PREFIX
from tests.fixtures.plants import pendulum

STIFFNESS, FRICTION, GAIN = 9.0, 0.5, 2.0
DRAWN = np.random.default_rng(0)


@pytest.fixture(scope="module")
def swinging():
    return pendulum()


def of_a_sample(x, u):
    angle, spin = x
    return np.array([spin, -STIFFNESS * np.sin(angle) - FRICTION * spin + GAIN * u[0]])


def of_rows(x, u):
    return np.stack([x[:, 1], -STIFFNESS * np.sin(x[:, 0]) - FRICTION * x[:, 1] + GAIN * u[:, 0]], axis=1)


def branching(x, u):
    if x[1] > 0.0:
        return [x[1], -STIFFNESS * np.sin(x[0]) - FRICTION * x[1] + GAIN * u[0]]
    return [x[1], -STIFFNESS * np.sin(x[0]) + FRICTION * np.abs(x[1]) + GAIN * u[0]]


@pytest.mark.parametrize(("function", "form"), [(of_a_sample, "columns"), (of_rows, "rows"), (branching, "single")])
def test_one_function_in_three_forms_is_one_model(function, form, swinging):
    expected = as_model(of_a_sample).fit(swinging, rng=0).simulate(swinging.episodes[0])
    model = as_model(function).fit(swinging, rng=0)
    assert (model.form_, model.returned_, model.fit_note) == (form, "rate", "used as it is")
    np.testing.assert_allclose(model.simulate(swinging.episodes[0]), expected, rtol=1e-9, atol=1e-9)


def next_states(x, u):
    return x[0] + 0.05 * x[1], x[1] + 0.05 * (-STIFFNESS * np.sin(x[0]) - FRICTION * x[1] + GAIN * u[0])


def test_rates_are_told_from_next_states_by_the_error_of_one_step(swinging):
    discrete = as_model(next_states).fit(swinging, rng=0)
    assert discrete.returned_ == "next_state"
    states, controls = swinging.episodes[0].states, swinging.episodes[0].controls
    np.testing.assert_allclose(discrete.simulate(states[0], controls[:1])[0], next_states(states[0], controls[0]))
    with pytest.raises(InvalidArgument, match=r"do not show whether unclear returns.*add returns='rate' or"):
        as_model(unclear).fit(swinging, rng=0)
    with pytest.raises(InvalidArgument, match="actuator_lag and residual need a function that returns rates"):
        make_model("equations", function=keep_object(next_states), actuator_lag=True).fit(swinging, rng=0)


def unclear(x, u):
    return 1.05 * x


NAMED = (("stiffness", 0.5, 50.0), Parameter("friction", 0.2, 0.0, 5.0, "1/s"), ("gain", 0.1, 10.0))


def with_parameters(x, u, p=NAMED):
    return [x[1], -p[0] * np.sin(x[0]) - p[1] * x[1] + p[2] * u[0]]


def with_parameters_of_rows(x, u, p=NAMED):
    return np.stack([x[:, 1], -p[0] * np.sin(x[:, 0]) - p[1] * x[:, 1] + p[2] * u[:, 0]], axis=1)


@pytest.mark.parametrize("function", [with_parameters, with_parameters_of_rows])
def test_parameters_are_fitted_within_the_bounds_that_p_gives(function, swinging):
    model = make_model("equations", function=keep_object(function), starts=2, windows=80).fit(swinging, rng=0)
    np.testing.assert_allclose(model.parameters_, [STIFFNESS, FRICTION, GAIN], rtol=0.02)
    assert [row["parameter"] for row in model.parameters_table()] == ["stiffness", "friction", "gain"]
    assert [one.guess for one in model.law_parameters()] == [5.0, 0.2, 1.0]
    assert "used as it is" not in model.fit_note
    with pytest.raises(InvalidArgument, match="p has bounds but no values"):
        as_model(function, fitted=True)


@pytest.mark.parametrize(
    ("function", "error", "message"),
    [
        (lambda x: x, InvalidArgument, r"expected f\(x, u\), or f\(x, u, p\) with bounds.*got <lambda>\(x\)"),
        (lambda x, u, p: x, InvalidArgument, r"with bounds as the default of p"),
        (lambda x, u, p=(): x, InvalidArgument, r"parameters as the default of p, got \(\)"),
        (lambda x, u, p=(3,): x, InvalidArgument, r"expected a Parameter or \(name, low, high\), got 3"),
        (lambda x, u: x[:1], IncompatibleSystem, r"returns 2 numbers; got ValueError: 1 numbers for 2 states"),
        (
            lambda x, u: np.where(x > 1.0, np.nan, x),
            InvalidArgument,
            r"expected finite numbers at the recorded states, got .*nan",
        ),
        (lambda x, u: x + DRAWN.random(), InvalidArgument, "must neither draw random numbers nor keep values"),
    ],
)
def test_a_function_that_cannot_be_used_is_refused_with_an_example(function, error, message, swinging):
    with pytest.raises(error, match=message):
        make_model("equations", function=keep_object(function)).fit(swinging, rng=0)


def writing(x, u):
    x[:] = x[1], -STIFFNESS * np.sin(x[0]) - FRICTION * x[1] + GAIN * u[0]
    return x


def test_a_function_may_write_into_its_arguments(swinging):
    found, expected = (as_model(one).fit(swinging, rng=0) for one in (writing, of_a_sample))
    run = swinging.episodes[0]
    np.testing.assert_allclose(found.simulate(run), expected.simulate(run), rtol=1e-9)


def test_a_function_of_another_process_is_missed_by_its_name(swinging, tmp_path, monkeypatch):
    save_model(as_model(of_a_sample).fit(swinging, rng=0), tmp_path / "model")
    monkeypatch.setattr("sysid_evo.registry.objects._objects", {})
    with pytest.raises(ArtefactError, match=r"model.json: <Python object of_a_sample \w+> was given in Python"):
        load_model(tmp_path / "model")


FILE = "import numpy as np\n\n\ndef swing(x, u):\n    return [x[1], -5.0 * np.sin(x[0]) - {} * x[1] + u[0]]\n"


def test_a_function_of_a_plugin_file_is_stored_by_its_name_and_found_again(swinging, tmp_path, monkeypatch):
    file = tmp_path / "my_swing.py"
    file.write_text(FILE.format(0.3))
    load_plugin(file)
    model = make_model("equations", function="swing").fit(swinging, rng=0)
    restored = load_model(save_model(model, tmp_path / "model"))
    assert np.array_equal(restored.simulate(swinging.episodes[0]), model.simulate(swinging.episodes[0]))
    first = models.identity("equations(function=swing)")
    function = sys.modules[f"{PREFIX}my_swing"].swing
    assert as_spec(function).text == "equations(function='my_swing.swing')"
    monkeypatch.delitem(sys.modules, f"{PREFIX}my_swing")
    with pytest.raises(ArtefactError, match=re.escape("got 'swing', which is in none; add --plugin FILE")):
        load_model(tmp_path / "model")
    file.write_text(FILE.format(0.4))
    load_plugin(file)
    assert models.identity("equations(function=swing)") != first, "results of a changed function are computed again"
    monkeypatch.delitem(sys.modules, f"{PREFIX}my_swing")


def test_functions_with_the_same_name_and_other_values_are_different_objects():
    def scaled(factor):
        def law(x, u):
            return factor * x

        return law

    assert len({as_spec(scaled(factor)).text for factor in (1.0, 2.0)}) == 2


def test_a_worker_reads_a_function_of_a_notebook(swinging):
    """The source of a cell is known to the process of the notebook alone."""
    text = "def law(x, u):\n    return [x[1] if x[1] > 0.0 else 2.0 * x[1], u[0]]\n"
    linecache.cache["<cell>"] = (len(text), None, text.splitlines(keepends=True), "<cell>")
    found = {"__name__": "__main__"}
    exec(compile(text, "<cell>", "exec"), found)
    as_model(found["law"])
    del linecache.cache["<cell>"]
    sent = pickle.loads(cloudpickle.dumps(found["law"]))
    model = make_model("equations", function=keep_object(sent, text), returns="rate").fit(swinging, rng=0)
    assert model.form_ == "columns", "a choice becomes np.where"
