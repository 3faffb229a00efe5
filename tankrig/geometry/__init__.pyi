from .lens import Lens as Lens
from .pose import Pose as Pose
