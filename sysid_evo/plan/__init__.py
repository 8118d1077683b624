"""Work as cells: their inputs, their results in a store, and the executors that compute them."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
