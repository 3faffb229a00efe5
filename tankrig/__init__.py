"""tankrig: predict and estimate how light scatters in a tank, and run the rig that measures it.

Names are loaded on first use, so that `import tankrig` costs little.
"""

from typing import Any

import lazy_loader

_face, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

GOING: dict[str, str] = {}
"""Names of an earlier release that go with the next one, and what stands in their place."""


def __getattr__(name: str) -> Any:
    """A public name; one that goes works for one release more, with a warning."""
    if name not in GOING:
        return _face(name)
    import warnings

    warnings.warn(
        f"tankrig.{name} goes with the next release; use tankrig.{GOING[name]}", DeprecationWarning, stacklevel=2
    )
    return _face(GOING[name])
