"""Where light goes: lenses, poses, and flat surfaces that bend it. Numbers and arrays only, in mm."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
