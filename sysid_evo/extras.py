"""Which optional part of a distribution brings a module that is not installed."""

from __future__ import annotations

import re
from collections.abc import Iterable
from importlib.metadata import Distribution, PackageNotFoundError, requires
from importlib.util import find_spec

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from sysid_evo.errors import MissingExtra

DISTRIBUTION = "sysid-evo"
PACKAGES = {"serial": "pyserial", "sklearn": "scikit-learn", "yaml": "pyyaml", "cv2": "opencv-python"}
"""Packages of modules that have another name, for what is not installed cannot be asked."""
EXTRA = re.compile(r"""extra == ['"]([^'"]+)['"]""")


def extra_of(module: str, distribution: str | Distribution = DISTRIBUTION) -> str | None:
    """Return the extra of ``distribution`` that brings ``module``, None if none does.

    Where several do, it is the one with the fewest packages, so never one that means all. ``module``
    may be a submodule. The answer comes from the metadata of ``distribution`` (or its name), which must
    be installed; the package of ``module`` need not be.
    """
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
    """Return the error for ``what`` that needs ``module``: it says how to install it.

    ``what`` begins the sentence, such as "driving by hand". A module that no extra brings is to be
    installed by the name of its package.
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
    """Raise `missing_extra` for the first of ``modules`` that is not there; nothing is imported."""
    for module in modules:
        if find_spec(module) is None:
            raise missing_extra(what, module)
