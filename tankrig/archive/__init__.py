"""An archive of runs: listed, compared, opened as one dataset, fitted anew, and made of other people's frames."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
