"""What every camera, projector and doser promises, as test suites for a driver of one's own (docs/write_a_driver.md).

Subclass a contract in a test file and give it the fixture `reopen`; pytest does the rest. The only part of tankrig that
needs pytest, and nothing else imports it.
"""

import pytest

# Before they are imported, so that a promise that is broken is shown with its values.
pytest.register_assert_rewrite("tankrig.testing.camera", "tankrig.testing.doser", "tankrig.testing.projector")

from tankrig.testing.camera import CameraContract, ReopenCamera  # noqa: E402
from tankrig.testing.doser import DoserContract, ReopenDoser  # noqa: E402
from tankrig.testing.projector import ProjectorContract, ReopenProjector  # noqa: E402

__all__ = ["CameraContract", "DoserContract", "ProjectorContract", "ReopenCamera", "ReopenDoser", "ReopenProjector"]
