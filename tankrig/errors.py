"""The errors tankrig raises on purpose.

Each message is one sentence that names the file or device, what was tried, and what to do about it, so that a
command line or a window can show it as it stands.
"""


class TankrigError(Exception):
    """Base of every error that tankrig raises on purpose."""


class SceneError(TankrigError, ValueError):
    """A scene that cannot exist, or that no model supports yet."""


class CalibrationError(TankrigError, ValueError):
    """Measurements of which no calibration can be made."""


class ImageError(TankrigError, ValueError):
    """An image that cannot be read, or that cannot be an observation of the scene."""


class SequenceError(TankrigError, ValueError):
    """A sequence that cannot be carried out as written."""


class DeviceError(TankrigError, RuntimeError):
    """A device that did not do, or cannot be shown to have done, what it was asked."""


class SettingsError(DeviceError):
    """A device whose settings in the rig file are wrong: nothing has failed, and the file is to be mended (exit 2)."""


class UndecidedError(DeviceError):
    """A doser of which only a person can say what it has delivered; nothing moves until then (exit code 3)."""


class DecisionError(TankrigError):
    """What only a person can decide, and has to before anything is made or moves (exit code 3)."""


class StoreError(TankrigError, OSError):
    """A run folder that cannot be written, or that is not what it should be."""


class MissingExtraError(TankrigError, ImportError):
    """Something needs packages that are installed with one of tankrig's extras, and they are not (exit code 1)."""


class CacheError(TankrigError, OSError):
    """A prepared model that cannot be stored or read back."""
