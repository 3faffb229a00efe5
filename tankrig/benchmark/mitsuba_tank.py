"""The same tank as a scene of Mitsuba 3, a general renderer: its path tracer for media (`volpath`) follows light back
from the camera and at every scattering asks for the projector's light.

Mitsuba is an extra (`pip install tankrig[mitsuba]`). Its vectorised variant needs an LLVM library of its own (≥ 19 on
recent processors), whose path DRJIT_LIBLLVM_PATH names; without that the scalar variant is used.
"""

import math
import os
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tankrig.errors import SceneError
from tankrig.exchange.even_cosines import even_cosines
from tankrig.scene import Scene
from tankrig.scene.phase_functions import HenyeyGreenstein
from tankrig.scene.phase_table import PhaseFunction

Array = NDArray[np.float64]

TEXELS_PER_MM = 2.0
MOST_TEXELS = 4096
FAR_MM = 2e5
"""Distance of the projector that stands for collimated light: over a tank of 240 mm its beams widen by 0.1 %."""


def mitsuba_image(scene: Scene, samples: int, seed: int = 0) -> Array:
    """Image by Mitsuba's `volpath`.

    Parameters
    ----------
    scene
        A camera whose pixels lie inside the tank; a pinhole one must be above the middle of its image.
    samples
        Paths per pixel.
    seed
        Of the random numbers.

    Returns
    -------
    (rows, columns) array, W/mm²/sr

    Raises
    ------
    SceneError
        When Mitsuba isn't installed, or the scene cannot be put in its terms.
    """
    try:
        import mitsuba
    except ImportError as error:
        raise SceneError("Mitsuba 3 is not installed; pip install tankrig[mitsuba]") from error
    mitsuba.set_variant("llvm_ad_rgb" if "DRJIT_LIBLLVM_PATH" in os.environ else "scalar_rgb")
    image = mitsuba.render(mitsuba.load_dict(described(mitsuba, scene, samples)), seed=seed)
    return np.asarray(image, np.float64)[::-1, :, 0]  # its first row is the top one


def described(mitsuba: Any, scene: Scene, samples: int) -> dict[str, Any]:
    """The scene as a dictionary of Mitsuba's, its liquid named "water"."""
    return {
        "type": "scene",
        "integrator": {"type": "volpath", "max_depth": -1},
        "sensor": _camera(mitsuba, scene, samples),
        "emitter": _projector(mitsuba, scene),
        **_faces(mitsuba, scene),
    }


def _phase(phase: PhaseFunction) -> dict[str, Any]:
    if isinstance(phase, HenyeyGreenstein):
        return {"type": "hg", "g": phase.g}
    return {"type": "tabphase", "values": ", ".join(f"{value:.6g}" for value in even_cosines(phase)[1])}


def _faces(mitsuba: Any, scene: Scene) -> dict[str, Any]:
    """Six rectangles that look outwards, of nothing but the water's surface where that is Fresnel's."""
    length, width, height = scene.tank.size_mm
    medium = {
        "type": "homogeneous",
        "sigma_t": scene.medium.sigma_t,
        "albedo": scene.medium.albedo,
        "phase": _phase(scene.medium.phase_function),
    }
    middle = np.array([0.5 * length, 0.0, 0.5 * height])
    half = np.array([0.5 * length, 0.5 * width, 0.5 * height])
    faces: dict[str, Any] = {"water": medium}
    for axis, sign in ((axis, sign) for axis in range(3) for sign in (-1.0, 1.0)):
        across, up, out = np.eye(3)[(axis + 1) % 3], np.eye(3)[(axis + 2) % 3], np.eye(3)[axis]
        if sign < 0.0:
            across, up = up, across
        matrix = np.eye(4)
        matrix[:3, :3] = np.column_stack([across * half, up * half, sign * out])
        matrix[:3, 3] = middle + sign * out * half
        surface = axis == 2 and sign > 0.0 and scene.tank.surface_index != 1.0
        index = scene.tank.surface_index
        faces[f"face{axis}{'n' if sign < 0.0 else 'p'}"] = {
            "type": "rectangle",
            "to_world": mitsuba.ScalarTransform4f(matrix),
            "bsdf": {"type": "dielectric", "int_ior": index, "ext_ior": 1.0} if surface else {"type": "null"},
            "interior": {"type": "ref", "id": "water"},
        }
    return faces


def _projector(mitsuba: Any, scene: Scene) -> dict[str, Any]:
    """A projector whose picture, fitted round the beams, lies on the plane x = 0.

    Mitsuba's `projector` gives its texture times π / z² at distance z.
    """
    light = scene.projector
    y_mm = [edge for beam in light.beams for edge in beam.y_mm]
    z_mm = [edge for beam in light.beams for edge in beam.z_mm]
    middle = np.array([0.0, 0.5 * (min(y_mm) + max(y_mm)), 0.5 * (min(z_mm) + max(z_mm))])
    apex = np.array(light.position_mm) if light.kind == "pinhole" else middle - np.array([FAR_MM, 0.0, 0.0])
    aim = np.array([0.0, apex[1], apex[2]])
    reach = max(abs(np.array(y_mm) - aim[1]).max(), abs(np.array(z_mm) - aim[2]).max())  # of a square about its axis
    texels = 2 * math.ceil(min(TEXELS_PER_MM * reach, MOST_TEXELS / 2))
    picture = np.zeros((texels, texels))
    edges = np.linspace(-reach, reach, texels + 1)
    for beam in light.beams:
        rows = _covered(edges, aim[2] - beam.z_mm[1], aim[2] - beam.z_mm[0])  # pictures begin at the top
        columns = _covered(edges, aim[1] - beam.y_mm[1], aim[1] - beam.y_mm[0])  # with y, seen along +x, on the left
        picture += beam.irradiance * np.outer(rows, columns)
    return {
        "type": "projector",
        "to_world": mitsuba.ScalarTransform4f().look_at(origin=apex.tolist(), target=aim.tolist(), up=[0, 0, 1]),
        "fov": 2.0 * math.degrees(math.atan2(reach, -apex[0])),
        "irradiance": {
            "type": "bitmap",
            "bitmap": mitsuba.Bitmap(picture.astype(np.float32)),
            "raw": True,
            "filter_type": "nearest",
        },
        "scale": float(apex[0] ** 2 / math.pi),
    }


def _covered(edges: Array, low: float, high: float) -> Array:
    """Share of each cell that lies between `low` and `high`."""
    inside = np.clip(edges, low, high)
    return np.asarray(np.diff(inside) / np.diff(edges))


def _camera(mitsuba: Any, scene: Scene, samples: int) -> dict[str, Any]:
    camera, (_, width, height) = scene.camera, scene.tank.size_mm
    rows, columns = camera.shape
    half_x, half_y = 0.5 * columns * camera.pixel_mm, 0.5 * rows * camera.pixel_mm
    middle = np.array([half_x, half_y - 0.5 * width, height])
    turned = mitsuba.ScalarTransform4f
    film = {
        "type": "hdrfilm",
        "width": columns,
        "height": rows,
        "rfilter": {"type": "box"},
        "pixel_format": "luminance",
        "component_format": "float32",
    }
    common = {"film": film, "sampler": {"type": "independent", "sample_count": samples}}
    if camera.kind == "orthographic":
        above = middle + np.array([0.0, 0.0, height])
        look = turned().look_at(origin=above.tolist(), target=middle.tolist(), up=[0, 1, 0])
        return {"type": "orthographic", "to_world": look @ turned().scale([half_x, half_x, 1.0]), **common}
    place = np.array(camera.position_mm)
    if abs(place[:2] - middle[:2]).max() > 1e-6:
        raise SceneError("the Mitsuba scene has its pinhole camera above the middle of its image; leave mitsuba out")
    look = turned().look_at(origin=place.tolist(), target=middle.tolist(), up=[0, 1, 0])
    fov = 2.0 * math.degrees(math.atan2(half_x, place[2] - height))
    return {"type": "perspective", "fov": fov, "fov_axis": "x", "to_world": look, **common}
