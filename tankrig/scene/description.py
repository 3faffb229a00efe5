"""A scene: what is in the tank, what lights it and what looks at it, checked against each other."""

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from tankrig.scene.checks import CLOSED, require
from tankrig.scene.footprint import typical_pixel_mm
from tankrig.scene.optics import wider_than, widest_halo_mm
from tankrig.scene.parts import Beam, Camera, Interval, Matrix, Medium, Projector, Tank, Vector

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_BEAMS_SHOWN = 9
"""In a figure."""

__all__ = ["CLOSED", "Beam", "Camera", "Interval", "Matrix", "Medium", "Projector", "Scene", "Tank", "Vector"]


@dataclass(frozen=True)
class Scene:
    """Everything a model needs to know: tank, medium, projector, camera.

    Raises
    ------
    SceneError
        When a beam leaves the wall x = 0 or a pinhole camera is not above the water.

    Examples
    --------
    >>> scene = Scene(
    ...     tank=Tank(),
    ...     medium=Medium(sigma_a=0.0002, sigma_s=0.0198, g=0.5),
    ...     projector=Projector("collimated", beams=(Beam((-2.0, 2.0), (58.0, 62.0)),)),
    ...     camera=Camera("orthographic", shape=(80, 120), pixel_mm=2.0),
    ... )
    >>> scene.projector.beams[0].power
    16.0
    """

    __pydantic_config__ = CLOSED
    tank: Tank
    medium: Medium
    projector: Projector
    camera: Camera
    source: str = field(default="", repr=False, compare=False)
    """The file the scene came from, for messages."""

    def __post_init__(self) -> None:
        _, width, height = self.tank.size_mm
        for index, beam in enumerate(self.projector.beams):
            for name, (low, high), (bottom, top) in (
                ("y_mm", beam.y_mm, (-width / 2, width / 2)),
                ("z_mm", beam.z_mm, (0.0, height)),
            ):
                require(
                    bottom <= low and high <= top,
                    f"projector.beams[{index}].{name} = [{low}, {high}] leaves the tank, whose wall spans "
                    f"[{bottom:g}, {top:g}] mm; move or cut the beam",
                )
        light, camera = self.projector, self.camera
        widths = _lit_widths_mm(light.beams)
        for name, blur in (("projector", light.blur), ("camera", camera.blur)):
            require(
                not wider_than(blur.widest_mm, widths),
                f"{name}.blur of {blur.widest_mm:g} mm is wider than the beams, {max(widths, default=0.0):g} mm at "
                "most; give its standard deviation in mm, or wide light as a halo",
            )
        widest_mm = widest_halo_mm(self.tank.size_mm)
        for name, halo, instead in (
            ("projector", light.halo, "projector.black_level"), ("camera", camera.halo, "camera.veil")
        ):  # fmt: skip
            require(
                halo.share == 0.0 or halo.sigma_mm <= widest_mm,
                f"{name}.halo.sigma_mm = {halo.sigma_mm:g} is above {widest_mm:g} mm, far wider than the tank; give "
                f"its standard deviation in mm, or light that is even everywhere as {instead}",
            )
        require(
            light.wide_lens.focus_mm <= self.tank.size_mm[0],
            f"projector.wide_lens.focus_mm = {light.wide_lens.focus_mm:g} is behind the tank, which is "
            f"{self.tank.size_mm[0]:g} mm long; give the x where pictures are sharp",
        )
        require(len(light.beams) > 0, "projector.beams = [] lights nothing; give a beam or a picture")
        if light.kind != "collimated" and light.position_mm is not None:
            wall = self.tank.entry_bends[1]
            require(
                light.position_mm[0] < -wall,
                f"projector.position_mm = {list(light.position_mm)} is inside the wall, which is {wall:g} mm thick; "
                f"give x < {-wall:g}",
            )
        if camera.kind != "orthographic" and camera.position_mm is not None:
            require(
                camera.position_mm[2] > height,
                f"camera.position_mm = {list(camera.position_mm)} is not above the water, z = {height:g} mm; raise it",
            )
        if camera.kind == "calibrated":
            object.__setattr__(self, "camera", replace(camera, pixel_mm=typical_pixel_mm(camera, self.tank)))

    def plot(self) -> "Figure":
        """The wall x = 0 that the light enters through, and the beams on it; a figure of matplotlib."""
        from tankrig.notebook import rectangles

        _, width, height = self.tank.size_mm
        wall = {"wall x = 0": ((-width / 2, width / 2), (0.0, height))}
        beams = {
            f"beam {number}, {beam.irradiance:.3g} W/mm²": (beam.y_mm, beam.z_mm)
            for number, beam in enumerate(self.projector.beams[:_BEAMS_SHOWN], 1)
        }
        return rectangles(wall | beams, "y", "z")

    def _repr_html_(self) -> str:
        """For notebooks: tank, liquid, light and camera, and the figure."""
        from tankrig.notebook import page

        size, (rows, columns) = " × ".join(f"{side:g}" for side in self.tank.size_mm), self.camera.shape
        said = [
            ("tank", f"{size} mm, surface {self.tank.surface}"),
            ("medium", f"σa {self.medium.sigma_a:.4g}/mm, σs {self.medium.sigma_s:.4g}/mm, g {self.medium.g:.3g}"),
            ("projector", f"{self.projector.kind}, {len(self.projector.beams)} beams"),
            ("camera", f"{self.camera.kind}, {rows} × {columns} pixels of {self.camera.pixel_mm:.3g} mm"),
        ]
        return page("scene", [*said, *([("from", self.source)] if self.source else [])], self.plot())


def _lit_widths_mm(beams: tuple[Beam, ...]) -> list[float]:
    """Widths along y of what is lit, beams that touch counted as one."""
    widths, edge, start = [], float("-inf"), 0.0
    for low, high in sorted(beam.y_mm for beam in beams if beam.irradiance > 0.0):
        if low > edge + 1e-9:
            widths.append(edge - start)
            start = low
        edge = max(edge, high)
    return [*widths[1:], edge - start] if widths else []
