"""What steps; a model family needs scikit-learn, which takes long to import, an emulated robot does not."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
