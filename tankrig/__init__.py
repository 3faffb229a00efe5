"""tankrig: predict and estimate how light scatters in a tank, and run the rig that measures it.

Names are loaded on first use, so that `import tankrig` costs little.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
