"""Optional dependencies: the extra of a distribution that installs a missing module."""

from __future__ import annotations

import re
from collections.abc import Iterable
from importlib.metadata import Distribution, PackageNotFoundError, requires
from importlib.util import find_spec

from sysid_evo.errors import MissingExtra

DISTRIBUTION = "sysid-evo"
PACKAGES = {
    "serial": "pyserial",
    "sklearn": "scikit-learn",
    "vehiclemodels": "commonroad-vehicle-models",
    "yaml": "pyyaml",
    "cv2": "opencv-python",
}
"""Packages whose modules have another name; this cannot be looked up if they are not installed."""
EXTRA = re.compile(r"""extra == ['"]([^'"]+)['"]""")


def extra_of(module: str, distribution: str | Distribution = DISTRIBUTION) -> str | None:
    """Return the extra of ``distribution`` that installs ``module``, or None.

    Of several extras it is the one with the fewest packages, so never the one with all of them. ``module``
    may be a submodule. The metadata of ``distribution`` (or its name) are read; only that must be installed.
    """
    from packaging.requirements import Requirement  # help pages do without it
    from packaging.utils import canonicalize_name

    top = module.partition(".")[0]
    package = canonicalize_name(PACKAGES.get(top, top))
    try:
        texts = requires(distribution) if isinstance(distribution, str) else distribution.requires
    except PackageNotFoundError:
        return None
    brings: dict[str, set[str]] = {}
    for requirement in map(Requirement, texts or ()):
        found = EXTRA.search(str(requirement.marker or ""))
        if found is not None:
            brings.setdefault(found[1], set()).add(canonicalize_name(requirement.name))
    return min((extra for extra in brings if package in brings[extra]), key=lambda e: (len(brings[e]), e), default=None)


def missing_extra(what: str, module: str | None, distribution: str | Distribution = DISTRIBUTION) -> MissingExtra:
    """Return the error for ``what`` that needs ``module``, with the command that installs it.

    ``what`` begins the sentence, such as "manual driving". For a module without an extra, the package itself is to be
    installed.
    """
    top = (module or "?").partition(".")[0]
    extra = extra_of(top, distribution)
    name = distribution if isinstance(distribution, str) else distribution.name
    wanted = PACKAGES.get(top, top) if extra is None else f"{name}[{extra}]"
    return MissingExtra(
        f"{what} needs the package {PACKAGES.get(top, top)!r}, which is not installed. "
        f'Install it with: pip install "{wanted}"'
    )


def check_installed(what: str, modules: Iterable[str]) -> None:
    """Raise `missing_extra` for the first of ``modules`` that is not installed; nothing is imported."""
    for module in modules:
        if find_spec(module) is None:
            raise missing_extra(what, module)
