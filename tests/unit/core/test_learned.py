"""What a family declares of the arrays that it learned, and who is held to it."""

import numpy as np
import pytest

from sysid_evo.errors import InvalidArgument, ShapeError
from sysid_evo.evolution import Champion
from sysid_evo.models import DynamicsModel, load_model, save_model
from sysid_evo.models.base import make_model
from sysid_evo.models.kernels import Predictor, gaussian_predictor, network_predictor
from sysid_evo.models.learned import Numbers, check_learned
from sysid_evo.registry import models


class Gains(DynamicsModel):
    """Learns one gain for each state, and declares nothing."""

    def fit(self, dataset, *, rng, progress=None):
        self.gains_ = np.full(dataset.system.nx, 0.9)
        self.limits_ = np.array([-np.inf, np.inf])
        return self

    def next_state(self, carry, control):
        return carry[:, : self.system.nx] * self.gains_


class Declaring(Gains):
    """Learns the same, and declares it."""

    def learned_arrays(self):
        return {"gains_": (self.system.nx,), "limits_": Numbers("limits", infinite=True, rising=True)}


class Forgetful(Gains):
    """Declares one of two arrays."""

    def learned_arrays(self):
        return {"gains_": (self.system.nx,)}


def test_a_family_that_declares_nothing_is_loaded_but_for_nan(register, car_data, tmp_path):
    model = register(models, "gains", Gains)().fit(car_data)
    save_model(model, tmp_path / "gains")
    assert load_model(tmp_path / "gains").limits_.tolist() == [-np.inf, np.inf]
    model.gains_ = np.array([0.9, np.nan, 0.9])
    with pytest.raises(InvalidArgument, match="gains_: expected numbers, some are nan"):
        save_model(model, tmp_path / "nan")


@pytest.mark.parametrize(
    ("gains", "limits", "said"),
    [
        (np.ones(2), [-1.0, 1.0], r"gains_: expected shape \(3\), got \(2,\)"),
        (np.ones((3, 1)), [-1.0, 1.0], r"gains_: expected shape \(3\), got \(3, 1\)"),
        (np.full(3, np.inf), [-1.0, 1.0], "gains_: expected finite numbers, some are not"),
        (np.ones(3), [1.0, -1.0], "limits_: expected numbers that do not fall"),
        (np.ones(3), [], r"limits_: expected shape \(limits\), got \(0,\)"),
        (np.ones(3, dtype=bool), [-1.0, 1.0], "gains_: expected real numbers, got bool"),
        (None, [-1.0, 1.0], "gains_: expected real numbers, got nothing"),
    ],
)
def test_what_is_not_as_declared_is_refused_in_a_sentence(gains, limits, said, car_data):
    model = Declaring().fit(car_data)
    model.gains_, model.limits_ = gains, np.array(limits)
    with pytest.raises(ShapeError, match=said):
        check_learned(model)


def test_an_array_that_a_family_forgot_to_declare_is_named(car_data):
    assert list(check_learned(Declaring().fit(car_data))) == []
    assert list(check_learned(Forgetful().fit(car_data))) == ["limits_"]


@pytest.mark.parametrize("name", ["coefficients_", "intercept_"])
def test_a_model_set_up_in_python_with_wrong_arrays_has_no_kernel(name, car_data):
    model = make_model("linear").fit(car_data)
    setattr(model, name, np.delete(getattr(model, name), -1, axis=-1))
    with pytest.raises(ShapeError):
        model.kernel()


def test_a_predictor_for_another_system_is_refused_at_the_step(car_data):
    """Its arrays fit each other; it would write four rows where there are three, or read one too many."""
    model = make_model("linear").fit(car_data)
    for n_carry, n_out in ((3, 4), (4, 3)):
        layers = [(np.zeros((n_carry + 2, n_out)), np.zeros(n_out))]
        with pytest.raises(ShapeError, match="the learned arrays do not fit the system"):
            model.stepping(network_predictor([layers], n_carry, 2))
    silent = Predictor(network_predictor([layers], 4, 2).function, np.zeros(1), 0)
    assert model.stepping(silent) is not None


def test_bumps_of_other_lengths_are_refused():
    given = {
        "points": np.zeros((5, 3)), "lengths": np.ones((2, 3)), "weights": np.zeros((2, 5)),
        "slope": np.zeros((3, 2)), "intercept": np.zeros(2),
    }  # fmt: skip
    gaussian_predictor(**given, n_carry=2)
    for name, array in given.items():
        if name != "lengths":
            with pytest.raises(ShapeError, match=name):
                gaussian_predictor(**{**given, name: array[:-1] if name != "points" else array[:, :-1]}, n_carry=2)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"parameters": np.array([0.1, np.nan, 0.0, 0.0])}, "parameters: expected finite numbers"),
        ({"population": np.zeros((2, 3))}, r"population: expected shape \(any, 4\), got \(2, 3\)"),
    ],
)
def test_a_controller_with_wrong_numbers_is_not_loaded(changed, said):
    """Those of a changed file: nan would drive a robot as whatever its limits make of it."""
    champion = Champion("mm1", np.ones(4), ("linear",), "min", 0, np.zeros((1, 3)), population=np.ones((2, 4)))
    with pytest.raises((InvalidArgument, ShapeError), match=said):
        Champion.from_dict(champion.to_dict(), {**champion.tensors, **changed})
