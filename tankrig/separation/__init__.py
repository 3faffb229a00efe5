"""Light that was scattered once told from the rest, by waves of light and without a model of the liquid."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
