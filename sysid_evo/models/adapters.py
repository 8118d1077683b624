"""Objects of other packages as models: the base class of adapters, and models, specs and labels of objects."""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, ClassVar, cast

from sysid_evo.artefacts import strict_json
from sysid_evo.errors import InvalidArgument
from sysid_evo.models.base import AnyModel, DynamicsModel, make_model
from sysid_evo.registry.grammar import Spec
from sysid_evo.registry.objects import class_name, keep_object
from sysid_evo.registry.plugins import SHIPPED
from sysid_evo.registry.registry import adapters, models


class Adapter(ABC):
    """Recognises the objects of one package and makes models of them, without importing the package.

    - ``example``: an expression that makes such an object; messages show it.
    """

    example: ClassVar[str]

    @abstractmethod
    def recognises(self, thing: object) -> bool:
        """Whether `model` accepts ``thing``; see `bases_of`."""

    @abstractmethod
    def model(self, thing: Any, *, fitted: bool = False) -> DynamicsModel:
        """Return an unfitted model of a registered family that has ``thing`` as a hyper-parameter.

        The `fit` of the model fits a copy of ``thing``. With ``fitted``, or if ``thing`` is fitted or has nothing to
        fit, it uses ``thing`` as it is, and `fit_note` reports that. Raises `InvalidArgument` for an object that cannot
        be used.
        """

    def content(self, thing: Any) -> object:
        """Return what determines ``thing``, as values that joblib can hash; by default ``thing`` itself."""
        return thing


def bases_of(thing: object) -> set[str]:
    """Return the classes of ``thing``, the inherited ones too, as ``package.Class``: ``torch.Module``."""
    return {f"{base.__module__.partition('.')[0]}.{base.__name__}" for base in type(thing).__mro__}


def adapter_of(thing: object) -> Adapter | None:
    """Return the adapter that recognises ``thing``, one of a plugin first; None if there is none."""
    names = sorted(adapters.names(), key=lambda name: adapters.module(name).partition(".")[0] in SHIPPED)
    found = (adapters.make(name) for name in names)
    return next((adapter for adapter in found if adapter.recognises(thing)), None)


def as_model(thing: object, *, fitted: bool = False) -> AnyModel:
    """Return the unfitted model of a spec or of an object that an adapter recognises; a model is returned unchanged.

    With ``fitted`` the object is used as it is; `fit` then records the data only. Raises `InvalidArgument`.
    """
    if isinstance(thing, AnyModel):
        return thing
    if isinstance(thing, (str, Spec)):
        return make_model(thing)
    adapter = None if isinstance(thing, type) else adapter_of(thing)
    if adapter is None:
        got = f"an object of the class {class_name(thing)}"
        if isinstance(thing, type):
            got = f"the class {thing.__name__}: an object is {thing.__name__}()"
        line = ", ".join(["'narx'", *(str(adapters.glance(name, "example")) for name in adapters.names())])
        raise InvalidArgument(
            f"expected the name of a family, or an object of a kind that an adapter recognises "
            f"({', '.join(adapters.names())}), got {got}. This works: models=[{line}]. A callable is passed as "
            "lambda x, u: thing(x, u); anything else becomes a family, see sysid-evo plugin new"
        )
    return cast("AnyModel", adapter.model(thing, fitted=fitted))


def as_spec(given: object) -> Spec:
    """Return the spec of a text, of an unfitted model or of an object that an adapter recognises.

    Its label is the name of the class or function. A preset changes no parameter of a model that is ``given`` itself,
    or of an object that is used as it is.
    Raises `InvalidArgument`.
    """
    if isinstance(given, Spec):
        return given
    if isinstance(given, str):
        return Spec.parse(given)
    model = as_model(given)
    name = family_name(model)
    if hasattr(model, "system_"):
        raise InvalidArgument(
            f"expected an unfitted {name}, got a fitted one, which would be fitted again: pass .clone_unfitted()"
        )
    defaults = models.parameters(name)
    as_it_is = model is given or getattr(model, "fitted", False)
    kept = {key for preset in model.presets.values() for key in preset} if as_it_is else set()
    parameters = {
        key: value
        for key, value in plain_parameters(model).items()
        if key not in defaults or value != defaults[key] or key in kept
    }
    try:
        strict_json(parameters)
    except ValueError as error:
        raise InvalidArgument(f"{name}: its parameters cannot be written: {error}") from error
    label = name if isinstance(given, DynamicsModel) else re.sub(r"\W", "", class_name(given))
    return Spec(name, parameters, label)


def model_texts(given: Sequence[object] | Mapping[str, object]) -> tuple[str, ...]:
    """Return the specs of models as texts; the keys of a mapping are the labels. Raises `InvalidArgument`."""
    if isinstance(given, Mapping):
        odd = next((label for label in given if not re.fullmatch(r"[A-Za-z_][\w.-]*", label)), None)
        if odd is not None:
            raise InvalidArgument(f"models: expected names of letters, digits and _, such as my_model, got {odd!r}")
        named = ((label, as_spec(one)) for label, one in given.items())
        return tuple(str(Spec(one.name, one.parameters, label)) for label, one in named)
    if not isinstance(given, Iterable):
        raise InvalidArgument(f"models: expected a list or a dict, got an object of the class {class_name(given)}")
    texts = [one if isinstance(one, str) else str(as_spec(one)) for one in given]
    labels = Counter(as_spec(one).label for one in given if not isinstance(one, str))
    repeated = next((label for label, count in labels.items() if count > 1), None)
    if repeated is not None:
        raise InvalidArgument(
            f"{labels[repeated]} objects are called {repeated}: name them by a dict, models={{'a': {repeated}(...), "
            f"'b': {repeated}(...)}}"
        )
    return tuple(texts)


def plain_parameters(model: DynamicsModel) -> dict[str, Any]:
    """Return the hyper-parameters of ``model`` with texts for objects from Python, see `sysid_evo.registry.objects`.

    An object in a list is a model, so that its text is a spec. Objects without an adapter are unchanged.
    """
    return {name: _plain(value) for name, value in model.get_params(deep=False).items()}


def _plain(value: Any, *, in_list: bool = False) -> Any:
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    if isinstance(value, (list, tuple)):
        return [_plain(item, in_list=True) for item in value]
    if in_list and isinstance(value, DynamicsModel):
        return as_spec(value).text
    adapter = adapter_of(value)
    if adapter is None:
        return value
    return as_spec(value).text if in_list else keep_object(value, adapter.content(value))


def family_name(model: DynamicsModel) -> str:
    """Return the name under which the class of ``model`` is registered."""
    for name, family in models.loaded.items():
        if family is type(model):
            return name
    raise InvalidArgument(
        f"{type(model).__name__} is not a registered family: decorate it with @register_model(name), "
        "so that it can be found again when it is loaded"
    )
