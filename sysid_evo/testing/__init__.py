"""The contract of each kind of plugin as a table of sentences and checks, which plugin authors run, and CI runs.

``check_KIND(name)`` raises `ContractViolation` listing every broken sentence; ``KIND.run(name)``, such as `MODEL.run`,
yields each sentence with its verdict. `hardware.testing` has the contract of robots, and those of all kinds by name.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
