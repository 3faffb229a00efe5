"""Scenes as benches have them: light bent by a glass wall and by the water's surface, cameras with lenses."""

from dataclasses import replace

from tankrig.geometry.pose import Pose, Vector
from tankrig.scene import Beam, Camera, Medium, Projector, Scene, Tank

DISTORTION = (-0.11, 0.03, 8e-4, -5e-4, 0.0)


def calibrated(
    position: Vector,
    target: Vector,
    down: Vector,
    focal: float,
    shape: tuple[int, int],
    distortion: tuple[float, ...] = (),
) -> Camera:
    """A camera at a place that looks at another."""
    rows, columns = shape
    matrix = ((focal, 0.0, 0.5 * columns - 1.2), (0.0, 1.003 * focal, 0.5 * rows + 0.7), (0.0, 0.0, 1.0))
    pose = Pose.looking(position, target, down)
    return Camera(
        "calibrated", shape, position_mm=position, matrix=matrix, distortion=distortion, rotation=pose.rotation
    )


def small(medium: Medium) -> Scene:
    """Asymmetric in everything, in a small tank."""
    return Scene(
        Tank((120.0, 80.0, 60.0), surface="fresnel", refractive_index=1.333, entry="glass", wall_mm=6.0),
        medium,
        Projector(
            "pinhole", (Beam((-12.0, 3.0), (30.0, 40.0), 1.3), Beam((20.0, 24.0), (10.0, 14.0))), (-250.0, 4.0, 20.0)
        ),
        calibrated((80.0, -30.0, 260.0), (60.0, 5.0, 60.0), (0.2, -1.0, 0.0), 60.0, (30, 46), DISTORTION),
    )


def bench(medium: Medium) -> Scene:
    """Three beams behind glass, seen by a tilted camera with barrel distortion that sees beyond the tank too."""
    beams = tuple(Beam((y - 2.0, y + 2.0), (58.0, 62.0)) for y in (-40.0, 0.0, 40.0))
    return Scene(
        Tank(surface="fresnel", refractive_index=1.333, entry="glass", wall_mm=10.0),
        medium,
        Projector("pinhole", beams, (-400.0, 0.0, 60.0)),
        calibrated((140.0, -60.0, 620.0), (118.0, 3.0, 120.0), (0.08, -1.0, 0.0), 252.0, (96, 130), DISTORTION),
    )


def sheet(medium: Medium) -> Scene:
    """One broad oblique beam behind acrylic, and a camera that is upside down and sees a part of the tank."""
    return replace(
        bench(medium),
        tank=Tank(surface="fresnel", refractive_index=1.34, entry="glass", wall_mm=15.0, wall_index=1.49),
        projector=Projector("pinhole", (Beam((-48.0, 60.0), (50.0, 58.0)),), (-330.0, 20.0, 95.0)),
        camera=calibrated((90.0, 50.0, 560.0), (110.0, -10.0, 120.0), (0.1, 1.0, 0.0), 255.0, (80, 100), (0.05, -0.02)),
    )
