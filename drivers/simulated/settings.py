"""What a rig file says about the simulated projector, the simulated camera, and the tank between them."""

from pathlib import Path
from typing import Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from tankrig.bench import Bench
from tankrig.calibration.board import Board
from tankrig.pattern.wall import Wall
from tankrig.scene.description import Camera, Medium, Tank

from .bench_truth import TANK_MM

_CLOSED = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

TRUE_BENCH = Bench(
    tank=Tank(size_mm=(240.0, 160.0, 120.0)),
    wall=Wall(shape=(480, 640), y_mm=(-80.0, 80.0), z_mm=(0.0, 120.0)),
    light="collimated",
    camera=Camera("orthographic", shape=(80, 120), pixel_mm=2.0),
    polarisation=0.0,
)
"""Where a rig file says nothing else."""
PURE_WATER = Medium(sigma_a=5.65e-5, sigma_s=1.9e-6, g=0.0)
"""At 550 nm (Pope and Fry 1997; Morel 1974)."""
MILK = Medium(sigma_a=0.0046 / 4608.0, sigma_s=20.4 / 4608.0, g=0.71)
"""Regular milk in green light (Narasimhan et al. 2006), per ml in a tank of 4608 ml."""


class ProjectorFaults(BaseModel):
    """What goes wrong with the projector; numbers count its flips from 0.

    Parameters
    ----------
    late, late_ms
        Chance that a flip is late, and by how much.
    stuck_from, unplugged_from
        The flip from which on the output never swaps again, or is gone.
    unsteady_ms
        Standard deviation of the swap interval, which is measured on opening.
    """

    model_config = _CLOSED

    late: float = Field(default=0.0, ge=0.0, le=1.0)
    late_ms: float = Field(default=100.0, ge=0.0)
    stuck_from: int | None = None
    unplugged_from: int | None = None
    unsteady_ms: float = Field(default=0.0, ge=0.0)


class SimulatedProjectorSettings(BaseModel):
    """The `[projector]` table of a rig file for the simulated projector.

    Parameters
    ----------
    folder
        Of the simulated tank, the same for all three devices.
    shape
        (rows, columns).
    period_ms
        From swap to swap.
    latency_ms
        (least, most) time from swap to light.
    timeout_s
        How long to wait for a swap.
    faults, seed
        What goes wrong, and the seed of it and of the latency.
    time_scale
        All times are multiplied by this (demo, tests).
    """

    model_config = _CLOSED

    folder: Path
    shape: tuple[int, int] = TRUE_BENCH.wall.shape
    period_ms: float = Field(default=1000.0 / 60.0, gt=0.0)
    latency_ms: tuple[float, float] = (20.0, 35.0)
    timeout_s: float = Field(default=1.0, gt=0.0)
    faults: ProjectorFaults = ProjectorFaults()
    seed: int = Field(default=0, ge=0)
    time_scale: float = Field(default=1.0, gt=0.0, le=10.0)


class CameraFaults(BaseModel):
    """What goes wrong with the camera; numbers count the frames it has handed out, from 0.

    Parameters
    ----------
    dropped
        Chance that a frame is lost on the way: a jump in `Frame.sequence`.
    silent_from
        The frame from which on none arrives.
    stale_from
        From which on it hands out old frames from its queue, with their own old times.
    frozen_from
        From which on all have the pixels of the last one before, and new times.
    saturated_from
        From which on all pixels are at the highest count.
    misshapen_from
        From which on a row is missing.
    unplugged_from
        From which on the camera is gone.
    """

    model_config = _CLOSED

    dropped: float = Field(default=0.0, ge=0.0, lt=1.0)
    silent_from: int | None = None
    stale_from: int | None = None
    frozen_from: int | None = None
    saturated_from: int | None = None
    misshapen_from: int | None = None
    unplugged_from: int | None = None


class Stray(BaseModel):
    """Light that goes astray on a simulated bench; none unless switched on.

    Parameters
    ----------
    camera_blur_corner
        Times as wide that the camera's blur is in its picture's corners as in the middle.
    camera_halo, camera_halo_mm
        Share of the light that the camera's lens spreads widely, and how widely: a standard deviation at the water.
    veil
        Share that it spreads evenly over the whole picture.
    projector_halo, projector_halo_mm
        The same as the camera's halo of the projector's lens, on the wall.
    projector_lens_mm, projector_focus_mm
        How wide the projector's lens is, a disc across x, and the x in the filled tank at which its pictures are sharp.
    floor
        Diffuse reflectance of the tank's floor.
    glass
        Faces that are panes with air behind them, as thick as the entry wall: "entry", "far", "left", "right".
    """

    model_config = _CLOSED

    camera_blur_corner: float = Field(default=1.0, ge=0.2, le=5.0)
    camera_halo: float = Field(default=0.0, ge=0.0, le=0.2)
    camera_halo_mm: float = Field(default=30.0, gt=0.0)
    veil: float = Field(default=0.0, ge=0.0, le=0.5)
    projector_halo: float = Field(default=0.0, ge=0.0, le=0.2)
    projector_halo_mm: float = Field(default=20.0, gt=0.0)
    projector_lens_mm: float = Field(default=0.0, ge=0.0, le=100.0)
    projector_focus_mm: float = Field(default=100.0, ge=0.0, le=240.0)
    floor: float = Field(default=0.0, ge=0.0, le=1.0)
    glass: tuple[Literal["entry", "far", "left", "right"], ...] = ()


class Truth(BaseModel):
    """What is really between projector and camera; only simulated devices know it.

    Parameters
    ----------
    bench
        True geometry, where a rig file's own `bench` is what calibration found.
    water
        What the tank was filled with.
    ink
        Its coefficients, per mm and ml of ink in the tank.
    steps_per_ul
        Steps of the doser's plunger that really deliver one µl.
    mixing_s
        Time in which what is left of a plume falls to 1/e.
    inlet_mm, plume_mm
        (x, y) about which a plume lies, and its standard deviation.
    tolerance
        Relative L2 of the Monte Carlo's own noise in an image, at most; pictures of thin ink, where more photons cost a
        second or two, have .4 of it.
    coarsen
        Side, in pixels, of the blocks in which multiply scattered light is counted.
    diffuser
        Radiance of a diffuser before the lens for each W/mm² that the projector's picture has on average, 1/sr.
    diffuser_tilt
        By how much of its mean it falls from left to right.
    leak
        Part of the light of level 255 that every pixel has besides, at level 0 too.
    stray
        Light that goes astray in lenses and at walls.
    """

    model_config = _CLOSED

    bench: Bench = TRUE_BENCH
    water: Medium = PURE_WATER
    ink: Medium = MILK
    steps_per_ul: float = Field(default=10.0, gt=0.0)
    mixing_s: float = Field(default=2.0, gt=0.0)
    inlet_mm: tuple[float, float] = (60.0, 20.0)
    plume_mm: float = Field(default=35.0, gt=0.0)
    tolerance: float = Field(default=0.005, gt=0.0)
    coarsen: int = Field(default=1, ge=1)
    diffuser: float = Field(default=3e-4, gt=0.0)
    diffuser_tilt: float = Field(default=0.02, ge=0.0, lt=1.0)
    leak: float = Field(default=0.0, ge=0.0, lt=0.1)
    stray: Stray = Stray()


class Sensor(BaseModel):
    """How radiance becomes counts: electrons = radiance · exposure · response, counts = black + gain · electrons.

    Parameters
    ----------
    response
        Electrons per ms and W/mm²/sr.
    full_well
        Electrons that a pixel holds.
    bits
        Of the converter; at gain 1 a full well is its highest count.
    black
        Counts of no electrons.
    read_noise, dark_current
        Electrons (standard deviation), and electrons per ms.
    vignetting
        Part of the light that is missing in the corners.
    uneven
        Standard deviation of the pixels' response.
    hot, hot_current
        Part of the pixels that are hot, and their dark current.
    nonlinear
        Part of the electrons that is missing at a full well; grows with the electrons.
    gain_error
        Gain G amplifies by G^(1 + gain_error).
    pattern_seed
        Of all that differs from pixel to pixel.
    """

    model_config = _CLOSED

    response: float = Field(default=6e5, gt=0.0)
    full_well: float = Field(default=30_000.0, gt=0.0)
    bits: int = Field(default=14, ge=8, le=16)
    black: float = Field(default=100.0, ge=0.0)
    read_noise: float = Field(default=3.0, ge=0.0)
    dark_current: float = Field(default=0.02, ge=0.0)
    vignetting: float = Field(default=0.0, ge=0.0, lt=1.0)
    uneven: float = Field(default=0.0, ge=0.0, lt=0.3)
    hot: float = Field(default=0.0, ge=0.0, lt=0.2)
    hot_current: float = Field(default=5.0, ge=0.0)
    nonlinear: float = Field(default=0.0, ge=0.0, lt=0.5)
    gain_error: float = Field(default=0.0, gt=-0.5, lt=0.5)
    pattern_seed: int = Field(default=0, ge=0)

    @property
    def saturation(self) -> int:
        """Highest count."""
        return int(2**self.bits - 1)


class BoardBench(BaseModel):
    """A bench that can be calibrated, drawn from a seed: lenses, poses, water and glass that only the twin knows.

    Parameters
    ----------
    seed
        Another one, another bench.
    camera_shape, projector_shape
        (rows, columns).
    board
        That is held there, whatever a calibration takes it for.
    level_mm
        Height of the water over the floor; None: drawn with the rest.
    """

    model_config = _CLOSED

    seed: int = Field(default=0, ge=0)
    board: Board = Field(default_factory=Board)
    camera_shape: tuple[int, int] = (540, 960)
    projector_shape: tuple[int, int] = (384, 512)
    level_mm: float | None = Field(default=None, gt=0.0)


class SimulatedCameraSettings(BaseModel):
    """The `[camera]` table of a rig file for the simulated camera.

    Parameters
    ----------
    folder
        Of the simulated tank, the same for all three devices.
    truth, sensor
        What it sees, and how that becomes counts.
    most_per_s
        Frames per second at short exposures.
    latency_ms
        From the end of an exposure to the frame's arrival.
    queue
        Frames that wait for the program; while the queue is full, new ones are lost.
    exposure_range_ms, gain_range
        (least, most) that can be set.
    faults, seed
        What goes wrong, and the seed of it and of all noise.
    boards
        In place of the tank, a bench on which a board is held; see `tankrig calibrate camera`.
    time_scale
        All times are multiplied by this, exposures too, which gather their light all the same (demo, tests).
    """

    model_config = _CLOSED

    folder: Path
    truth: Truth = Truth()
    sensor: Sensor = Sensor()
    most_per_s: float = Field(default=30.0, gt=0.0)
    latency_ms: float = Field(default=8.0, ge=0.0)
    queue: int = Field(default=4, ge=1)
    exposure_range_ms: tuple[float, float] = (0.1, 10_000.0)
    gain_range: tuple[float, float] = (1.0, 16.0)
    faults: CameraFaults = CameraFaults()
    seed: int = Field(default=0, ge=0)
    boards: BoardBench | None = None
    time_scale: float = Field(default=1.0, gt=0.0, le=10.0)

    @model_validator(mode="after")
    def _agree(self) -> Self:
        """Refuse a truth that contradicts itself."""
        length, width, height = TANK_MM if self.boards else self.truth.bench.tank.size_mm
        x, y = self.truth.inlet_mm
        if not (0.0 <= x <= length and abs(y) <= width / 2):
            raise ValueError(
                f"truth.inlet_mm = [{x:g}, {y:g}] is outside the tank, x 0 … {length:g} mm, y ±{width / 2:g} mm; give "
                f"a place in it"
            )
        if self.boards is None:
            return self
        if "bench" in self.truth.model_fields_set:
            raise ValueError(
                "truth.bench and boards are two truths of one bench; remove truth.bench, since boards draws its own"
            )
        level_mm = self.boards.level_mm
        if level_mm is not None and level_mm > height:
            raise ValueError(
                f"boards.level_mm = {level_mm:g} is above the tank, which is {height:g} mm high; fill in less"
            )
        return self
