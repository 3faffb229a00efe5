"""What every worker needs, imported and compiled once: workers are forked from a process that has imported this.

So a worker that was killed is replaced in a fraction of a second instead of some. Nothing here starts a thread.
"""

from tankrig.archive import task as task
from tankrig.archive.mark import refit_mark
from tankrig.light.single import single_scattering
from tankrig.scene.description import Beam, Camera, Medium, Projector, Scene, Tank

refit_mark()
single_scattering(
    Scene(
        Tank(), Medium(0.001, 0.01, 0.5), Projector("collimated", (Beam((-2.0, 2.0), (58.0, 62.0)),)),
        Camera("orthographic", (2, 3), 60.0),
    )
)  # fmt: skip
