"""Every device, real and simulated, and the emulators that stand in for real ones in tests."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
