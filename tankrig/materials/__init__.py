"""Reference liquids: what is published of them, how much to dose, and whether a run agrees."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
