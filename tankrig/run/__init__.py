"""Running an experiment: the runner, and the store that keeps what it saw."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
