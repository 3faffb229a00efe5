from .reading import Run as Run
from .reading import open_run as open_run
from .recovery import Recovery as Recovery
from .rig import Rig as Rig
from .runner import Outcome as Outcome
from .runner import Runner as Runner
from .start import new_run as new_run
from .start import resumed_run as resumed_run
