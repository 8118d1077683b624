"""Hyper-parameters that a family declares as annotated names of its class."""

from __future__ import annotations

import inspect
import sys
import types
from typing import ClassVar, Literal

import pytest
from sklearn.base import clone

from sysid_evo.errors import InvalidArgument, UnknownParameter
from sysid_evo.models import DynamicsModel
from sysid_evo.models.parameters import Limit, at_least


class Declared(DynamicsModel):
    """Two hyper-parameters, and names that are none."""

    offered: ClassVar[tuple[int, ...]] = (1, 2)
    limits: ClassVar[dict[str, Limit]] = {"degree": at_least(1)}
    degree: int = 2
    form: Literal["plain", "odd"] = "plain"

    def fit(self, dataset, *, rng, progress=None):
        return self


class Wider(Declared):
    """One more; the module of a base may know types that this one does not."""

    ridge: float = 0.0


class Plain(Wider):
    """None of its own."""

    offered: ClassVar[tuple[int, ...]] = (3,)


class Weighted(DynamicsModel):
    """What another family may have as well."""

    weight: float = 1.0


class Both(Wider, Weighted):
    """None of its own, from two bases."""


def test_a_family_of_two_bases_takes_the_hyper_parameters_of_both():
    model = Both(weight=2.0, ridge=0.5)
    assert model.get_params() == {"degree": 2, "form": "plain", "ridge": 0.5, "weight": 2.0}


def test_declared_names_are_the_keywords_of_the_constructor_those_of_bases_too():
    assert list(inspect.signature(Declared).parameters) == ["degree", "form"]
    assert list(inspect.signature(Wider).parameters) == ["degree", "form", "ridge"]
    assert Wider(degree=3, ridge=0.5).get_params() == {"degree": 3, "form": "plain", "ridge": 0.5}
    assert clone(Plain(degree=4)).get_params() == {"degree": 4, "form": "plain", "ridge": 0.0}
    with pytest.raises(TypeError):
        Wider(3)


def test_values_and_names_are_checked_as_those_of_a_constructor_written_out():
    for parameters, message in (
        ({"degree": 0}, "degree: expected a whole number >= 1, got 0"),
        ({"degree": "two"}, "degree: expected a whole number >= 1, got 'two'"),
        ({"form": "even"}, "form: expected one of 'plain', 'odd', got 'even'"),
    ):
        for family in (Declared, Wider, Plain):
            with pytest.raises(InvalidArgument, match=message):
                family(**parameters)
    with pytest.raises(UnknownParameter, match=r"no parameter 'ridgee'. Did you mean 'ridge'\? It has: degree, form"):
        Wider(ridgee=1.0)


def test_a_type_is_read_in_the_module_that_declared_it(monkeypatch):
    """A subclass elsewhere, where `Literal` has no name, is still held to it."""
    elsewhere = types.ModuleType("elsewhere")
    monkeypatch.setitem(sys.modules, "elsewhere", elsewhere)
    vars(elsewhere)["Declared"] = Declared
    exec("from __future__ import annotations\nclass Own(Declared):\n    more: int = 1\n", vars(elsewhere))
    with pytest.raises(InvalidArgument, match="form: expected one of"):
        vars(elsewhere)["Own"](form="even")
    with pytest.raises(InvalidArgument, match="more: expected a whole number"):
        vars(elsewhere)["Own"](more="even")
