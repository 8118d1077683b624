"""The compiled form of objects of other packages and of functions of the user; what has none runs in NumPy."""

import numpy as np
import pytest

from sysid_evo import as_model
from sysid_evo.registry.objects import keep_object
from sysid_evo.testing import MODEL
from tests.fixtures.plants import pendulum

RATES, PUSH = np.array([[0.0, 1.0], [-9.0, -0.5]]), np.array([[0.0], [2.0]])


@pytest.fixture(scope="module")
def swinging():
    return pendulum()


def expect_compiled(family, dataset, **options):
    """Raise `AssertionError` unless the family keeps the contract, its compiled form included."""
    results = list(MODEL.run(family, dataset, **options))
    assert not [f"{one.rule}: {one.failure}" for one in results if one.failure]
    assert not next(one for one in results if one.rule.startswith("The compiled form")).idle


def of_numpy(x, u):
    a = np.minimum(np.tanh(x[0]), np.maximum(np.cos(x[1]), 0.1)) + np.arctan2(x[0], 2.0) * np.sqrt(np.abs(x[1]))
    return np.asarray([a + np.exp(-np.pi * np.abs(x[0])), np.power(np.abs(x[1]) + 1.0, 1.5) - np.fabs(u[0])])


def branching(x, u):
    if x[1] > 0.0:
        return [x[1], -9.0 * np.sin(x[0]) - 0.5 * x[1] + 2.0 * u[0]]
    return [x[1], -9.0 * np.sin(x[0]) + 0.7 * np.abs(x[1]) + 2.0 * u[0]]


def with_a_parameter(x, u, p=(("stiffness", 1.0, 50.0),)):
    return x[1], -p[0] * np.sin(x[0]) - 0.5 * x[1] + 2.0 * u[0]


@pytest.mark.parametrize("function", [of_numpy, branching, with_a_parameter])
def test_functions_of_numpy_have_a_compiled_form(function, swinging):
    options = {"starts": 1, "windows": 30}
    expect_compiled("equations", swinging, function=keep_object(function), returns="rate", **options)


def of_rows(x, u):
    return np.stack([x[:, 1], -9.0 * np.sin(x[:, 0]) - 0.5 * x[:, 1] + 2.0 * u[:, 0]], axis=1)


def of_matrices(x, u):
    return RATES @ x + PUSH @ u


@pytest.mark.parametrize(("function", "form"), [(of_rows, "rows"), (of_matrices, "columns")])
def test_a_function_that_cannot_be_compiled_runs_in_numpy(function, form, swinging):
    model = as_model(function).fit(swinging, rng=0)
    assert (model.form_, model.kernel()) == (form, None)
    assert "runs in NumPy" in model.fit_note


@pytest.mark.parametrize("kind", ["SINDy", "DiscreteSINDy"])
def test_objects_of_pysindy_have_a_compiled_form(kind, swinging):
    ps = pytest.importorskip("pysindy")
    sines = ps.CustomLibrary([lambda a: np.sin(a), lambda a: a * np.abs(a)])
    thing = getattr(ps, kind)(feature_library=ps.TensoredLibrary([ps.PolynomialLibrary(1), sines]))
    expect_compiled("pysindy", swinging, model=keep_object(thing))


LAGGED = [[[0.0, 1.0, 0.0], [-9.0, -0.5, 2.0], [0.0, 0.0, -8.0]], [[0.0], [0.0], [8.0]], np.eye(2, 3).tolist(), 0]


@pytest.mark.parametrize("matrices", [[RATES.tolist(), PUSH.tolist(), np.eye(2).tolist(), 0], LAGGED])
def test_linear_systems_have_a_compiled_form(matrices, swinging):
    expect_compiled("lti", swinging, model=matrices)


@pytest.mark.parametrize("returns", ["rate", "change", "next_state"])
def test_linear_layers_with_tanh_have_a_compiled_form(returns, swinging):
    torch = pytest.importorskip("torch")
    torch.manual_seed(0)
    layers = torch.nn.Sequential(torch.nn.Linear(3, 5), torch.nn.Tanh(), torch.nn.Linear(5, 2, bias=False))
    expect_compiled("torch_module", swinging, module=keep_object(layers), returns=returns, updates=3, horizon=2)
