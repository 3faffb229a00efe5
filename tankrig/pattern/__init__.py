"""Patterns: what a projector shows, and which beams it lights with them."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
