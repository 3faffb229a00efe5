"""What is in the tank, what lights it and what looks at it: frozen, checked, in mm and W."""

import math
from dataclasses import dataclass, replace
from typing import Annotated, Literal

from tankrig.checked_toml import MOST
from tankrig.errors import SceneError
from tankrig.geometry.lens import Lens
from tankrig.geometry.pose import Pose
from tankrig.geometry.shading import TERMS
from tankrig.ranges import Within
from tankrig.scene.checks import CLOSED, between, finite, in_ranges, number, numbers, picture_shape, require
from tankrig.scene.optics import ALL_BLACK, MOST_VEIL, NO_HALO, PINHOLE, SHARP, Blur, Faces, Halo, WideLens
from tankrig.scene.phase_functions import AnyPhase, HenyeyGreenstein
from tankrig.scene.phase_table import PhaseFunction

Vector = tuple[float, float, float]
Interval = tuple[float, float]
Matrix = tuple[Vector, Vector, Vector]

LEAST_SIDE_MM, MOST_MM = 0.01, 1e6
"""Of a tank, and of any length there."""
LEAST_PIXEL_MM = 1e-6
"""Less than any wavelength of light."""
MOST_PER_MM = 1e6
"""Of a coefficient: a free path of a nanometre."""

Side = Annotated[
    Vector,
    Within(
        LEAST_SIDE_MM,
        MOST_MM,
        f"has a side that is not positive, or below {LEAST_SIDE_MM:g}; give lengths in mm",
        beyond=f"has a side above {MOST_MM:g} mm; mend it",
    ),
]
"""Of a box, mm."""
PerMm = Annotated[
    float,
    Within(
        0.0,
        MOST_PER_MM,
        "is negative; give a coefficient in 1/mm that is zero or more",
        beyond=f"is above {MOST_PER_MM:g} per mm, as no liquid is; mend it",
    ),
]
Thickness = Annotated[
    float,
    Within(0.0, MOST_MM, "is negative; give the wall's thickness in mm", beyond="is thicker than any wall; mend it"),
]
Irradiance = Annotated[
    float, Within(0.0, MOST, "is negative; give W/mm², zero or more", beyond="is brighter than any light; mend it")
]
BlurWidth = Annotated[
    float,
    Within(
        0.0,
        MOST_MM,
        "is negative; give the standard deviation in mm, or leave it out",
        beyond="is wider than any tank; mend it",
    ),
]
Measured = Annotated[
    float, Within(0.0, MOST, "is not positive; measure it", above=True, beyond="is more than any has; measure it")
]


@dataclass(frozen=True)
class Tank:
    """A box of water: x ∈ [0, Lx], y ∈ [−Ly/2, Ly/2], z ∈ [0, Lz]; light enters at x = 0, the surface is z = Lz.

    Parameters
    ----------
    size_mm
        (Lx, Ly, Lz).
    surface
        "matched": nothing happens at z = Lz. "fresnel": water below, air above. The other faces are black and matched.
    refractive_index
        Of the water; read when the surface is "fresnel" or the entry "glass".
    entry
        "matched": nothing happens to light at x = 0. "glass": air outside, then a wall, and light is bent into the
        water.
    wall_mm, wall_index
        Thickness of the wall that the light enters through, its inside at x = 0, and its refractive index; read when
        the entry is "glass".
    faces
        What comes back from the walls and the floor, see `tankrig.scene.optics.Face`: nothing, unless they say so.
    """

    __pydantic_config__ = CLOSED
    size_mm: Side = (240.0, 160.0, 120.0)
    surface: Literal["matched", "fresnel"] = "matched"
    refractive_index: Annotated[float, Within(1.0, 3.0, "is outside 1…3; water has 1.33")] = 1.33
    entry: Literal["matched", "glass"] = "matched"
    wall_mm: Thickness = 0.0
    wall_index: Annotated[float, Within(1.0, 3.0, "is outside 1…3; glass has 1.52, acrylic 1.49")] = 1.52
    faces: Faces = ALL_BLACK

    def __post_init__(self) -> None:
        numbers(self, "size_mm", 3)
        in_ranges(self)
        require(
            self.surface in ("matched", "fresnel"), f'surface = "{self.surface}" is unknown; use "matched" or "fresnel"'
        )
        require(self.entry in ("matched", "glass"), f'entry = "{self.entry}" is unknown; use "matched" or "glass"')

    @property
    def surface_index(self) -> float:
        """Refractive index that the surface shows: 1 when matched."""
        return self.refractive_index if self.surface == "fresnel" else 1.0

    @property
    def entry_bends(self) -> tuple[float, float, float]:
        """What bends the light at x = 0: index of the water, thickness in mm of the wall and its index."""
        return (self.refractive_index, self.wall_mm, self.wall_index) if self.entry == "glass" else (1.0, 0.0, 1.0)


_LEFT_OUT = math.nan
"""A g that was not given; told by its identity."""


@dataclass(frozen=True)
class Medium:
    """Absorption and scattering coefficients in 1/mm, and how one scattering turns light.

    Parameters
    ----------
    sigma_a, sigma_s
        In 1/mm.
    g
        Mean cosine of one scattering: of a Henyey–Greenstein phase function, where no other is given.
    phase
        Another phase function; g is its mean cosine then, and need not be given.

    Examples
    --------
    >>> milk = Medium(sigma_a=0.0002, sigma_s=0.0198, g=0.5)
    >>> round(milk.sigma_t, 6), round(milk.albedo, 6)
    (0.02, 0.99)
    >>> from tankrig.scene.phase_functions import TwoTerm
    >>> round(Medium(0.0, 0.01, phase=TwoTerm(0.9, -0.4, 0.9)).g, 4)
    0.77
    """

    __pydantic_config__ = CLOSED
    sigma_a: PerMm
    sigma_s: PerMm
    g: Annotated[
        float,
        Within(-1.0, 1.0, "is outside −1 < g < 1; give the mean cosine of one scattering", above=True, below=True),
    ] = _LEFT_OUT
    phase: AnyPhase | None = None

    def __post_init__(self) -> None:
        if self.phase is not None:
            self._take_mean_cosine(self.phase)
        require(self.g is not _LEFT_OUT, "g is missing; give the mean cosine of one scattering, or a phase")
        in_ranges(self)

    def _take_mean_cosine(self, phase: PhaseFunction) -> None:
        mean = phase.mean_cosine
        require(
            self.g is _LEFT_OUT or abs(self.g - mean) < 1e-9,
            f"g = {self.g} is not the mean cosine of the phase, {mean:.6g}; leave one of them out",
        )
        henyey_greenstein = isinstance(phase, HenyeyGreenstein)
        object.__setattr__(self, "g", mean)
        object.__setattr__(self, "phase", None if henyey_greenstein else phase)

    def __repr__(self) -> str:
        phase = "" if self.phase is None else f", phase={self.phase!r}"
        return f"Medium(sigma_a={self.sigma_a!r}, sigma_s={self.sigma_s!r}, g={self.g!r}{phase})"

    @property
    def coefficients(self) -> tuple[float, float, float]:
        """σa, σs and g."""
        return self.sigma_a, self.sigma_s, self.g

    @property
    def phase_function(self) -> PhaseFunction:
        """`phase`, or Henyey–Greenstein with g."""
        return self.phase or HenyeyGreenstein(self.g)

    @property
    def sigma_t(self) -> float:
        """Extinction σt = σa + σs in 1/mm."""
        return self.sigma_a + self.sigma_s

    @property
    def albedo(self) -> float:
        """Single-scattering albedo ϖ = σs/σt; 0 for clear water."""
        return self.sigma_s / self.sigma_t if self.sigma_t > 0.0 else 0.0


@dataclass(frozen=True)
class Beam:
    """A rectangle of the plane x = 0 that the projector lights.

    Parameters
    ----------
    y_mm, z_mm
        (low, high) edges in mm.
    irradiance
        Flux per area of the plane x = 0, W/mm² (the cosine is included).
    """

    __pydantic_config__ = CLOSED
    y_mm: Interval
    z_mm: Interval
    irradiance: Irradiance = 1.0

    def __post_init__(self) -> None:
        for name in ("y_mm", "z_mm"):
            low, high = numbers(self, name, 2)
            require(low < high, f"{name} = [{low}, {high}] has no width; give [low, high] with low < high")
        in_ranges(self)

    @property
    def power(self) -> float:
        """Flux through the rectangle, W."""
        return self.irradiance * (self.y_mm[1] - self.y_mm[0]) * (self.z_mm[1] - self.z_mm[0])


def _calibration(owner: "Projector | Camera") -> tuple[Lens, Pose]:
    """Lens and pose of a calibrated device, its fields made numbers in place."""
    for name in ("matrix", "rotation", "position_mm"):
        require(
            getattr(owner, name) is not None,
            f"{name} is missing; a calibrated device needs matrix, rotation, position_mm",
        )
    matrix = tuple(tuple(finite("matrix", value) for value in row) for row in owner.matrix or ())
    object.__setattr__(owner, "matrix", matrix)
    distortion = numbers(owner, "distortion", len(owner.distortion))
    rotation, position = numbers(owner, "rotation", 3), numbers(owner, "position_mm", 3)
    try:
        lens = Lens.of(matrix, distortion)
    except ValueError as error:
        raise SceneError(str(error)) from error
    require(min(lens.fx, lens.fy) > 0.0, f"matrix = {matrix} has a focal length that is not positive; give pixels")
    return lens, Pose.at(position, (rotation[0], rotation[1], rotation[2]))


def _shape(owner: "Projector | Camera") -> None:
    shape = tuple(owner.shape or ())
    object.__setattr__(owner, "shape", shape)
    picture_shape(shape)


@dataclass(frozen=True)
class Projector:
    """What lights the tank through x = 0.

    Parameters
    ----------
    kind
        "collimated": along +x. "pinhole": rays from `position_mm`. "calibrated": the same, and which of its pixels
        shines which way is known.
    beams
        Rectangles of the plane x = 0; where they overlap they add. None is needed where pictures give them.
    position_mm
        Of the pinhole, outside the tank and its wall (x < 0); ignored when collimated.
    matrix, distortion, rotation
        Of a calibrated projector: camera matrix in pixels, up to five distortion coefficients, and the rotation vector
        from the world to its frame, all as OpenCV has them (`tankrig.geometry`). Beams alone don't need them; pictures
        do (`tankrig.scene.projection`).
    shape
        (rows, columns) of the pictures that it shows.
    pixel_power
        W that leave a white pixel of a calibrated projector.
    gamma
        A pixel at level v of 255 has (v/255)^gamma of it.
    shading
        How its light falls off over the picture: coefficients of `tankrig.geometry.shading`; empty for even light.
    blur_mm
        Standard deviation of what its lens makes of a point, on the wall x = 0: a Gaussian, alike along y and z. 0 is
        sharp; None where nobody has measured it. No model blurs by it: it says where beams' sides are not to be
        trusted (`tankrig.scene.outline`).
    blur, halo, wide_lens
        What its lens does to the light that enters, see `tankrig.scene.optics`: models have it in their images.
    black_level
        Irradiance of a dark picture, W/mm² as a beam's, all over the wall x = 0.
    """

    __pydantic_config__ = CLOSED
    kind: Literal["collimated", "pinhole", "calibrated"]
    beams: tuple[Beam, ...] = ()
    position_mm: Vector | None = None
    matrix: Matrix | None = None
    distortion: tuple[float, ...] = ()
    rotation: Vector | None = None
    shape: tuple[int, int] | None = None
    pixel_power: Measured = 1.0
    gamma: Measured = 1.0
    shading: tuple[float, ...] = ()
    blur_mm: BlurWidth | None = None
    blur: Blur = SHARP
    halo: Halo = NO_HALO
    wide_lens: WideLens = PINHOLE
    black_level: Irradiance = 0.0

    def __post_init__(self) -> None:
        require(
            self.kind in ("collimated", "pinhole", "calibrated"),
            f'kind = "{self.kind}" is unknown; use "collimated", "pinhole" or "calibrated"',
        )
        object.__setattr__(self, "beams", tuple(self.beams))
        require(len(self.beams) > 0 or self.matrix is not None, "beams = [] lights nothing; give at least one beam")
        if self.kind != "collimated":
            require(
                self.position_mm is not None,
                f"position_mm is missing; a {self.kind} projector needs [x, y, z] with x < 0",
            )
            position = numbers(self, "position_mm", 3)
            require(
                position[0] < 0.0,
                f"position_mm = {list(position)} is not outside the wall x = 0; give x < 0",
            )
            require(
                self.wide_lens.diameter_mm <= -position[0],
                f"wide_lens.diameter_mm = {self.wide_lens.diameter_mm:g} is wider than the lens is far from the wall "
                f"x = 0, {-position[0]:g} mm, as no projector's is; give the lens's width in mm",
            )
        in_ranges(self)
        if self.shading:
            object.__setattr__(self, "shading", numbers(self, "shading", TERMS))
        require(
            self.blur.corner_mm is None,
            f"blur.corner_mm = {self.blur.corner_mm} is for cameras; a projector's blur is one number, sigma_mm",
        )
        if self.kind == "calibrated" and self.matrix is not None:
            _calibration(self)
            _shape(self)

    @property
    def lens(self) -> Lens:
        """Of a calibrated projector."""
        return _calibration(self)[0]

    @property
    def pose(self) -> Pose:
        """Of a calibrated projector."""
        return _calibration(self)[1]


@dataclass(frozen=True)
class Camera:
    """What looks down on the tank.

    A plain camera is a grid of square pixels on the plane z = Lz that starts at x = 0, y = −Ly/2. The pixels of a
    calibrated one look wherever its lens and pose say; each then is a quadrangle of that plane.

    Parameters
    ----------
    kind
        "orthographic": looks along −z. "pinhole": looks from `position_mm`. "calibrated": the same, through a lens.
    shape
        (rows, columns); along y and x for a plain camera.
    pixel_mm
        Side of a pixel on the plane z = Lz. Of a calibrated camera it need not be given: its scene puts in the typical
        side of those that look into the tank.
    position_mm
        Of the pinhole, above the water; ignored when orthographic.
    matrix, distortion, rotation
        Of a calibrated camera: camera matrix in pixels, up to five distortion coefficients, and the rotation vector
        from the world to its frame, all as OpenCV has them (`tankrig.geometry`).
    blur_mm
        Standard deviation of what its lens makes of a point, on the plane z = Lz, where `pixel_mm` is: a Gaussian,
        alike along x and y. 0 is sharp; None where nobody has measured it. See `Projector`.
    blur, halo
        What its lens does to the picture, see `tankrig.scene.optics`: models have it in their images.
    veil
        Share of the picture's light that is spread evenly over the whole picture.
    bin
        Pixels along the side of a block that is to be one pixel, see `binned`: `tankrig.load_scene` gives a camera of
        such pixels, and live fits take them in place of those that they would choose. 0 where left to them.
    """

    __pydantic_config__ = CLOSED
    kind: Literal["orthographic", "pinhole", "calibrated"]
    shape: tuple[int, int]
    pixel_mm: float = 0.0
    position_mm: Vector | None = None
    matrix: Matrix | None = None
    distortion: tuple[float, ...] = ()
    rotation: Vector | None = None
    blur_mm: BlurWidth | None = None
    bin: int = 0
    blur: Blur = SHARP
    halo: Halo = NO_HALO
    veil: Annotated[
        float,
        Within(
            0.0,
            MOST_VEIL,
            f"is outside 0 … {MOST_VEIL:g}; give the share of the picture's light that is spread evenly (0.02 is 2 %)",
        ),
    ] = 0.0

    def __post_init__(self) -> None:
        require(
            self.kind in ("orthographic", "pinhole", "calibrated"),
            f'kind = "{self.kind}" is unknown; use "orthographic", "pinhole" or "calibrated"',
        )
        _shape(self)
        require(
            number(self, "pixel_mm") > 0.0 or self.kind == "calibrated",
            f"pixel_mm = {self.pixel_mm} is not positive; give the side of a pixel in mm",
        )
        if self.kind != "calibrated":
            between(self, "pixel_mm", LEAST_PIXEL_MM, MOST_MM, "mm")
        if self.kind == "pinhole":
            require(
                self.position_mm is not None, "position_mm is missing; a pinhole camera needs [x, y, z] above the water"
            )
            numbers(self, "position_mm", 3)
        if self.kind == "calibrated":
            _calibration(self)
        in_ranges(self)
        require(
            0 <= self.bin <= min(self.shape),
            f"bin = {self.bin} is no number of pixels of a picture of {list(self.shape)}; give 1 to {min(self.shape)}",
        )

    @property
    def lens(self) -> Lens:
        """Of a calibrated camera."""
        return _calibration(self)[0]

    @property
    def pose(self) -> Pose:
        """Of a calibrated camera."""
        return _calibration(self)[1]

    @property
    def sides_mm(self) -> tuple[float, float]:
        """Of a pixel on the plane z = Lz, along its rows' and its columns' numbers; about, where calibrated."""
        if self.kind != "calibrated" or self.matrix is None:
            return self.pixel_mm, self.pixel_mm
        taller = math.sqrt(self.matrix[0][0] / self.matrix[1][1])
        return self.pixel_mm * taller, self.pixel_mm / taller

    def binned(self, by: int, along: int | None = None) -> "Camera":
        """The camera whose pixels are means of this one's; what is left over at the ends is dropped.

        Parameters
        ----------
        by
            Rows that become one.
        along
            Columns that do; as many where None. Other than rows only for a calibrated camera: the pixels of the others
            are square.

        Examples
        --------
        >>> Camera("orthographic", (81, 120), 2.0).binned(4).shape
        (20, 30)
        """
        along = along or by
        matrix = self.matrix
        if matrix is not None:
            (fx, _, cx), (_, fy, cy), last = matrix
            matrix = ((fx / along, 0.0, (cx + 0.5) / along - 0.5), (0.0, fy / by, (cy + 0.5) / by - 0.5), last)
        require(by == along or self.kind == "calibrated", "only a calibrated camera's pixels need not be square")
        shape = (self.shape[0] // by, self.shape[1] // along)
        return replace(self, shape=shape, pixel_mm=self.pixel_mm * math.sqrt(by * along), matrix=matrix, bin=0)
