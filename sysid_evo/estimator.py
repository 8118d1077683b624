"""What scikit-learn's tools ask of an estimator, without importing scikit-learn, which takes a second."""

from __future__ import annotations

import copy
import inspect
from typing import TYPE_CHECKING, Any, Self

if TYPE_CHECKING:
    from sklearn.utils import Tags


class Estimator:
    """An object whose constructor only stores its arguments, under their names.

    `sklearn.base.clone` and `GridSearchCV` take it for one of their own.
    """

    def get_params(self, deep: bool = True) -> dict[str, Any]:
        """Return the constructor's arguments; ``deep`` is there for scikit-learn, nothing is nested."""
        return {name: getattr(self, name) for name in sorted(inspect.signature(type(self)).parameters)}

    def set_params(self, **parameters: Any) -> Self:
        """Set some of the constructor's arguments."""
        for name, value in parameters.items():
            setattr(self, name, value)
        return self

    def unfitted(self) -> Self:
        """Return another one with copies of the same arguments that has learned nothing."""
        return type(self)(**copy.deepcopy(self.get_params()))

    def variant(self, **parameters: Any) -> Self:
        """Return a copy with everything that was learned, and other hyper-parameters."""
        other: Self = self.unfitted().set_params(**parameters)
        other.__dict__.update({name: value for name, value in vars(self).items() if name.endswith("_")})
        return other

    def __repr__(self) -> str:
        defaults = {name: one.default for name, one in inspect.signature(type(self)).parameters.items()}
        changed = (
            f"{name}={value!r}" for name, value in self.get_params().items() if repr(value) != repr(defaults[name])
        )
        return f"{type(self).__name__}({', '.join(changed)})"

    def __sklearn_tags__(self) -> Tags:
        from sklearn.utils import Tags, TargetTags

        return Tags(estimator_type=None, target_tags=TargetTags(required=False))
