"""Model families, one module or folder each; `linear` is the shortest example.

The registry of models finds a family by the name in its decorator and in the entry points of pyproject.toml. The carry
with lags, `fit`, `simulate` and `score` are inherited from `sysid_evo.models`. No module imports from a later line:

- ``features``, ``scaling``, ``control_grid``: inputs, scales and control levels that families share;
- ``linear``, ``backprop27``, ``evolved3``, ``gaussian_process``, ``neighbours``, ``networks``, ``polynomial``,
  ``state_space``;
- ``grey_box``: physics with unknown parameters;
- ``car``: the physics of a car, as a grey box, with a network, or set by evolution;
- ``auto`` and ``average``: means of other families, which they find by name.

Base classes for families of your own are imported from here.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
