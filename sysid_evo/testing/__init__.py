"""Conformance kits: the contract of each kind of thing as sentences that plugin authors run, and CI runs.

``check_KIND(name)`` raises `ContractViolation` listing every broken sentence; ``run_KIND_checks(name)``
yields each sentence with its verdict (for models it is called `run_checks`). `KITS` has them by kind. The kit of
robots stands beside what it checks: `hardware.testing`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
