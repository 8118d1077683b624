"""Robots: sessions and the loop that drives them, links, trackers, recording, emulated and simulated robots.

The process of a tracker starts from inside this package, so nothing is imported here before it is used.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
