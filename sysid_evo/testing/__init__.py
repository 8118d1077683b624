"""Contract tests for plugin authors: a table of rules and checks for each kind of plugin.

``check_KIND(name)`` raises `ContractViolation` with all broken rules; ``KIND.run(name)``, such as `MODEL.run`, yields
the result of each check. `hardware.testing` has the contract of robots, and the contracts of all kinds by name.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
