"""Models and other dynamics; families need scikit-learn, which takes long to import, emulated robots do not."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
